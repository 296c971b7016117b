"""The public names: each a thin layer over the rooms, with one settings tree."""
