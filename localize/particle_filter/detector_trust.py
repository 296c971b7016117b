"""Whether the detector of the poles is believed: what accuses it, and what acquits it again."""

from __future__ import annotations

from collections import Counter

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.detections import Detections
from polemap.localize.config import LocalizeConfig
from polemap.localize.odometry_history import OdometryHistory
from polemap.localize.particle_filter.detector_check import DetectorCheck
from polemap.localize.particle_filter.landmarks import Landmarks
from polemap.localize.particle_filter.recovery import Step
from polemap.vehicle.pose import compose, relative

Floats = NDArray[np.float64]
# what dead reckoning may be off by between two proven places, m, and as a share of the way
_STAYED_M, _STAYED_SHARE = 0.3, 0.02


class DetectorTrust:
    """The check of the detector against the way, and the contradictions that accuse it.

    Poles that stop fitting may be the fault of detector, odometry or map. A contradiction
    accuses the detector until its check acquits it, or until the place is proven again where the
    odometry has led to meanwhile: then it was the map, as where it ends.
    """

    def __init__(self, config: LocalizeConfig, counts: Counter[str]) -> None:
        self.check = DetectorCheck(config.poles, config.odometry.rear_slip_rad_per_mps2)
        self._counts = counts
        # pose, odometry's pose and way where poles began to contradict the place
        self._left: tuple[Floats, Floats, float] | None = None

    @property
    def reason(self) -> str:
        """What is wrong with it, "unproven" while it is accused, or nothing."""
        if not self.check.contradicts and not self.check.acquitted:
            return "unproven"
        return self.check.contradicts

    @property
    def believed(self) -> bool:
        """Acquitted, and not contradicted."""
        return self.check.acquitted and not self.check.contradicts

    def poles_contradict(self, pose: Floats, odometry_pose: Floats, travelled_m: float) -> None:
        """Poles began to contradict the place that was at `pose` before."""
        self.check.suspect()
        self._left = pose, odometry_pose, travelled_m

    def odometry_contradicts(self) -> None:
        """Poles and odometry contradict each other."""
        self.check.suspect()
        self._left = None

    def place_proven(self, pose: Floats, step: Step) -> None:
        """The place is proven, and no pole contradicts it any more."""
        if self._left is None:
            return
        if _stayed(self._left, pose, step):
            self.check.absolve()
        self._left = None

    def forget(self, *, accused: bool) -> None:
        """Odometry is in doubt, or the place is new; `accused` where poles that held are lost."""
        self.check.forget()
        if accused:
            self.check.suspect()
            self._left = None

    def add_scan(
        self, scan: Detections, landmarks: Landmarks, pose: Floats, step: Step,
        history: OdometryHistory, *, proven: bool,
    ) -> None:  # fmt: skip
        """Hold a scan against the way; what is found is counted."""
        rates = history.rates_at(scan.stamp_s)
        if self.check.add_scan(
            scan, landmarks, pose, step.odometry_pose, step.travelled_m, rates, proven=proven
        ):
            self._counts[f"detector_{self.check.contradicts}"] += 1


def _stayed(left: tuple[Floats, Floats, float], pose: Floats, step: Step) -> bool:
    """Whether a place that is proven again is where the odometry has led to meanwhile."""
    pose_then, odometry_then, travelled_m = left
    expected = compose(pose_then, relative(odometry_then, step.odometry_pose))
    off_m = float(np.hypot(*(pose - expected)[:2]))
    return off_m <= _STAYED_M + _STAYED_SHARE * (step.travelled_m - travelled_m)
