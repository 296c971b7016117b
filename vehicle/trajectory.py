"""Poses over time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from polemap.vehicle.pose import wrap_angle

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Trajectory:
    """Poses of the rear axle over time in one plane.

    Attributes:
        stamp_s: `(n,)` seconds, rising.
        poses: `(n, 3)` east and north in metres, yaw in radians.
        covariance: `(n, 3, 3)` of the poses, or None where nothing is stated.
    """

    stamp_s: Floats
    poses: Floats
    covariance: Floats | None = None

    def __len__(self) -> int:
        return len(self.stamp_s)

    def rows(self, rows: NDArray[np.int64] | NDArray[np.bool_] | slice) -> Trajectory:
        """Some of the poses."""
        covariance = None if self.covariance is None else self.covariance[rows]
        return Trajectory(self.stamp_s[rows], self.poses[rows], covariance)

    def between(self, start_s: float, end_s: float) -> Trajectory:
        """The part with `start_s <= stamp <= end_s`."""
        first = int(np.searchsorted(self.stamp_s, start_s, side="left"))
        last = int(np.searchsorted(self.stamp_s, end_s, side="right"))
        return self.rows(slice(first, last))

    def at(self, stamps_s: ArrayLike, max_gap_s: float = 1.0) -> Floats:
        """Interpolated poses `(m, 3)`; see `interpolate_poses`."""
        return interpolate_poses(self.stamp_s, self.poses, stamps_s, max_gap_s)

    def thinned(self, spacing_m: float) -> Trajectory:
        """Every pose that lies at least `spacing_m` of travel behind the one kept before it.

        Standstill collapses to one pose and a 100 Hz stream to what a picture can show.
        """
        if len(self) < 2:
            return self
        ticks = np.floor(self.travelled_m() / spacing_m)
        return self.rows(np.concatenate([[True], np.diff(ticks) > 0]))

    def travelled_m(self) -> Floats:
        """Distance along the polyline up to every pose, `(n,)`."""
        steps = np.hypot(*np.diff(self.poses[:, :2], axis=0).T)
        return np.concatenate([[0.0], np.cumsum(steps)])


def interpolate_poses(
    stamp_s: Floats, poses: Floats, at_s: ArrayLike, max_gap_s: float = 1.0
) -> Floats:
    """Poses `(m, 3)` at the stamps `at_s` `(m,)`, linear between neighbours, yaw the short way.

    NaN before the first and after the last pose and inside gaps longer than `max_gap_s`. At a
    stamp that has a pose, that pose.

    Args:
        stamp_s: `(n,)` rising.
        poses: `(n, 3)` at them.
        at_s: `(m,)` where poses are wanted.
        max_gap_s: longest gap to bridge.
    """
    stamps = np.atleast_1d(np.asarray(at_s, dtype=np.float64))
    result = np.full((len(stamps), 3), np.nan)
    if not len(stamp_s):
        return result
    low = np.searchsorted(stamp_s, stamps, side="right") - 1
    within = (low >= 0) & (stamps <= stamp_s[-1])
    low = np.clip(low, 0, len(stamp_s) - 1)
    high = np.minimum(low + 1, len(stamp_s) - 1)
    gap = stamp_s[high] - stamp_s[low]
    inside = within & ((stamps == stamp_s[low]) | (gap <= max_gap_s))
    low, high, gap = low[inside], high[inside], gap[inside]
    share = np.where(gap > 0, (stamps[inside] - stamp_s[low]) / np.where(gap > 0, gap, 1), 0)
    start = poses[low]
    step = poses[high] - start
    step[:, 2] = wrap_angle(step[:, 2])
    between = start + share[:, None] * step
    between[:, 2] = wrap_angle(between[:, 2])
    result[inside] = between
    return result
