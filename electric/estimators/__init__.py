"""State estimators for electric vehicles, one file each."""
