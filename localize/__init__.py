"""A map and a drive to a pose with its uncertainty."""
