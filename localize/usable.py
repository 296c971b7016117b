"""Input that no car, receiver or detector can mean: told apart before it reaches a filter."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from polemap.drivelog.detections import Detections
from polemap.drivelog.landmark_kind import LINE_KINDS
from polemap.drivelog.line_detections import LineDetections

# what lies beyond is a unit or a bit that went wrong
_FASTEST_MPS, _FASTEST_TURN_RADPS = 150.0, 100.0
FARTHEST_ON_EARTH_M, _WORST_HDOP = 1e8, 1e4
_FARTHEST_M = 1000.0
# a hundredth of a millimetre: no detector is surer than that in any direction, and a covariance
# that is definite by its rounding alone pins a pole to a line
_SMALLEST_VARIANCE_M2 = 1e-10
# of a line: a piece that has no direction, and one that is surer than any survey
_SHORTEST_M, _SMALLEST_SD = 0.05, 1e-5


def usable_odometry(speed_mps: float, yaw_rate_radps: float) -> bool:
    """Whether the rates are numbers that a vehicle can have."""
    return abs(speed_mps) <= _FASTEST_MPS and abs(yaw_rate_radps) <= _FASTEST_TURN_RADPS


def usable_fix(east_m: float, north_m: float, hdop: float) -> bool:
    """Whether a fix is a place on earth, and its dilution a number."""
    there = abs(east_m) <= FARTHEST_ON_EARTH_M and abs(north_m) <= FARTHEST_ON_EARTH_M
    return there and 0.0 <= hdop <= _WORST_HDOP


def usable_poles(scan: Detections) -> Detections:
    """The scan with those of its poles that can be used: near, with a covariance that is one; the
    same of its lines."""
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
    if scan.lines is not None and (lines := _usable_lines(scan.lines)) is not scan.lines:
        scan = replace(scan, lines=lines)
    return scan if keep.all() else scan.take(keep)


def _usable_lines(lines: LineDetections) -> LineDetections:
    """Pieces of known kinds that are near, have a length, and state how sure they are."""
    ends = np.hstack([lines.start_vehicle_m, lines.end_vehicle_m])
    with np.errstate(over="ignore", invalid="ignore"):
        keep = (np.abs(ends) <= _FARTHEST_M).all(axis=1) & (lines.length_m >= _SHORTEST_M)
        for sd in (lines.offset_sd_m, lines.direction_sd_rad):
            keep &= (sd >= _SMALLEST_SD) & (sd <= _FARTHEST_M)
        keep &= (lines.probability >= 0.0) & np.isin(lines.kind, list(LINE_KINDS))
    return lines if keep.all() else lines.take(keep)
