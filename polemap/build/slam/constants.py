"""What the solver takes for granted: lengths of its parts, prior deviations, a loop's margin."""

from __future__ import annotations

# way between the poses that are solved for, and of one local map of poles, matched as a whole
KEYFRAME_M, SUBMAP_M = 2.0, 30.0
# most rounds of association and solving to a fixed point
ROUNDS_MOST = 8
# of the odometry's calibration before it is solved for, sd: scales of speed and yaw rate, offset of
# a gyro, of a steering angle as curvature, yaw of the detector to the way, slip of the rear axle
SPEED_SCALE_SD, YAW_RATE_SCALE_SD = 0.05, 0.05
YAW_RATE_OFFSET_SD_RADPS, CURVATURE_OFFSET_SD_RADPM = 0.005, 0.002
SIDESLIP_SD_RAD, SLIP_SD_RAD_PER_MPS2 = 0.02, 0.004
# of the first four where the odometry is a stereo camera's, its disparities' error learned: half a
# percent of scale is left, and no gyro drifts
CAMERA_CALIBRATION_SD = (0.005, 0.003, 2e-4, 1e-4)
# time in which it stays the same, and its change from one such time to the next in its own sd
CALIBRATION_S, CALIBRATION_WALK = 120.0, 0.1
# part of a fix's error that does not last from fix to fix, at HDOP 1, an axis
GNSS_WHITE_M = 0.5
# least error of a detection, and how far apart two passes see the middle of one trunk, sd an axis
POLE_FLOOR_M, SAME_POLE_SD_M = 0.05, 0.06
# log odds by which a loop must beat every other place within reach
LOOP_MARGIN = 5.0
