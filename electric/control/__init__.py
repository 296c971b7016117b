"""Controllers on the estimates, one file each."""
