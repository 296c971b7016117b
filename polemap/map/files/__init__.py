"""The files that a map consists of."""
