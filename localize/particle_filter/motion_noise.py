"""How noisy this car's odometry is: the poles' corrections against those that are expected."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from polemap.localize.config import OdometryConfig
from polemap.vehicle.pose import pose_rotation

Floats = NDArray[np.float64]

# one shock (a pole wrongly assigned, a bump) must not decide
_LARGEST_SQUARE = 9.0
# the start counts as if seen in so many windows; after so many, a window counts a third
_PRIOR_WINDOWS, MEMORY_WINDOWS = 2.0, 30.0
# length of a window in independent scans, not in scans or seconds: longer than errors of poles last
WINDOW = 8.0
# factor on the alphas' standard deviations before it is learned: at 0.2 the suburb's NEES was three
# times as high (docs/particle_filter.md)
SCALE_START = 0.8
SCALE_MIN, SCALE_MAX = 0.2, 4.0
"""Bounds of the factors: the best simulated odometry asks for the first, none for the second."""


class NoiseScale:
    """Factors on the motion noise: along the car, aside of it, and of the turn.

    Between before and after a scan the mean moves by C and the covariance shrinks by D. Where noise
    and likelihood are as large as the filter takes them to be, C C^T is D in the mean. If odometry
    is better than its alphas say, corrections are smaller; if it is worse, or errs always to one
    side, the corrections of many scans add up to more. They are summed over windows longer than
    errors of seen poles last, and the mean of C^2 / D, weighed against the alphas as if they had
    been seen in two windows, scales the variance of the noise.

    Source: covariance matching of the innovations, Mehra (1972), "Approaches to adaptive
    filtering", IEEE Trans. Automatic Control 17(5), here for the state's own correction.
    """

    def __init__(self, config: OdometryConfig) -> None:
        self._config = config
        self.reset()

    def reset(self) -> None:
        """Nothing is known but the prior."""
        self._sum = _PRIOR_WINDOWS * SCALE_START**2 * np.ones(3)
        self._count = _PRIOR_WINDOWS * np.ones(3)
        self._correction = np.zeros(3)
        self._expected = np.zeros(3)
        self._share = 0.0

    @property
    def factors(self) -> Floats:
        """Factors `(3,)` on the standard deviations along, aside and of the turn."""
        if not self._config.learn_noise:
            return np.ones(3)
        scale = np.sqrt(self._sum / self._count)
        return np.clip(scale, SCALE_MIN, SCALE_MAX)

    def add_correction(
        self,
        before: tuple[Floats, Floats],
        after: tuple[Floats, Floats],
        share: float,
        trusted: bool,
    ) -> None:
        """Take in one scan.

        Args:
            before, after: mean `(3,)` and covariance `(3, 3)` of the rear-axle poses.
            share: the share of a scan that was new (`independent_share`).
            trusted: whether poles hold the pose; a window only runs over trusted scans.
        """
        if not trusted:
            self._forget()
            return
        turn = pose_rotation(-before[0][2])
        moved = after[0] - before[0]
        moved[2] = np.arctan2(np.sin(moved[2]), np.cos(moved[2]))
        self._correction += turn @ moved
        self._expected += np.diag(turn @ (before[1] - after[1]) @ turn.T)
        self._share += share
        if self._share >= WINDOW:
            self._close()

    def _close(self) -> None:
        known = self._expected > 0.0
        ratio = np.ones(3)
        np.divide(self._correction**2, self._expected, out=ratio, where=known)
        memory = 1.0 - 1.0 / MEMORY_WINDOWS
        variance = self.factors**2
        seen = variance * np.minimum(ratio, _LARGEST_SQUARE)
        self._sum = np.where(known, memory * self._sum + seen, self._sum)
        self._count = np.where(known, memory * self._count + 1.0, self._count)
        self._forget()

    def _forget(self) -> None:
        self._correction[:] = 0.0
        self._expected[:] = 0.0
        self._share = 0.0
