"""Noise and disturbances of the studies, behind which the closed loops drive, too."""

from __future__ import annotations

from polemap.electric.config import EstimatorConfig

KMH = 1.0 / 3.6
PATTERN_S = (0.020, 0.015, 0.010, 0.025)  # delays of successive pictures, W13

# The papers print no process noise and no steering; these are ours and serve all studies.
MISMATCH = EstimatorConfig(sideslip_walk_rad=0.02, yaw_rate_walk_radps=0.2)
MATCHED = EstimatorConfig(sideslip_walk_rad=0.0316, yaw_rate_walk_radps=0.316)
GPS_NOISE = EstimatorConfig(
    sideslip_walk_rad=0.005,
    yaw_rate_walk_radps=0.05,
    course_sd_rad=0.003,
    acceleration_walk_mps=0.02,
    # roll in the accelerometer follows the steering, so its disturbance forgets as fast
    acceleration_disturbance_time_s=2.0,
)
GPS_STIFFNESS_NPRAD = (7000.0, 10000.0)  # real and nominal
ROLL_RAD_PER_MPS2, ACCELERATION_BIAS_MPS2 = 0.007, 0.1
