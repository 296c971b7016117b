"""Poles in stereo pairs, one by one or followed from frame to frame."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from polemap.detect.detection import StereoDetections
from polemap.drivelog.drive import Drive
from polemap.drivelog.errors import InputError
from polemap.drivelog.images import read_grey
from polemap.drivelog.samples import Image, StereoFrame
from polemap.perception import PerceivedFrame, PolePerception
from polemap.settings import Settings
from polemap.stereo.rig import StereoRig
from polemap.tools.detect_pictures import overlay

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True, slots=True)
class PolesInPair:
    """What one stereo pair showed: the poles as a table, and a picture of how they were found.

    Attributes:
        detections: every hypothesis, best first, the rejected ones too.
        probability_min: from which probability on a hypothesis is called a pole.
    """

    detections: StereoDetections
    probability_min: float
    _perceived: PerceivedFrame

    @property
    def table(self) -> pd.DataFrame:
        """The poles, one a row, best first; positions of their axis in the vehicle frame."""
        import pandas as pd  # takes as long to import as all the rest

        found = self.detections.take(self.detections.probability >= self.probability_min)
        return pd.DataFrame(
            {
                "x_m": found.points_vehicle_m[:, 0],
                "y_m": found.points_vehicle_m[:, 1],
                "sd_m": np.sqrt(np.linalg.eigvalsh(found.covariance_m2)[:, 1]),
                "width_m": found.width_m,
                "height_m": found.height_m,
                "probability": found.probability,
                "left_px": found.left_px,
                "right_px": found.right_px,
                "top_px": found.top_px,
                "bottom_px": found.bottom_px,
                "disparity_px": found.disparity_px,
            }
        )

    def picture(self) -> NDArray[np.uint8]:
        """Left image with edges and hypotheses, disparity, and a view from above; RGB."""
        drawn = overlay(self._perceived, self.probability_min)
        return np.ascontiguousarray(drawn[:, :, ::-1])


class Perception(PolePerception):
    """Finds poles in stereo pairs; given odometry, it follows them from frame to frame.

    Args:
        camera: the rectified stereo camera, or a drive that was recorded with it.
        settings: of matching, detection and tracking; the defaults where not given.

    Raises:
        InputError: the drive has no camera.
    """

    def __init__(self, camera: Drive | StereoRig, settings: Settings | None = None) -> None:
        rig = camera.rig if isinstance(camera, Drive) else camera
        if rig is None:
            name = getattr(camera, "name", "")
            raise InputError(f"drive {name}: it has no camera; drive.yaml describes one")
        self._pair_rig, self._settings = rig, settings or Settings()
        super().__init__(rig, self._settings.polemap, stereo=self._settings.stereo)

    def poles(self, left: str | Path | Image, right: str | Path | Image) -> PolesInPair:
        """The poles of one rectified pair, for itself: nothing is remembered from other pairs.

        Args:
            left, right: image files, or grey arrays `(height, width)` of 8 or 16 bit.

        Raises:
            InputError: an image file cannot be read.
            StereoError: images that do not fit each other or the camera.
        """
        pair = [read_grey(Path(i)) if isinstance(i, str | Path) else i for i in (left, right)]
        alone = PolePerception(self._pair_rig, self._settings.polemap, stereo=self._settings.stereo)
        perceived = alone.perceive(StereoFrame(0.0, 0.0, 0, *pair))
        minimum = self._settings.polemap.detection.probability_min
        return PolesInPair(perceived.view.detections, minimum, perceived)
