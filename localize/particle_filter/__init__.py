"""Odometry, GNSS and poles to a pose with its health: the particle filter."""
