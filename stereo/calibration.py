"""What is known of two cameras before rectification: lenses, the way between them, and theirs.

A calibration may bring its own rectification (R1, R2, P1, P2 of OpenCV and ROS, R_rect and P_rect
of KITTI); without one `stereo.rectify` makes it from the rotation and translation.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import acos, degrees
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from polemap.parsing.pictures import LARGEST_PIXELS
from polemap.stereo.errors import StereoError

Floats = NDArray[np.float64]
Distortion = Literal["plumb_bob", "rational_polynomial", "equidistant"]

_COEFFICIENTS = {
    "plumb_bob": (0, 4, 5),
    "rational_polynomial": (8, 12, 14),
    "equidistant": (4,),
}
# what ROS, OpenCV, Kalibr and COLMAP call the same three models
_ALIASES: dict[str, Distortion] = {
    **dict.fromkeys(("plumb_bob", "radtan", "radial_tangential", "brown", "none", ""), "plumb_bob"),
    **dict.fromkeys(("rational_polynomial", "rational"), "rational_polynomial"),
    **dict.fromkeys(("equidistant", "equi", "fisheye", "kannala_brandt"), "equidistant"),
}
BASELINE_MIN_M, BASELINE_MAX_M = 0.01, 5.0
# published rectifications are rounded, and KITTI's serves four cameras at once
_ASPECT_MOST = 2.0
_ROTATION_TOLERANCE_DEG, _BASELINE_TOLERANCE = 0.5, 0.03


def lens_model(name: str, coefficients: int) -> Distortion:
    """The lens model that `name` stands for; OpenCV's unnamed eight are rational_polynomial.

    Raises:
        StereoError: no such model is known here.
    """
    model = _ALIASES.get(name.strip().lower().replace("-", "_"))
    if model is None:
        known = ", ".join(_COEFFICIENTS)
        raise StereoError(f"lens model '{name[:40]}' is unknown; known are {known}")
    if model == "plumb_bob" and coefficients in _COEFFICIENTS["rational_polynomial"]:
        return "rational_polynomial"
    return model


def check_rotation(name: str, rotation: Floats) -> None:
    """Refuses what is no rotation `(3, 3)`.

    Raises:
        StereoError: another shape, not finite, not orthogonal or mirrored.
    """
    good = np.shape(rotation) == (3, 3) and bool(np.isfinite(rotation).all())
    if not good or not np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-3):
        raise StereoError(f"{name} is no rotation matrix")
    if np.linalg.det(rotation) < 0.0:
        raise StereoError(f"{name} mirrors (its determinant is -1), it is no rotation matrix")


def check_picture_size(what: str, width_px: int, height_px: int) -> None:
    """Refuses a size that no picture has: maps are made of it before one is read.

    Raises:
        StereoError: empty, or larger than any picture that is read.
    """
    if width_px < 1 or height_px < 1:
        raise StereoError(f"{what} size {width_px}x{height_px} px is empty")
    if width_px * height_px > LARGEST_PIXELS:
        raise StereoError(
            f"{what} size {width_px}x{height_px} px: {LARGEST_PIXELS} pixels are the most"
        )


@dataclass(frozen=True, slots=True)
class CameraCalibration:
    """A raw camera: `(3, 3)` matrix in pixels, and its lens.

    Attributes:
        distortion: `plumb_bob` with k1 k2 p1 p2 k3 (or the first four, or none),
            `rational_polynomial` with k1 k2 p1 p2 k3 k4 k5 k6 (and OpenCV's s1 to s4, tx, ty),
            `equidistant` with k1 k2 k3 k4.

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
            counts = " or ".join(str(count) for count in _COEFFICIENTS[self.distortion])
            raise StereoError(
                f"lens model {self.distortion} takes {counts} coefficients, not "
                f"{len(self.coefficients)}"
            )
        if not np.isfinite(self.coefficients).all():
            raise StereoError(f"lens coefficients {list(self.coefficients)} are not all finite")
        check_picture_size("camera", self.width_px, self.height_px)
        self._check_matrix()
        self._check_lens()

    def _check_matrix(self) -> None:
        matrix = np.asarray(self.matrix)
        usable = matrix.shape == (3, 3) and bool(np.isfinite(matrix).all())
        if not usable or matrix[0, 0] <= 0 or matrix[1, 1] <= 0:
            raise StereoError(f"camera matrix {matrix.tolist()} has no positive focal lengths")
        if not np.allclose(matrix[2], [0.0, 0.0, 1.0]) or matrix[1, 0] != 0.0:
            raise StereoError(
                f"camera matrix {matrix.tolist()} is not [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]"
            )
        if not 1.0 / _ASPECT_MOST < matrix[1, 1] / matrix[0, 0] < _ASPECT_MOST:
            raise StereoError(
                f"focal lengths {matrix[0, 0]:g} and {matrix[1, 1]:g} px differ by more than "
                f"{_ASPECT_MOST:g} times: no pixel is so far from square"
            )
        if abs(matrix[0, 1]) > 1e-3 * matrix[0, 0]:
            raise StereoError(
                f"camera matrix has a skew of {matrix[0, 1]:g}: calibrate again without skew"
            )
        for centre, size, name in (
            (matrix[0, 2], self.width_px, "width"), (matrix[1, 2], self.height_px, "height"),
        ):  # fmt: skip
            if not -0.5 * size <= centre <= 1.5 * size:
                raise StereoError(
                    f"the principal point {centre:.0f} px lies far outside of a {name} of {size} "
                    "px: the camera matrix is that of another size"
                )

    def _check_lens(self) -> None:
        """Near the middle, to a quarter of the way, no lens folds the picture or moves it far."""
        centre = self.matrix[:2, 2]
        corners = np.array([[0.0, 0.0], [self.width_px, 0.0], [0.0, self.height_px],
                            [self.width_px, self.height_px]])  # fmt: skip
        focal = np.array([self.matrix[0, 0], self.matrix[1, 1]])
        reach = float(np.hypot(*((corners - centre) / focal).T).max())
        k = np.zeros(8)
        k[: min(len(self.coefficients), 8)] = self.coefficients[:8]
        if self.distortion == "equidistant":
            angle = r = np.linspace(0.0, min(0.25 * reach, 1.5), 200)
            out = angle * (1.0 + sum(k[i] * angle ** (2 * i + 2) for i in range(4)))
        else:
            r = np.linspace(0.0, 0.25 * reach, 200)
            over = 1.0 + k[0] * r**2 + k[1] * r**4 + k[4] * r**6
            under = 1.0 + k[5] * r**2 + k[6] * r**4 + k[7] * r**6
            out = r * over / np.where(np.abs(under) < 1e-9, 1e-9, under)
        if not (np.diff(out) > 0.0).all() or not 0.25 * r[-1] < out[-1] < 4.0 * r[-1]:
            raise StereoError(
                f"lens coefficients {[float(c) for c in self.coefficients[:5]]} fold or tear the "
                "picture near its middle: they are of another lens model or order"
            )

    @property
    def has_distortion(self) -> bool:
        """Whether the lens bends rays; an equidistant one always does."""
        return self.distortion == "equidistant" or bool(np.any(self.coefficients))


@dataclass(frozen=True, slots=True)
class Rectification:
    """How a calibration wants its pair rectified.

    Attributes:
        left, right: rotations `(3, 3)` from the raw cameras to the common rectified axes.
        focal_px, cx_px, cy_px, width_px, height_px: of both rectified pictures.

    Raises:
        StereoError: no rotations, or no pinhole camera.
    """

    left: Floats
    right: Floats
    focal_px: float
    cx_px: float
    cy_px: float
    width_px: int
    height_px: int

    def __post_init__(self) -> None:
        check_rotation("the left camera's rectification", self.left)
        check_rotation("the right camera's rectification", self.right)
        if not np.isfinite([self.focal_px, self.cx_px, self.cy_px]).all() or self.focal_px <= 0:
            raise StereoError(
                f"the rectified camera has focal length {self.focal_px} and principal point "
                f"{self.cx_px}, {self.cy_px}"
            )
        check_picture_size("rectified", self.width_px, self.height_px)


@dataclass(frozen=True, slots=True)
class StereoCalibration:
    """Two raw cameras; right camera point = `rotation` @ left camera point + `translation_m`.

    Attributes:
        rectification: what the calibration's own R1, R2 and P1 say; None to compute it.

    Raises:
        StereoError: sizes that differ, no rotation matrix, no baseline or one of another unit, a
            right camera that does not stand to the right, or a rectification of another rig.
    """

    left: CameraCalibration
    right: CameraCalibration
    rotation: Floats
    translation_m: Floats
    rectification: Rectification | None = None

    def __post_init__(self) -> None:
        sizes = [(camera.width_px, camera.height_px) for camera in (self.left, self.right)]
        if sizes[0] != sizes[1]:
            raise StereoError(
                f"the left camera has {sizes[0][0]}x{sizes[0][1]} px, the right one "
                f"{sizes[1][0]}x{sizes[1][1]}: a pair needs one size"
            )
        check_rotation("the rotation between the cameras", np.asarray(self.rotation))
        if np.shape(self.translation_m) != (3,) or not np.isfinite(self.translation_m).all():
            raise StereoError("the translation between the cameras needs three finite numbers")
        # the right camera's centre in the left camera's axes
        centre = -self.rotation.T @ self.translation_m
        if not centre[0] > 0.5 * self.baseline_m:
            turned = centre[0] < -0.5 * self.baseline_m
            remedy = "exchange the cameras" if turned else "only pairs side by side are matched"
            raise StereoError(
                f"the right camera stands at {np.round(centre, 3).tolist()} m of the left one "
                f"(right, down, ahead), not to its right: {remedy}"
            )
        if not BASELINE_MIN_M <= self.baseline_m <= BASELINE_MAX_M:
            raise StereoError(_wrong_unit(self.baseline_m))
        if self.rectification is not None:
            self._check_rectification(self.rectification)

    @property
    def baseline_m(self) -> float:
        """Between the optical centres."""
        return float(np.linalg.norm(self.translation_m))

    def _check_rectification(self, given: Rectification) -> None:
        turn = given.right.T @ given.left @ self.rotation.T
        angle = degrees(acos(float(np.clip((np.trace(turn) - 1.0) / 2.0, -1.0, 1.0))))
        if angle > _ROTATION_TOLERANCE_DEG:
            raise StereoError(
                f"the rectification turns the cameras {angle:.1f} degrees other than the rotation "
                "between them does: R1 and R2 are of another calibration"
            )
        baseline = given.left @ (-self.rotation.T @ self.translation_m)
        if baseline[0] < (1.0 - _BASELINE_TOLERANCE) * self.baseline_m:
            raise StereoError(
                f"the rectified baseline runs along {np.round(baseline, 3).tolist()} m, not along "
                "the rows: R1 and R2 are of another calibration, or of cameras one above the other"
            )


def _wrong_unit(baseline_m: float) -> str:
    text = f"the baseline is {baseline_m:.4g} m, of {BASELINE_MIN_M:g} to {BASELINE_MAX_M:g} m"
    for unit, size in (("millimetres", 1e-3), ("centimetres", 1e-2), ("inches", 0.0254)):
        if 0.05 <= baseline_m * size <= 1.5:
            return f"{text}: the calibration seems to be in {unit}; correct it, or state baseline_m"
    return f"{text}: correct it, or state baseline_m in metres"
