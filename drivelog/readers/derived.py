"""Wheel odometry and GNSS made from poses, for recordings that lack them; with stated noise.

The noise is the one that the project's first issue fixes: speed 1 % (a scale that stays over the
drive) and 0.05 m/s a sample; yaw rate 0.002 rad/s a sample and a bias of 0.001 rad/s whose sign is
drawn; GNSS 2.5 m an axis, correlated over 60 s (first-order Gauss-Markov).
"""

from __future__ import annotations

import numpy as np
import scipy
from numpy.typing import NDArray

from polemap.drivelog.streams import GnssStream, OdometryStream
from polemap.vehicle.pose import rotate_back

Floats = NDArray[np.float64]

ODOMETRY_HZ = 50.0
GNSS_HZ = 5.0
SPEED_SCALE_SD = 0.01
SPEED_SD_MPS = 0.05
YAW_RATE_SD_RADPS = 0.002
YAW_RATE_BIAS_RADPS = 0.001
GNSS_SD_M = 2.5
GNSS_TIME_S = 60.0

ODOMETRY_NOTE = (
    "wheel odometry is derived from the poses with seeded noise (50 Hz; speed 1 % scale and "
    "0.05 m/s, yaw rate 0.002 rad/s and a bias of 0.001 rad/s): it was not measured"
)
NOTES = (
    ODOMETRY_NOTE,
    "GNSS is derived from the poses with seeded noise (5 Hz; 2.5 m Gauss-Markov over 60 s): it "
    "was not measured",
)


def _grid(stamps: Floats, rate_hz: float) -> Floats:
    count = int(np.floor((stamps[-1] - stamps[0]) * rate_hz)) + 1
    return np.asarray(stamps[0] + np.arange(count) / rate_hz)


def derived_odometry(stamps_s: Floats, poses: Floats, rng: np.random.Generator) -> OdometryStream:
    """Rear-axle speed and yaw rate at 50 Hz from poses `(n, 3)` at `(n,)` stamps, n >= 4."""
    spline = scipy.interpolate.CubicSpline(
        stamps_s, np.column_stack([poses[:, :2], np.unwrap(poses[:, 2])])
    )
    times = np.append(_grid(stamps_s, ODOMETRY_HZ), stamps_s[-1])
    times = np.unique(times)
    yaw = spline(times)[:, 2]
    rate = spline(times, 1)
    # along the car's own axis: a backward drive has a negative speed
    speed = rotate_back(rate[:, :2], yaw)[:, 0]
    scale = 1.0 + SPEED_SCALE_SD * rng.standard_normal()
    bias = YAW_RATE_BIAS_RADPS * (1.0 if rng.random() < 0.5 else -1.0)
    n = len(times)
    return OdometryStream(
        times,
        times,
        speed * scale + SPEED_SD_MPS * rng.standard_normal(n),
        rate[:, 2] + bias + YAW_RATE_SD_RADPS * rng.standard_normal(n),
    )


def derived_gnss(stamps_s: Floats, poses: Floats, rng: np.random.Generator) -> GnssStream:
    """GNSS fixes of the rear axle at 5 Hz from poses `(n, 3)` at `(n,)` stamps, n >= 2."""
    times = _grid(stamps_s, GNSS_HZ)
    true = np.stack([np.interp(times, stamps_s, poses[:, axis]) for axis in (0, 1)], axis=1)
    keep = np.exp(-1.0 / (GNSS_HZ * GNSS_TIME_S))
    error = np.empty_like(true)
    error[0] = GNSS_SD_M * rng.standard_normal(2)
    for row in range(1, len(times)):
        fresh = GNSS_SD_M * np.sqrt(1.0 - keep**2) * rng.standard_normal(2)
        error[row] = keep * error[row - 1] + fresh
    fixes = true + error
    return GnssStream(times, times, fixes[:, 0], fixes[:, 1], np.ones(len(times)))
