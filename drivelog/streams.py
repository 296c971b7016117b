"""The streams of a drive as columns: compact to hold, quick to search."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.columns import Columns
from polemap.drivelog.samples import GnssFix, OdometrySample, ReferencePose
from polemap.vehicle.pose import Pose2D
from polemap.vehicle.trajectory import interpolate_poses

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class OdometryCorrection:
    """What an odometry was corrected by: true metres are what it says over `speed_scale`, and its
    stamps were `delay_s` late."""

    speed_scale: float = 1.0
    delay_s: float = 0.0

    def apply(self, stream: OdometryStream) -> OdometryStream:
        """The stream as it should have been; nothing arrives before it is measured."""
        stamps = stream.stamp_s - self.delay_s
        return OdometryStream(
            stamps,
            np.maximum(stream.arrival_s, stamps),
            stream.speed_mps / self.speed_scale,
            stream.yaw_rate_radps,
            stream.lateral_mps / self.speed_scale,
        )


@dataclass(frozen=True, slots=True)
class OdometryStream(Columns):
    """Odometry; every array `(n,)`, sorted by `stamp_s`; see `OdometrySample`."""

    stamp_s: Floats
    arrival_s: Floats
    speed_mps: Floats
    yaw_rate_radps: Floats
    lateral_mps: Floats = field(default_factory=lambda: np.empty(0))

    def __post_init__(self) -> None:
        if not len(self.lateral_mps):
            object.__setattr__(self, "lateral_mps", np.full(len(self.stamp_s), np.nan))
        Columns.__post_init__(self)

    def sample(self, row: int) -> OdometrySample:
        """The sample of a row."""
        return OdometrySample(
            float(self.stamp_s[row]),
            float(self.arrival_s[row]),
            float(self.speed_mps[row]),
            float(self.yaw_rate_radps[row]),
            float(self.lateral_mps[row]),
        )


# a receiver's deviation an axis at a dilution of one: the localizer's `gnss.sd_m`
SD_AT_DILUTION_ONE_M = 2.5


@dataclass(frozen=True, slots=True)
class GnssStream(Columns):
    """GNSS fixes of the antenna in the drive's frame; every array `(n,)`, sorted by `stamp_s`."""

    stamp_s: Floats
    arrival_s: Floats
    east_m: Floats
    north_m: Floats
    hdop: Floats

    def sample(self, row: int) -> GnssFix:
        """The sample of a row."""
        return GnssFix(
            float(self.stamp_s[row]),
            float(self.arrival_s[row]),
            float(self.east_m[row]),
            float(self.north_m[row]),
            float(self.hdop[row]),
        )


@dataclass(frozen=True, slots=True)
class ReferenceStream(Columns):
    """Rear-axle poses `(n, 3)` east, north, yaw of a reference system, sorted by `stamp_s`.

    `sd_m` `(n,)` is its own standard deviation per axis, NaN where it does not say.
    """

    stamp_s: Floats
    poses: Floats
    sd_m: Floats

    def at(self, stamps_s: Any, *, max_gap_s: float = 1.0) -> Floats:
        """Poses `(m, 3)` at the stamps `(m,)`, linear between neighbours (yaw along the short way).

        NaN before the first and after the last pose and inside gaps longer than `max_gap_s`.
        """
        return interpolate_poses(self.stamp_s, self.poses, stamps_s, max_gap_s)

    def sd_at(self, stamps_s: Any) -> Floats:
        """Standard deviations `(m,)` at the stamps `(m,)`, of the nearest pose before."""
        stamps = np.atleast_1d(np.asarray(stamps_s, dtype=np.float64))
        if not len(self):
            return np.full(len(stamps), np.nan)
        low = np.clip(np.searchsorted(self.stamp_s, stamps, side="right") - 1, 0, len(self) - 1)
        return np.asarray(self.sd_m[low])

    def sample(self, row: int) -> ReferencePose:
        """The sample of a row."""
        east, north, yaw = (float(value) for value in self.poses[row])
        return ReferencePose(
            float(self.stamp_s[row]), Pose2D(east, north, yaw), float(self.sd_m[row])
        )
