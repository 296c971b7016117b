"""How results come to stand on the disk: whole, under a lock, and never over somebody's files."""
