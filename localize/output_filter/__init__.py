"""Odometry and late poses to a smooth pose 100 times a second: the output filter."""
