"""Input that no car, receiver or detector can mean: told apart before it reaches a filter."""

from __future__ import annotations

import numpy as np

from polemap.drivelog.detections import Detections

# what lies beyond is a unit or a bit that went wrong
_FASTEST_MPS, _FASTEST_TURN_RADPS = 150.0, 100.0
FARTHEST_ON_EARTH_M, _WORST_HDOP = 1e8, 1e4
_FARTHEST_M = 1000.0
# a hundredth of a millimetre: no detector is surer than that in any direction, and a covariance
# that is definite by its rounding alone pins a pole to a line
_SMALLEST_VARIANCE_M2 = 1e-10


def usable_odometry(speed_mps: float, yaw_rate_radps: float) -> bool:
    """Whether the rates are numbers that a vehicle can have."""
    return abs(speed_mps) <= _FASTEST_MPS and abs(yaw_rate_radps) <= _FASTEST_TURN_RADPS


def usable_fix(east_m: float, north_m: float, hdop: float) -> bool:
    """Whether a fix is a place on earth, and its dilution a number."""
    there = abs(east_m) <= FARTHEST_ON_EARTH_M and abs(north_m) <= FARTHEST_ON_EARTH_M
    return there and 0.0 <= hdop <= _WORST_HDOP


def usable_poles(scan: Detections) -> Detections:
    """The scan with those of its poles that can be used: near, with a covariance that is one."""
    points, covariance = scan.points_vehicle_m, scan.covariance_m2
    # comparisons with what is not a number are false
    with np.errstate(over="ignore", invalid="ignore"):
        near = (np.abs(points) <= _FARTHEST_M).all(axis=1)
        a, b, c = covariance[:, 0, 0], covariance[:, 0, 1], covariance[:, 1, 1]
        small = (a > 0.0) & (a <= _FARTHEST_M**2) & (c > 0.0) & (c <= _FARTHEST_M**2)
        # determinant over trace: the smaller eigenvalue, where the two are far apart
        definite = (b == covariance[:, 1, 0]) & (a * c - b * b >= _SMALLEST_VARIANCE_M2 * (a + c))
        # an unknown width is no fault, a wild one is
        width = np.isnan(scan.width_m) | (np.abs(scan.width_m) <= _FARTHEST_M)
        keep = near & small & definite & width & (scan.probability >= 0.0)
    return scan if keep.all() else scan.take(keep)
