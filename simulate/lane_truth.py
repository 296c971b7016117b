"""What a perfect lane camera would say: heading, offset and curvature of the lane, per picture."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from polemap.simulate.driver import Motion
from polemap.simulate.ground import marking_lines
from polemap.simulate.route import Route
from polemap.simulate.scenario import SectionSpec
from polemap.vehicle.pose import inverse_transform_points

Floats = NDArray[np.float64]
COLUMNS = (
    "stamp_s", "heading_rad", "lateral_offset_m", "road_curvature_per_m", "lane_width_m",
    "preview_m",
)  # fmt: skip
_REACH_M, _STEP_M = 45.0, 0.25
_AROUND_M = 4.0  # of the preview point: where the parabola of heading and curvature is fitted


def lane_truth(
    route: Route, spec: SectionSpec, motion: Motion, stamps_s: Floats, preview_m: float
) -> Floats:
    """Rows `(n, 6)` of `COLUMNS`; NaN where the car is not between two lines of markings.

    The lane is the one whose lines lie left and right of the car; heading and offset are the
    car's at `preview_m` ahead of its rear axle, left positive, offset from the lane's middle.
    """
    lines = np.array(sorted(marking_lines(spec)))
    poses = motion.at(stamps_s)
    station = motion.value("station_m", stamps_s)
    lateral = motion.value("lateral_m", stamps_s)
    along = np.arange(-_REACH_M, _REACH_M, _STEP_M)
    rows = np.full((len(stamps_s), len(COLUMNS)), np.nan)
    rows[:, 0], rows[:, 5] = stamps_s, preview_m
    for k, pose in enumerate(poses):
        above, below = lines[lines > lateral[k]], lines[lines < lateral[k]]
        if not len(above) or not len(below):
            continue
        edges = [
            inverse_transform_points(pose, route.at(station[k] + along, float(one))[:, :2])
            for one in (above[0], below[-1])
        ]
        fits = [_parabola(edge, preview_m) for edge in edges]
        if fits[0] is None or fits[1] is None:
            continue
        middle = 0.5 * (fits[0] + fits[1])
        c = 1.0 / np.hypot(1.0, middle[1])
        rows[k, 1:5] = (
            -np.arctan(middle[1]), -middle[0] * c, 2.0 * middle[2] * c**3,
            abs(fits[0][0] - fits[1][0]) * c,
        )  # fmt: skip
    return rows


def _parabola(points_m: Floats, preview_m: float) -> Floats | None:
    """Offset, slope and half the curvature of a line at the preview, or None where it is not."""
    near = (np.abs(points_m[:, 0] - preview_m) < _AROUND_M) & (np.abs(points_m[:, 1]) < 15.0)
    if np.count_nonzero(near) < 8:
        return None
    u = points_m[near, 0] - preview_m
    return np.asarray(np.polynomial.polynomial.polyfit(u, points_m[near, 1], 2))
