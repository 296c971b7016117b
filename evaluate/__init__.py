"""Trajectories, errors, passes, repeatability and detection scoring; no command line."""
