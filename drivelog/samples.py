"""What a drive is made of: typed, immutable samples.

Every sample has `stamp_s`, the time at which it was measured, and `arrival_s`, the time at which
it reached the computer; where a drive does not know the latter it equals the former.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import nan

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.detections import Detections
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
    """Rear-axle speed (forward positive) and yaw rate (counter-clockwise positive).

    `lateral_mps` is the rear axle's speed to the left in the eyes of the camera that the poles are
    seen with; NaN where that does not tell the odometry.
    """

    stamp_s: float
    arrival_s: float
    speed_mps: float
    yaw_rate_radps: float
    lateral_mps: float = nan


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


Sample = StereoFrame | OdometrySample | GnssFix | ReferencePose | Detections
