"""Maps without reference poses: poles, poses, odometry calibration and GNSS errors in one graph."""
