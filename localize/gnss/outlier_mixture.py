"""Error model of a GNSS receiver, for both filters: antenna, noise by HDOP, outlier mixture."""

from __future__ import annotations

from dataclasses import dataclass, field
from math import exp, log

import numpy as np
from numpy.typing import NDArray

from polemap.localize.config import GnssConfig
from polemap.vehicle.packed import transform_point
from polemap.vehicle.pose import compose

Floats = NDArray[np.float64]

# a lower HDOP than this says more about the receiver's arithmetic than about its error
_HDOP_FLOOR = 0.5
# an outlier's standard deviation, in those of a good fix: 50 m at the default
_WIDE_SD_RATIO = 20.0
# share of fixes that say nothing, in a sum of evidence: bounds what a single fix can say
_SILENT_SHARE = 0.02


@dataclass(frozen=True, slots=True)
class GnssReceiver:
    """Antenna and error of a receiver.

    Attributes:
        antenna_m: forward and left of the rear axle, in the vehicle frame.
        config: its error.
    """

    antenna_m: tuple[float, float] = (0.0, 0.0)
    config: GnssConfig = field(default_factory=GnssConfig)

    def sd_m(self, hdop: float) -> float:
        """Standard deviation of a fix, an axis."""
        return self.config.sd_m * max(hdop, _HDOP_FLOOR)

    def mixture(self, distance2: Floats) -> Floats:
        """Log of a Gaussian at squared distances `(n,)` in standard deviations, mixed with a wide
        one, so that an outlier of a hundred metres says nothing; up to a constant."""
        share, wide = self.config.outlier_share, _WIDE_SD_RATIO**2
        near = np.log1p(-share) - 0.5 * distance2
        return np.asarray(np.logaddexp(near, np.log(share / wide) - 0.5 * distance2 / wide))

    def positions(self, rear_poses: Floats, moved: Floats) -> Floats:
        """Antenna positions `(n, 2)` of rear-axle poses `(n, 3)` that then move by `moved` `(3,)`
        in the axes of the vehicle before it moves."""
        return compose(rear_poses, compose(moved, [*self.antenna_m, 0.0]))[:, :2]

    def residual(
        self, pose: tuple[float, float, float], east_m: float, north_m: float
    ) -> tuple[float, float]:
        """A fix less the antenna of a rear-axle pose, east and north."""
        east, north = transform_point(pose, *self.antenna_m)
        return east_m - east, north_m - north

    def evidence(
        self, pose: tuple[float, float, float], east_m: float, north_m: float, sd_m: float
    ) -> float:
        """Log-likelihood of a fix for a rear-axle pose, bounded below."""
        east, north = self.residual(pose, east_m, north_m)
        return log(exp(-(east * east + north * north) / (2.0 * sd_m**2)) + _SILENT_SHARE)
