"""What sees the poles for a car in a closed loop."""

from __future__ import annotations

from collections import deque
from dataclasses import replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.detections import Detections
from polemap.drivelog.samples import OdometrySample
from polemap.simulate.detector import PoleDetector
from polemap.simulate.plant import PlantState
from polemap.vehicle.pose import Pose2D

Floats = NDArray[np.float64]


class Eye(Protocol):
    """What sees the poles: pictures come in, scans come out some time later.

    Attributes:
        measures_motion: whether it tells the car's motion, too, so that no wheels are needed.
    """

    measures_motion: bool

    def record_odometry(self, sample: OdometrySample) -> None:
        """What the car has just measured of its motion."""

    def look(self, now_s: float, rear: Pose2D, state: PlantState) -> None:
        """Take a picture with the rear axle at a true pose."""

    def scans(self, now_s: float) -> list[Detections]:
        """What has been seen since the last call, with its arrival."""

    def motion(self, now_s: float) -> list[OdometrySample]:
        """What has been seen of the car's own motion since the last call, with its arrival."""

    def localized(self, seconds: float) -> None:
        """How long the localizer was busy with a scan."""


class DetectorEye:
    """A detector of stated errors without pictures, each scan late by the same time."""

    measures_motion = False

    def __init__(self, detector: PoleDetector, delay_s: float) -> None:
        self._detector, self._delay_s = detector, delay_s
        self._waiting: deque[tuple[float, Floats]] = deque()

    def record_odometry(self, sample: OdometrySample) -> None:
        """See `Eye`; no tracks that would move."""

    def look(self, now_s: float, rear: Pose2D, state: PlantState) -> None:
        """See `Eye`."""
        self._waiting.append((now_s, np.array(rear)))

    def scans(self, now_s: float) -> list[Detections]:
        """See `Eye`."""
        seen = []
        while self._waiting and self._waiting[0][0] + self._delay_s <= now_s + 1e-9:
            stamp, pose = self._waiting.popleft()
            seen.append(replace(self._detector.scan(stamp, pose), arrival_s=now_s))
        return seen

    def motion(self, now_s: float) -> list[OdometrySample]:
        """See `Eye`; none."""
        return []

    def localized(self, seconds: float) -> None:
        """See `Eye`; the delay is stated."""
