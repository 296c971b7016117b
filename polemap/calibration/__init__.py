"""What a drive itself says of its calibration: rows of the pair, mounting, odometry."""
