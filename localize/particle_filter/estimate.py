"""What the particle filter hands on after a scan."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from polemap.localize.particle_filter.health import HealthRecord

Floats = NDArray[np.float64]
Event = Literal["initialized", "reinitialized", "explored"]


@dataclass(frozen=True, slots=True)
class PfEstimate:
    """What the filter says after a scan.

    Attributes:
        stamp_s, arrival_s: of the scan.
        pose: `(3,)` east, north, yaw of the rear axle in the map's frame.
        covariance: `(3, 3)`.
        healthy: whether the pose may be used: one mode, narrow, and poles that fit or are absent.
        modes: clusters of the cloud; above 1 the pose is one of several possible ones.
        health: the row of health.csv.
        event: "initialized", "reinitialized", "explored" or None.
    """

    stamp_s: float
    arrival_s: float
    pose: Floats
    covariance: Floats
    healthy: bool
    modes: int
    health: HealthRecord
    event: Event | None
