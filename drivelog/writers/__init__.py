"""Drives to the disk, as a recorder would leave them."""
