"""Calibrations as OpenCV, Kalibr and ROS name them, from the values that a file holds."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polemap.stereo.calibration import (
    CameraCalibration,
    Rectification,
    StereoCalibration,
    check_rotation,
    lens_model,
)
from polemap.stereo.camera_info import CameraInfo, camera_info, of_camera_infos
from polemap.stereo.errors import StereoError

Floats = NDArray[np.float64]
Tree = Mapping[str, Any]

_MATRIX = ("M{}", "K{}", "cameraMatrix{}", "camera_matrix{}", "camera_matrix_{}", "CM{}")
_LENS = ("D{}", "distCoeffs{}", "dist_coeffs{}", "distCoeffs_{}", "dist{}", "distortion{}")
_WIDTH = ("image_width", "width", "imageWidth", "Camera.width")
_HEIGHT = ("image_height", "height", "imageHeight", "Camera.height")
_SIZE = ("image_size", "imageSize", "size", "resolution")


@dataclass(frozen=True, slots=True)
class Stated:
    """What the user says beside the file.

    Attributes:
        cameras: names of left and right in a file with several; None for the first two.
        distortion_model: stands for what the file does not say.
        baseline_m: the measured one; a translation in another unit is scaled to it.
        size_px: width and height of the pictures, for files that hold none.
    """

    cameras: tuple[str, str] | None = None
    distortion_model: str | None = None
    baseline_m: float | None = None
    size_px: tuple[int, int] | None = None

    def scaled(self, translation: Floats) -> Floats:
        """A translation in the length that is stated, where one is."""
        length = float(np.linalg.norm(translation))
        if self.baseline_m is None or not length > 0.0:
            return translation
        return np.asarray(translation * (self.baseline_m / length))


def first_of(tree: Tree, names: tuple[str, ...], number: int | str = "") -> Any:
    """The value of the first name that is there.

    Raises:
        StereoError: none is.
    """
    wanted = [name.format(number) for name in names]
    for name in wanted:
        if name in tree:
            return tree[name]
    raise StereoError(f"has no '{wanted[0]}' (or {', '.join(wanted[1:4]) or 'another name'})")


def _leaves(value: Any) -> Iterator[Any]:
    """What lists in lists hold."""
    if isinstance(value, list | tuple):
        for one in value:
            yield from _leaves(one)
    else:
        yield value


def numbers(name: str, value: Any, count: int | None = None) -> Floats:
    """A flat array of `count` finite numbers, from a matrix, list or dict with `data`.

    Raises:
        StereoError: no numbers, or not as many.
    """
    if isinstance(value, dict):
        value = value.get("data")
    if value is None:
        value = []
    try:
        raw = np.array(value)
        if raw.dtype == np.bool_ or any(isinstance(one, bool) for one in _leaves(value)):
            raise ValueError("true and false are no numbers")
        found = raw.astype(np.float64).ravel()
    except (TypeError, ValueError) as error:
        raise StereoError(f"'{name}' holds no numbers") from error
    if not np.isfinite(found).all():
        raise StereoError(f"'{name}' holds a value that is not finite")
    if count is not None and found.size != count:
        raise StereoError(f"'{name}' needs {count} numbers, not {found.size}")
    return np.asarray(found)


def of_opencv(tree: Tree, stated: Stated) -> StereoCalibration:
    """What `stereoCalibrate` found, under the names that its samples and tutorials write.

    Raises:
        StereoError: a name is missing, or a value cannot be.
    """
    if "LEFT.K" in tree:
        return _of_prefixed(tree, stated)
    size = _size(tree, stated)
    cameras = [_opencv_camera(tree, number, size, stated) for number in (1, 2)]
    if "R" not in tree and "P2" in tree:
        infos = [
            CameraInfo(
                camera,
                numbers(f"R{n}", first_of(tree, ("R{}",), n), 9).reshape(3, 3),
                numbers(f"P{n}", first_of(tree, ("P{}",), n), 12).reshape(3, 4),
            )
            for n, camera in enumerate(cameras, start=1)
        ]
        return of_camera_infos(infos[0], infos[1], stated.baseline_m)
    rotation = numbers("R", first_of(tree, ("R", "Rot", "rotation")))
    if rotation.size == 3:
        raise StereoError("'R' holds 3 numbers, a rotation matrix of 9 is needed")
    translation = numbers("T", first_of(tree, ("T", "Trans", "translation")), 3)
    rectification = None
    if all(name in tree for name in ("R1", "R2", "P1")):
        p = numbers("P1", tree["P1"], 12).reshape(3, 4)
        rectification = Rectification(
            numbers("R1", tree["R1"], 9).reshape(3, 3),
            numbers("R2", tree["R2"], 9).reshape(3, 3),
            float(p[0, 0]), float(p[0, 2]), float(p[1, 2]), size[0], size[1],
        )  # fmt: skip
    return StereoCalibration(
        cameras[0], cameras[1], numbers("R", rotation, 9).reshape(3, 3),
        stated.scaled(translation), rectification,
    )  # fmt: skip


def _opencv_camera(
    tree: Tree, number: int, size: tuple[int, int], stated: Stated
) -> CameraCalibration:
    matrix = numbers(f"M{number}", first_of(tree, _MATRIX, number), 9).reshape(3, 3)
    lens = numbers(f"D{number}", first_of(tree, _LENS, number))
    model = stated.distortion_model or str(
        tree.get("distortion_model", tree.get("camera_model", "plumb_bob"))
    )
    try:
        return CameraCalibration(size[0], size[1], matrix, lens_model(model, len(lens)), lens)
    except StereoError as error:
        raise StereoError(f"camera {number}: {error}") from error


def _of_prefixed(tree: Tree, stated: Stated) -> StereoCalibration:
    """LEFT.K, LEFT.D, LEFT.R, LEFT.P and the same of RIGHT, as ORB-SLAM's files have them."""
    infos = []
    for side in ("LEFT", "RIGHT"):
        sized = {name: tree[f"{side}.{name}"] for name in ("width", "height")
                 if f"{side}.{name}" in tree}  # fmt: skip
        matrices = [numbers(f"{side}.{n}", first_of(tree, (f"{side}.{n}",))) for n in "KDRP"]
        infos.append(
            camera_info(
                _size(sized or tree, stated), stated.distortion_model or "plumb_bob", matrices
            )
        )
    return of_camera_infos(infos[0], infos[1], stated.baseline_m)


def _size(tree: Tree, stated: Stated) -> tuple[int, int]:
    """Width and height in pixels, as the file or, where it holds none, the user states them."""
    for name in _SIZE:
        if name in tree:
            width, height = numbers(name, tree[name], 2)
            if width % 1.0 or height % 1.0:
                raise StereoError(f"'{name}' holds no whole numbers")
            return int(width), int(height)
    if stated.size_px is not None and not any(name in tree for name in _WIDTH):
        return stated.size_px
    try:
        return int(first_of(tree, _WIDTH)), int(first_of(tree, _HEIGHT))
    except StereoError as error:
        raise StereoError(
            f"{error}: state the pictures' size, width_px and height_px, beside the calibration"
        ) from error
    except (TypeError, ValueError, OverflowError) as error:
        raise StereoError("the image size holds no whole numbers") from error


def of_kalibr(tree: Tree, stated: Stated) -> StereoCalibration:
    """Two cameras of a Kalibr camchain; `T_cn_cnm1` leads from each camera to the next.

    Raises:
        StereoError: a camera or key is missing, or the camera model is no pinhole.
    """
    names = sorted((name for name in tree if name.startswith("cam") and name[3:].isdigit()),
                   key=lambda name: int(name[3:]))  # fmt: skip
    chosen = stated.cameras or tuple(names[:2])
    missing = [name for name in chosen if name not in names]
    if len(chosen) < 2 or missing:
        raise StereoError(
            f"the camchain has {', '.join(names) or 'no camera'}, two are needed"
            + (f" and '{missing[0]}' is none of them" if missing else "")
        )
    from_first = {names[0]: np.eye(4)}
    for before, name in pairwise(names):
        step = numbers(f"{name}.T_cn_cnm1", tree[name].get("T_cn_cnm1"), 16).reshape(4, 4)
        check_rotation(f"the rotation in {name}.T_cn_cnm1", step[:3, :3])
        from_first[name] = step @ from_first[before]
    left, right = (_kalibr_camera(name, tree[name], stated) for name in chosen)
    move = from_first[chosen[1]] @ np.linalg.inv(from_first[chosen[0]])
    try:
        return StereoCalibration(left, right, move[:3, :3], stated.scaled(move[:3, 3]))
    except StereoError as error:
        raise StereoError(f"{chosen[0]}, {chosen[1]}: {error}") from error


def _kalibr_camera(name: str, tree: Tree, stated: Stated) -> CameraCalibration:
    kind = str(tree.get("camera_model", "pinhole"))
    if kind != "pinhole":
        raise StereoError(f"{name}: camera_model '{kind[:40]}' is not read, only pinhole")
    fx, fy, cx, cy = numbers(f"{name}.intrinsics", tree.get("intrinsics"), 4)
    lens = numbers(f"{name}.distortion_coeffs", tree.get("distortion_coeffs"))
    model = stated.distortion_model or str(tree.get("distortion_model", "plumb_bob"))
    width, height = numbers(f"{name}.resolution", tree.get("resolution"), 2)
    if width % 1.0 or height % 1.0:
        raise StereoError(f"'{name}.resolution' holds no whole numbers")
    matrix = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
    try:
        return CameraCalibration(
            int(width), int(height), matrix, lens_model(model, len(lens)), lens
        )
    except StereoError as error:
        raise StereoError(f"{name}: {error}") from error


def of_ros(tree: Tree, stated: Stated) -> CameraInfo:
    """One CameraInfo, as the camera_calibration package or an echoed message writes it.

    Raises:
        StereoError: a key is missing, or a value cannot be.
    """
    names = (
        ("camera_matrix", "K", "k"),
        ("distortion_coefficients", "D", "d"),
        ("rectification_matrix", "R", "r"),
        ("projection_matrix", "P", "p"),
    )
    model = str(first_of(tree, ("distortion_model", "D_model")))
    matrices = [numbers(name[0], first_of(tree, name)) for name in names]
    return camera_info(_size(tree, stated), stated.distortion_model or model, matrices)
