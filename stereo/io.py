"""Raw stereo calibrations from the disk: KITTI text files and ROS CameraInfo YAML."""

from __future__ import annotations

from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from polemap.parsing.errors import named, short
from polemap.parsing.text import MEGABYTE, read_text
from polemap.parsing.yaml_text import read_yaml
from polemap.stereo.errors import StereoError
from polemap.stereo.rectify import CameraCalibration, Distortion, StereoCalibration

Floats = NDArray[np.float64]

_ROS_NAMES = {"": "plumb_bob", "fisheye": "equidistant", "radtan": "plumb_bob"}


def _read_text(path: Path) -> str:
    with named(path, StereoError, "calibration"):
        return read_text(path, MEGABYTE)


def read_kitti_calibration(path: Path, left: int = 0, right: int = 1) -> StereoCalibration:
    """The raw cameras `left` and `right` of a KITTI raw `calib_cam_to_cam.txt`.

    Raises:
        StereoError: the file cannot be read, or lacks a line or a number.
    """
    rows: dict[str, str] = {}
    for line in _read_text(path).splitlines():
        key, colon, value = line.partition(":")
        if colon:
            rows[key.strip()] = value

    def numbers(key: str, count: int) -> Floats:
        if key not in rows:
            raise StereoError(f"{path}: has no line '{key}:'")
        try:
            values = np.array([float(part) for part in rows[key].split()])
        except ValueError as error:
            raise StereoError(f"{path}: line '{key}:' holds no numbers ({short(error)})") from error
        if len(values) != count or not np.isfinite(values).all():
            raise StereoError(f"{path}: line '{key}:' needs {count} finite numbers")
        return values

    cameras, rotations, translations = [], [], []
    for number in (left, right):
        tag = f"{number:02d}"
        width, height = numbers(f"S_{tag}", 2)
        cameras.append(
            CameraCalibration(
                int(width),
                int(height),
                numbers(f"K_{tag}", 9).reshape(3, 3),
                "plumb_bob",
                numbers(f"D_{tag}", 5),
            )
        )
        rotations.append(numbers(f"R_{tag}", 9).reshape(3, 3))
        translations.append(numbers(f"T_{tag}", 3))
    rotation = rotations[1] @ rotations[0].T
    return StereoCalibration(
        cameras[0], cameras[1], rotation, translations[1] - rotation @ translations[0]
    )


def read_camera_info(left: Path, right: Path) -> StereoCalibration:
    """A pair of ROS CameraInfo YAML files, as the camera_calibration package writes them.

    The baseline is in the right projection matrix, the rotation in the rectification matrices.

    Raises:
        StereoError: a file cannot be read, lacks a key, or the pair has no baseline.
    """
    cameras, rectifications, projections = [], [], []
    for path in (left, right):
        tree = _camera_info(path)
        name = str(_entry(path, tree, "distortion_model", "D_model") or "")
        distortion = cast(Distortion, _ROS_NAMES.get(name, name))
        coefficients = _matrix(path, tree, ("distortion_coefficients", "D", "d"), None)
        try:
            camera = CameraCalibration(
                int(_entry(path, tree, "image_width", "width")),
                int(_entry(path, tree, "image_height", "height")),
                _matrix(path, tree, ("camera_matrix", "K", "k"), (3, 3)),
                distortion,
                coefficients,
            )
        except (StereoError, TypeError, ValueError) as error:
            raise StereoError(f"{path}: {error}") from error
        cameras.append(camera)
        rectifications.append(_matrix(path, tree, ("rectification_matrix", "R", "r"), (3, 3)))
        projections.append(_matrix(path, tree, ("projection_matrix", "P", "p"), (3, 4)))
    baseline = -projections[1][0, 3] / projections[1][0, 0]
    if not baseline > 0:
        raise StereoError(
            f"{right}: projection_matrix has no baseline (its fourth number is not negative): "
            "this is the left camera, or the pair was calibrated one by one"
        )
    left_rect, right_rect = rectifications
    # X_right = R_r^T (R_l X_left - (b, 0, 0))
    rotation = right_rect.T @ left_rect
    translation = -right_rect.T @ np.array([baseline, 0.0, 0.0])
    return StereoCalibration(cameras[0], cameras[1], rotation, translation)


def _camera_info(path: Path) -> dict[str, Any]:
    with named(path, StereoError, "calibration"):
        tree = read_yaml(path)
    if not isinstance(tree, dict):
        raise StereoError(f"{path}: is not a CameraInfo (no keys)")
    return tree


def _entry(path: Path, tree: dict[str, Any], *names: str) -> Any:
    for name in names:
        if name in tree:
            return tree[name]
    raise StereoError(f"{path}: has no '{names[0]}'")


def _matrix(
    path: Path, tree: dict[str, Any], names: tuple[str, ...], shape: tuple[int, int] | None
) -> Floats:
    value = _entry(path, tree, *names)
    if isinstance(value, dict):
        value = value.get("data")
    try:
        numbers = np.array(value, dtype=np.float64).ravel()
    except (TypeError, ValueError) as error:
        raise StereoError(f"{path}: '{names[0]}' holds no numbers") from error
    if not np.isfinite(numbers).all() or (shape is not None and numbers.size != np.prod(shape)):
        raise StereoError(f"{path}: '{names[0]}' needs {shape or 'finite'} numbers")
    return numbers if shape is None else numbers.reshape(shape)
