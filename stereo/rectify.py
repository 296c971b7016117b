"""From raw calibration to a rectified pair, and a check that rows of the pair agree."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, cast

import cv2
import numpy as np
from numpy.typing import NDArray

from polemap.stereo.errors import StereoError
from polemap.stereo.matching_types import Image
from polemap.stereo.rig import Mounting, StereoRig

Floats = NDArray[np.float64]
Maps = NDArray[np.float32]
Distortion = Literal["plumb_bob", "rational_polynomial", "equidistant"]

_COEFFICIENTS = {"plumb_bob": (0, 4, 5), "rational_polynomial": (8,), "equidistant": (4,)}


@dataclass(frozen=True, slots=True)
class CameraCalibration:
    """A raw camera: `(3, 3)` matrix in pixels, and its lens.

    Attributes:
        distortion: `plumb_bob` with k1 k2 p1 p2 k3 (or the first four, or none),
            `rational_polynomial` with k1 k2 p1 p2 k3 k4 k5 k6, `equidistant` with k1 k2 k3 k4.

    Raises:
        StereoError: a matrix, size or number of coefficients that cannot be.
    """

    width_px: int
    height_px: int
    matrix: Floats
    distortion: Distortion
    coefficients: Floats

    def __post_init__(self) -> None:
        if self.distortion not in _COEFFICIENTS:
            known = ", ".join(_COEFFICIENTS)
            raise StereoError(f"lens model '{self.distortion}' is unknown; known are {known}")
        if len(self.coefficients) not in _COEFFICIENTS[self.distortion]:
            raise StereoError(
                f"lens model {self.distortion} takes {_COEFFICIENTS[self.distortion]} "
                f"coefficients, not {len(self.coefficients)}"
            )
        matrix = np.asarray(self.matrix)
        usable = matrix.shape == (3, 3) and np.isfinite(matrix).all()
        if not usable or matrix[0, 0] <= 0 or matrix[1, 1] <= 0:
            raise StereoError(f"camera matrix {matrix.tolist()} has no positive focal lengths")
        if self.width_px < 1 or self.height_px < 1:
            raise StereoError(f"camera size {self.width_px}x{self.height_px} px is empty")


@dataclass(frozen=True, slots=True)
class StereoCalibration:
    """Two raw cameras; right camera point = `rotation` @ left camera point + `translation_m`.

    Raises:
        StereoError: no rotation matrix, no baseline, or a right camera that stands on the left.
    """

    left: CameraCalibration
    right: CameraCalibration
    rotation: Floats
    translation_m: Floats

    def __post_init__(self) -> None:
        rotation = np.asarray(self.rotation)
        if rotation.shape != (3, 3) or not np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-3):
            raise StereoError("the rotation between the cameras is no rotation matrix")
        if np.asarray(self.translation_m).shape != (3,):
            raise StereoError("the translation between the cameras needs three numbers")
        # the right camera's centre in the left camera's axes
        centre = -rotation.T @ self.translation_m
        if not centre[0] > 0.5 * np.linalg.norm(centre):
            raise StereoError(
                f"the right camera stands at {np.round(centre, 3).tolist()} m of the left one, "
                "not to its right: exchange the cameras"
            )


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


class Rectifier:
    """Turns raw pairs into rectified ones for the rig `rig`."""

    def __init__(
        self,
        calibration: StereoCalibration,
        width_px: int | None = None,
        height_px: int | None = None,
        focal_px: float | None = None,
        vehicle_from_camera: Mounting | None = None,
    ) -> None:
        """Sizes default to those of the left camera, the focal length to the smallest of both.

        Raises:
            StereoError: sizes or a focal length that are not positive.
        """
        left, right = calibration.left, calibration.right
        width = left.width_px if width_px is None else width_px
        height = left.height_px if height_px is None else height_px
        if focal_px is None:
            focal_px = float(min(c.matrix[k, k] for c in (left, right) for k in (0, 1)))
        rotations = rectifying_rotations(calibration)
        # the mean direction in which both image centres look becomes the centre of the result
        rays = [
            rotation @ _centre_ray(camera)
            for camera, rotation in zip((left, right), rotations, strict=True)
        ]
        shift = np.mean([ray[:2] / ray[2] for ray in rays], axis=0)
        cx = (width - 1) / 2 - focal_px * float(shift[0])
        cy = (height - 1) / 2 - focal_px * float(shift[1])
        self.rig = StereoRig(
            width_px=width,
            height_px=height,
            focal_px=focal_px,
            cx_px=cx,
            cy_px=cy,
            baseline_m=float(np.linalg.norm(calibration.translation_m)),
            vehicle_from_camera=vehicle_from_camera or Mounting(),
        )
        projection = np.array([[focal_px, 0, cx], [0, focal_px, cy], [0, 0, 1.0]])
        self._sizes = [(camera.height_px, camera.width_px) for camera in (left, right)]
        self._maps = [
            _maps(camera, rotation, projection, (width, height))
            for camera, rotation in zip((left, right), rotations, strict=True)
        ]

    def rectify(self, left: Image, right: Image) -> tuple[Image, Image]:
        """Both images on the rectified rig; 0 where the raw image does not reach.

        Raises:
            StereoError: images of another size than the calibration.
        """
        results = []
        sides = zip(("left", "right"), (left, right), self._sizes, self._maps, strict=True)
        for side, image, size, (map_x, map_y) in sides:
            if image.shape != size:
                raise StereoError(
                    f"the {side} image has shape {image.shape}, its calibration {size}: use the "
                    "raw images that the calibration was made with"
                )
            results.append(cast(Image, cv2.remap(image, map_x, map_y, cv2.INTER_LINEAR)))
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
    camera: CameraCalibration, rotation: Floats, projection: Floats, size: tuple[int, int]
) -> tuple[Maps, Maps]:
    make = (
        cv2.fisheye.initUndistortRectifyMap
        if camera.distortion == "equidistant"
        else cv2.initUndistortRectifyMap
    )
    coefficients = np.asarray(camera.coefficients, dtype=np.float64)
    map_x, map_y = make(
        np.asarray(camera.matrix), coefficients, rotation, projection, size, cv2.CV_32FC1
    )
    return np.asarray(map_x, dtype=np.float32), np.asarray(map_y, dtype=np.float32)


@dataclass(frozen=True, slots=True)
class VerticalDisparity:
    """Rows of the left minus rows of the right image at matched features.

    Attributes:
        matches: how many features were compared.
        median_px: the systematic part; a rectified pair has 0.
        spread_px: 1.48 times the median absolute deviation from it.
        tilt_px: change of the offset from the left to the right edge of the image, as a roll
            between the cameras makes it.
    """

    matches: int
    median_px: float
    spread_px: float
    tilt_px: float

    def acceptable(self, limit_px: float = 0.5) -> bool:
        """Whether a matcher that searches along rows will do well."""
        return abs(self.median_px) <= limit_px and abs(self.tilt_px) <= 2 * limit_px


def vertical_disparity(
    left: Image, right: Image, max_disparity_px: float = 256.0, max_rows_px: float = 16.0
) -> VerticalDisparity:
    """Measures how far the rows of a pair are apart, by optical flow of corners.

    Raises:
        StereoError: images of different size, or fewer than 20 features that match.
    """
    if left.shape != right.shape:
        raise StereoError(f"images of different size: {left.shape} and {right.shape}")
    one, two = _as_bytes(left), _as_bytes(right)
    corners = cv2.goodFeaturesToTrack(one, 2000, 0.01, 8)
    if corners is None:
        raise StereoError("the left image has no corners: vertical disparity cannot be measured")
    start = np.asarray(corners, dtype=np.float32).reshape(-1, 1, 2)
    guess = start.copy()
    there, good, _ = cv2.calcOpticalFlowPyrLK(one, two, start, guess, winSize=(21, 21), maxLevel=5)
    back, good_back, _ = cv2.calcOpticalFlowPyrLK(
        two, one, there, np.array(there), winSize=(21, 21), maxLevel=5
    )
    here, there = start.reshape(-1, 2), np.asarray(there).reshape(-1, 2)
    returned = np.hypot(*(np.asarray(back).reshape(-1, 2) - here).T) < 0.3
    step = here - there
    keep = (np.ravel(good) == 1) & (np.ravel(good_back) == 1) & returned
    keep &= (step[:, 0] > -2) & (step[:, 0] < max_disparity_px) & (np.abs(step[:, 1]) < max_rows_px)
    if keep.sum() < 20:
        raise StereoError(
            f"only {int(keep.sum())} features match between the images, 20 are needed to measure "
            "vertical disparity"
        )
    offset = step[keep, 1].astype(np.float64)
    column = here[keep, 0].astype(np.float64) / left.shape[1] - 0.5
    median = float(np.median(offset))
    spread = 1.4826 * float(np.median(np.abs(offset - median)))
    near = np.abs(offset - median) <= 3 * spread + 0.1
    tilt = float(np.polyfit(column[near], offset[near], 1)[0])
    return VerticalDisparity(int(keep.sum()), median, spread, tilt)


def _as_bytes(image: Image) -> NDArray[np.uint8]:
    if image.dtype == np.uint8:
        return cast(NDArray[np.uint8], image)
    top = max(int(image.max()), 1)
    return np.asarray(image.astype(np.uint32) * 255 // top, dtype=np.uint8)
