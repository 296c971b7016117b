"""What GNSS says about every particle: fixes wait for the scan that comes after them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.samples import GnssFix
from polemap.localize.gnss.outlier_mixture import GnssReceiver
from polemap.localize.odometry_history import OdometryHistory
from polemap.vehicle.pose import relative

Floats = NDArray[np.float64]

_MOST_FIXES = 200
MAX_AGE_S = 3.0
"""A fix older than this says nothing: three of the usual 1 Hz may fail."""


class FixWeights:
    """The fixes that no scan has met yet, and the newest of those that one has.

    Args:
        receiver: how well it measures.
        weigh: whether they weigh particles; without, they only say how far away they are.

    Attributes:
        information_per_m2: of each axis of the position, that the last scan met.
    """

    def __init__(self, receiver: GnssReceiver, *, weigh: bool = True) -> None:
        self._receiver, self._weigh = receiver, weigh
        self._waiting: list[GnssFix] = []
        self._last_s: float | None = None
        self._newest: tuple[GnssFix, Floats] | None = None
        self.information_per_m2 = 0.0

    def add_fix(self, fix: GnssFix) -> None:
        """Keep a fix until the next scan."""
        self._waiting.append(fix)
        del self._waiting[:-_MOST_FIXES]

    def weigh_by_fixes(
        self, log_weights: Floats, rear_poses: Floats, stamp_s: float, history: OdometryHistory
    ) -> Floats:
        """Log-weights `(n,)` of poses `(n, 3)` at `stamp_s` after the fixes up to then."""
        due = [fix for fix in self._waiting if fix.stamp_s <= stamp_s]
        self.information_per_m2 = 0.0
        if not due:
            return log_weights
        del self._waiting[: len(due)]
        now = history.odometry_pose(stamp_s)
        for fix in due:
            last, self._last_s = self._last_s, fix.stamp_s
            if last is None or stamp_s - fix.stamp_s > MAX_AGE_S:
                continue
            share = self._independent_share(fix.stamp_s - last)
            moved = relative(now, history.odometry_pose(fix.stamp_s))
            self._newest = (fix, moved)
            if not self._weigh:
                continue
            self.information_per_m2 += share / self._receiver.sd_m(fix.hdop) ** 2
            log_weights = log_weights + share * gnss_log_likelihood(
                rear_poses, fix, self._receiver, moved
            )
        return log_weights

    def _independent_share(self, elapsed_s: float) -> float:
        """Fixes share one slowly wandering error: their information grows with time, not with their
        number, by one independent fix for every two correlation times."""
        correlation_s = self._receiver.config.correlation_s
        return min(1.0, elapsed_s / (2.0 * correlation_s)) if correlation_s > 0.0 else 1.0

    def distance_sd(self, pose: Floats, covariance: Floats) -> float | None:
        """Distance of a rear-axle pose `(3,)` from the newest fix, in standard deviations.

        None if that fix has been asked about before.
        """
        if self._newest is None:
            return None
        fix, moved = self._newest
        self._newest = None
        at_fix = self._receiver.positions(pose[np.newaxis], moved)[0]
        variance = self._receiver.sd_m(fix.hdop) ** 2
        # scattered particles must not excuse any distance
        own = min(0.5 * float(covariance[0, 0] + covariance[1, 1]), 4.0 * variance)
        distance = np.hypot(at_fix[0] - fix.east_m, at_fix[1] - fix.north_m)
        return float(distance / np.sqrt(variance + own))


def gnss_log_likelihood(
    rear_poses: Floats, fix: GnssFix, receiver: GnssReceiver, moved: Floats
) -> Floats:
    """Log-likelihood `(n,)` of one fix: a Gaussian of HDOP times the receiver's standard deviation,
    mixed with a wide one.

    Args:
        rear_poses: `(n, 3)` at the filter's time.
        moved: `(3,)` motion of the vehicle from the filter's time to the fix, in vehicle axes.
    """
    antenna = receiver.positions(rear_poses, moved)
    d2 = ((antenna - (fix.east_m, fix.north_m)) ** 2).sum(axis=1) / receiver.sd_m(fix.hdop) ** 2
    return receiver.mixture(d2)
