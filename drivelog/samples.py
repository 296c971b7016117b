"""What a drive is made of: typed, immutable samples.

Every sample has `stamp_s`, the time at which it was measured, and `arrival_s`, the time at which
it reached the computer; where a drive does not know the latter it equals the former.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from polemap.vehicle.pose import Pose2D

Floats = NDArray[np.float64]
Image = NDArray[np.uint8] | NDArray[np.uint16]


@dataclass(frozen=True, slots=True)
class StereoFrame:
    """A rectified pair of grey images `(height, width)`, 8 or 16 bit."""

    stamp_s: float
    arrival_s: float
    index: int
    left: Image
    right: Image


@dataclass(frozen=True, slots=True)
class OdometrySample:
    """Rear-axle speed (forward positive) and yaw rate (counter-clockwise positive)."""

    stamp_s: float
    arrival_s: float
    speed_mps: float
    yaw_rate_radps: float


@dataclass(frozen=True, slots=True)
class GnssFix:
    """A position of the antenna in the drive's frame, and its dilution of precision."""

    stamp_s: float
    arrival_s: float
    east_m: float
    north_m: float
    hdop: float


@dataclass(frozen=True, slots=True)
class ReferencePose:
    """The rear-axle pose of a reference system in the drive's frame; `sd_m` NaN if unknown."""

    stamp_s: float
    pose: Pose2D
    sd_m: float

    @property
    def arrival_s(self) -> float:
        """A reference is made afterwards: in a replay it counts from its own stamp."""
        return self.stamp_s


@dataclass(frozen=True, slots=True)
class VisibleRegion:
    """The part of the ground in which a sensor could have seen a pole at one moment.

    A sector around `origin_vehicle_m`, `(2,)` in the vehicle frame, from `bearing_min_rad` to
    `bearing_max_rad` (counter-clockwise from forward). `free_range_m`, `(k,)`, is the range up to
    which nothing stood before a pole, in k equal bins over the sector, right to left; a single
    bin serves a sensor that does not know occlusion.
    """

    origin_vehicle_m: Floats
    bearing_min_rad: float
    bearing_max_rad: float
    range_min_m: float
    free_range_m: Floats

    def contains(self, points_vehicle_m: Floats) -> NDArray[np.bool_]:
        """Which of the points `(..., 2)` could have been seen; `(...,)`."""
        offset = np.asarray(points_vehicle_m, dtype=np.float64) - self.origin_vehicle_m
        bearing = np.arctan2(offset[..., 1], offset[..., 0])
        distance = np.hypot(offset[..., 0], offset[..., 1])
        bins = len(self.free_range_m)
        span = self.bearing_max_rad - self.bearing_min_rad
        column = np.floor((bearing - self.bearing_min_rad) / span * bins).astype(np.int64)
        inside = (column >= 0) & (column < bins) & (distance >= self.range_min_m)
        return inside & (distance <= self.free_range_m[np.clip(column, 0, bins - 1)])


@dataclass(frozen=True, slots=True)
class PoleScan:
    """The poles seen at one moment in the vehicle frame; no poles is also an observation.

    Attributes:
        points_vehicle_m: `(n, 2)` pole axes at ground level.
        covariance_m2: `(n, 2, 2)`.
        width_m: `(n,)`.
        ids: `(n,)` track ids, -1 where the detector does not track.
        existence: `(n,)` probability that it is a pole.
        view: where a pole would have been seen, or None if the sensor does not say.
        height_m: `(n,)` visible height over the ground, NaN where unknown, or None.
    """

    stamp_s: float
    arrival_s: float
    points_vehicle_m: Floats
    covariance_m2: Floats
    width_m: Floats
    ids: NDArray[np.int64]
    existence: Floats
    view: VisibleRegion | None = None
    height_m: Floats | None = None

    def __len__(self) -> int:
        return len(self.points_vehicle_m)


@dataclass(frozen=True, slots=True)
class VehicleSignals:
    """A row of a signal log: fast inertial and wheel signals by the names of its columns."""

    stamp_s: float
    arrival_s: float
    values: dict[str, float] = field(default_factory=dict)


Sample = StereoFrame | OdometrySample | GnssFix | ReferencePose | PoleScan | VehicleSignals
