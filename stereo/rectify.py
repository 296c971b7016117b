"""From raw calibration to a rectified pair."""

from __future__ import annotations

from typing import cast

import cv2
import numpy as np
from numpy.typing import NDArray

from polemap.stereo.calibration import CameraCalibration, Rectification, StereoCalibration
from polemap.stereo.errors import StereoError
from polemap.stereo.matching_types import Image
from polemap.stereo.rig import Mounting, StereoRig

Floats = NDArray[np.float64]
Maps = NDArray[np.float32]

# what differs by less than this is no distortion that a picture could show
_SAME_PX = 0.01


def rectifying_rotations(calibration: StereoCalibration) -> tuple[Floats, Floats]:
    """Rotations `(3, 3)` from each raw camera to the common rectified axes.

    The rectified x axis runs along the baseline, the z axis is as near as possible to the mean of
    both optical axes.

    Source: Fusiello, Trucco and Verri, Machine Vision and Applications 2000.
    """
    rotation = np.asarray(calibration.rotation, dtype=np.float64)
    x = -rotation.T @ np.asarray(calibration.translation_m, dtype=np.float64)
    x /= np.linalg.norm(x)
    mean_axis = np.array([0.0, 0.0, 1.0]) + rotation.T @ np.array([0.0, 0.0, 1.0])
    y = np.cross(mean_axis, x)
    y /= np.linalg.norm(y)
    left = np.stack([x, y, np.cross(x, y)])
    return left, left @ rotation.T


def rectification_of(calibration: StereoCalibration) -> Rectification:
    """The calibration's own rectification, or one of the raw pictures' size.

    The focal length is the smallest of the raw ones, so that no pixel is enlarged, and the mean of
    the directions in which both image centres look becomes the centre of the picture.
    """
    if calibration.rectification is not None:
        return calibration.rectification
    cameras = (calibration.left, calibration.right)
    width, height = calibration.left.width_px, calibration.left.height_px
    focal = float(min(c.matrix[k, k] for c in cameras for k in (0, 1)))
    rotations = rectifying_rotations(calibration)
    rays = [turn @ _centre_ray(camera) for camera, turn in zip(cameras, rotations, strict=True)]
    shift = np.mean([ray[:2] / ray[2] for ray in rays], axis=0)
    return Rectification(
        rotations[0],
        rotations[1],
        focal,
        (width - 1) / 2 - focal * float(shift[0]),
        (height - 1) / 2 - focal * float(shift[1]),
        width,
        height,
    )


class Rectifier:
    """Turns raw pairs into rectified ones for the rig `rig`.

    Where to look in the raw pictures is computed once, at the first pair; a copy that is sent to
    another process computes it anew.

    Attributes:
        calibration: of the raw cameras.
        rectification: rotations and the rectified camera.
        rig: what the rectified pictures are pictures of.
    """

    def __init__(
        self, calibration: StereoCalibration, vehicle_from_camera: Mounting | None = None
    ) -> None:
        """`vehicle_from_camera` is the mounting of the rectified left camera."""
        self.calibration = calibration
        self.rectification = given = rectification_of(calibration)
        along = given.left @ (-calibration.rotation.T @ calibration.translation_m)
        self.rig = StereoRig(
            width_px=given.width_px,
            height_px=given.height_px,
            focal_px=given.focal_px,
            cx_px=given.cx_px,
            cy_px=given.cy_px,
            baseline_m=float(along[0]),
            vehicle_from_camera=vehicle_from_camera or Mounting(),
        )
        self._maps: tuple[tuple[Maps, Maps] | None, ...] | None = None

    def __reduce__(self) -> tuple[type[Rectifier], tuple[StereoCalibration, Mounting]]:
        return Rectifier, (self.calibration, self.rig.vehicle_from_camera)

    @property
    def raw_size_px(self) -> tuple[int, int]:
        """Width and height of the pictures before."""
        return self.calibration.left.width_px, self.calibration.left.height_px

    def maps(self) -> tuple[tuple[Maps, Maps] | None, ...]:
        """For left and right the raw column and row of every rectified pixel, None if its own."""
        if self._maps is None:
            given = self.rectification
            self._maps = (
                _maps(self.calibration.left, given.left, given),
                _maps(self.calibration.right, given.right, given),
            )
        return self._maps

    def covered(self) -> float:
        """Share of the rectified pixels that both raw pictures reach; the others are black."""
        width, height = self.raw_size_px
        inside = np.ones((self.rig.height_px, self.rig.width_px), dtype=np.bool_)
        for side in self.maps():
            if side is not None:
                x, y = side
                inside &= (x >= 0) & (x <= width - 1) & (y >= 0) & (y <= height - 1)
        return float(inside.mean())

    def rectify(self, left: Image, right: Image) -> tuple[Image, Image]:
        """Both images on the rectified rig; 0 where the raw image does not reach.

        Raises:
            StereoError: images of another size than the calibration.
        """
        width, height = self.raw_size_px
        results = []
        for side, image, maps in zip(("left", "right"), (left, right), self.maps(), strict=True):
            if image.shape != (height, width):
                raise StereoError(
                    f"the {side} image has {image.shape[1]}x{image.shape[0]} px, its calibration "
                    f"is for {width}x{height}: use the raw images that the calibration was made "
                    "with, or calibrate for these"
                )
            if maps is not None:
                image = cast(Image, cv2.remap(image, maps[0], maps[1], cv2.INTER_LINEAR))
            results.append(image)
        return results[0], results[1]


def _centre_ray(camera: CameraCalibration) -> Floats:
    """Direction `(3,)` seen by the middle of the raw image, without its lens distortion."""
    middle = np.array([[[(camera.width_px - 1) / 2, (camera.height_px - 1) / 2]]])
    if camera.distortion == "equidistant":
        point = cv2.fisheye.undistortPoints(middle, camera.matrix, camera.coefficients)
    else:
        point = cv2.undistortPoints(middle, camera.matrix, camera.coefficients)
    x, y = np.asarray(point, dtype=np.float64).reshape(2)
    return np.array([x, y, 1.0])


def _maps(
    camera: CameraCalibration, rotation: Floats, given: Rectification
) -> tuple[Maps, Maps] | None:
    make = (
        cv2.fisheye.initUndistortRectifyMap
        if camera.distortion == "equidistant"
        else cv2.initUndistortRectifyMap
    )
    f = given.focal_px
    # one principal point for both sides, whatever the right P says: disparity 0 is infinity
    projection = np.array([[f, 0, given.cx_px], [0, f, given.cy_px], [0, 0, 1.0]])
    size = (given.width_px, given.height_px)
    coefficients = np.asarray(camera.coefficients, dtype=np.float64)
    map_x, map_y = make(
        np.asarray(camera.matrix), coefficients, rotation, projection, size, cv2.CV_32FC1
    )
    x, y = np.asarray(map_x, dtype=np.float32), np.asarray(map_y, dtype=np.float32)
    if size == (camera.width_px, camera.height_px):
        row, column = np.indices(x.shape, dtype=np.float32)
        if max(float(np.abs(x - column).max()), float(np.abs(y - row).max())) < _SAME_PX:
            return None
    return x, y
