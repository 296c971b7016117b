"""What GNSS says about every particle: fixes wait for the scan that comes after them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.samples import GnssFix
from polemap.localize.config import LocalizeConfig
from polemap.localize.odometry_history import OdometryHistory

Floats = NDArray[np.float64]

_MOST_FIXES = 200


class GnssFixes:
    """The fixes that no scan has met yet, and the newest of those that one has."""

    def __init__(self, config: LocalizeConfig) -> None:
        self._config = config
        self._waiting: list[tuple[GnssFix, Floats]] = []
        self._last_s: float | None = None
        self._newest: tuple[GnssFix, Floats, Floats] | None = None

    def add(self, fix: GnssFix, antenna_m: Floats) -> None:
        """Keep a fix of the antenna at `(2,)` in the vehicle frame."""
        self._waiting.append((fix, antenna_m))
        del self._waiting[:-_MOST_FIXES]

    def weigh(
        self, log_weights: Floats, rear_poses: Floats, stamp_s: float, history: OdometryHistory
    ) -> Floats:
        """Log-weights `(n,)` of poses `(n, 3)` at `stamp_s` after the fixes up to then."""
        due = [entry for entry in self._waiting if entry[0].stamp_s <= stamp_s]
        if not due:
            return log_weights
        del self._waiting[: len(due)]
        reckoned = history.dead_reckoning(stamp_s)
        for fix, antenna in due:
            last, self._last_s = self._last_s, fix.stamp_s
            if last is None or stamp_s - fix.stamp_s > self._config.gnss_max_age_s:
                continue
            # fixes share one slowly wandering error: their information grows with time, not number
            share = min(1.0, (fix.stamp_s - last) / (2.0 * self._config.gnss_correlation_s))
            moved = _relative_motion(reckoned, history.dead_reckoning(fix.stamp_s))
            self._newest = (fix, antenna, moved)
            log_weights = log_weights + share * gnss_log_likelihood(
                rear_poses, fix, antenna, moved, self._config
            )
        return log_weights

    def distance_sd(self, pose: Floats, covariance: Floats) -> float | None:
        """Distance of a rear-axle pose `(3,)` from the newest fix, in standard deviations.

        None if that fix has been asked about before.
        """
        if self._newest is None:
            return None
        fix, antenna, moved = self._newest
        self._newest = None
        at_fix = antenna_at(pose[np.newaxis], antenna, moved)[0]
        variance = _variance_m2(fix, self._config)
        # a scattered cloud must not excuse any distance
        own = min(0.5 * float(covariance[0, 0] + covariance[1, 1]), 4.0 * variance)
        distance = np.hypot(at_fix[0] - fix.east_m, at_fix[1] - fix.north_m)
        return float(distance / np.sqrt(variance + own))


def antenna_at(rear_poses: Floats, antenna_m: Floats, moved: Floats) -> Floats:
    """Positions `(n, 2)` of the antenna, for rear-axle poses `(n, 3)` that then move by `moved`.

    Args:
        antenna_m: `(2,)` in the vehicle frame.
        moved: `(3,)` in the axes of the vehicle before it moves.
    """
    c, s = np.cos(rear_poses[:, 2]), np.sin(rear_poses[:, 2])
    c_moved, s_moved = np.cos(moved[2]), np.sin(moved[2])
    x = moved[0] + c_moved * antenna_m[0] - s_moved * antenna_m[1]
    y = moved[1] + s_moved * antenna_m[0] + c_moved * antenna_m[1]
    return np.stack([rear_poses[:, 0] + c * x - s * y, rear_poses[:, 1] + s * x + c * y], axis=1)


def gnss_log_likelihood(
    rear_poses: Floats,
    fix: GnssFix,
    antenna_m: Floats,
    moved: Floats,
    config: LocalizeConfig,
) -> Floats:
    """Log-likelihood `(n,)` of one fix: a Gaussian of HDOP times the receiver's standard deviation,
    mixed with a wide one, so that an outlier of a hundred metres says nothing.

    Args:
        rear_poses: `(n, 3)` at the filter's time.
        moved: `(3,)` motion of the vehicle from the filter's time to the fix, in vehicle axes.
    """
    antenna = antenna_at(rear_poses, antenna_m, moved)
    d2 = ((antenna - (fix.east_m, fix.north_m)) ** 2).sum(axis=1) / _variance_m2(fix, config)
    wide = 400.0  # twenty times the standard deviation
    return np.asarray(
        np.logaddexp(
            np.log1p(-config.gnss_outlier_share) - 0.5 * d2,
            np.log(config.gnss_outlier_share / wide) - 0.5 * d2 / wide,
        )
    )


def _variance_m2(fix: GnssFix, config: LocalizeConfig) -> float:
    return (config.gnss_sd_m * max(fix.hdop, 0.5)) ** 2


def _relative_motion(start: Floats, end: Floats) -> Floats:
    """Motion `(3,)` from one dead-reckoned pose to another, in the axes of the first."""
    c, s = np.cos(start[2]), np.sin(start[2])
    dx, dy = end[0] - start[0], end[1] - start[1]
    return np.array([c * dx + s * dy, -s * dx + c * dy, end[2] - start[2]])
