"""Calibrations as ROS states them: `sensor_msgs/CameraInfo` of both sides of a pair."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import cast

import numpy as np
from numpy.typing import NDArray

from polemap.stereo.calibration import (
    CameraCalibration,
    Rectification,
    StereoCalibration,
    lens_model,
)
from polemap.stereo.errors import StereoError

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class CameraInfo:
    """One side of a calibrated pair as ROS states it (`sensor_msgs/CameraInfo`).

    Attributes:
        rectification: R `(3, 3)`, rectified from raw axes.
        projection: P `(3, 4)` of the rectified pair; that of the right camera holds -f b.
    """

    camera: CameraCalibration
    rectification: Floats
    projection: Floats


def camera_info(
    size_px: tuple[int, int],
    model: str,
    matrices: Sequence[Sequence[float] | Floats],
) -> CameraInfo:
    """From the fields of a message or file, `size_px` width and height, `matrices` K, D, R, P.

    Raises:
        StereoError: a matrix of another size or not finite, an unknown lens model.
    """
    numbers = [np.asarray(values, dtype=np.float64).ravel() for values in matrices]
    for name, values, count in zip("KDRP", numbers, (9, None, 9, 12), strict=True):
        if (count is not None and values.size != count) or not np.isfinite(values).all():
            raise StereoError(f"{name} needs {count or 'finite'} numbers, not {values.tolist()}")
    k, d, r, p = numbers
    lens = lens_model(model, len(d))
    camera = CameraCalibration(size_px[0], size_px[1], k.reshape(3, 3), lens, d)
    return CameraInfo(camera, r.reshape(3, 3), p.reshape(3, 4))


def of_camera_infos(
    left: CameraInfo, right: CameraInfo, baseline_m: float | None = None
) -> StereoCalibration:
    """The pair that two CameraInfo describe; the baseline is in the right projection.

    Args:
        left, right: the sides.
        baseline_m: the measured baseline, where the projection's is in another unit.

    Raises:
        StereoError: the pair was calibrated one by one, is exchanged, or stands one above the
            other.
    """
    f, c = left.projection[0, 0], right.projection
    if not f > 0.0 or abs(c[0, 0] / f - 1.0) > 1e-3 or abs(left.projection[1, 1] / f - 1.0) > 1e-3:
        raise StereoError(
            f"the projections P have focal lengths {f:g}, {left.projection[1, 1]:g} and "
            f"{c[0, 0]:g}: those of a rectified pair are one"
        )
    shift = (right.projection[:, 3] - left.projection[:, 3]) / f
    if not shift[0] < 0.0:
        what = "is positive" if shift[0] > 0.0 else "is 0"
        raise StereoError(
            f"the right projection P has no baseline (its fourth number {what}): the cameras are "
            "exchanged, or were calibrated one by one"
        )
    baseline = float(-shift[0]) if baseline_m is None else baseline_m
    # X_right = R_r^T (R_l X_left - (b, 0, 0))
    rotation = right.rectification.T @ left.rectification
    translation = -right.rectification.T @ np.array([baseline, 0.0, 0.0])
    rectification = Rectification(
        left.rectification,
        right.rectification,
        float(f),
        float(left.projection[0, 2]),
        float(left.projection[1, 2]),
        left.camera.width_px,
        left.camera.height_px,
    )
    return StereoCalibration(
        left.camera, right.camera, rotation, cast(Floats, translation), rectification
    )
