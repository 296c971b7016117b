"""Raw stereo calibrations from the disk: OpenCV, Kalibr, ROS CameraInfo and KITTI files."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polemap.parsing.errors import named, short
from polemap.parsing.opencv_text import parse_opencv
from polemap.parsing.text import MEGABYTE, read_text
from polemap.stereo.calibration import CameraCalibration, Rectification, StereoCalibration
from polemap.stereo.calibration_trees import Stated, of_kalibr, of_opencv, of_ros
from polemap.stereo.camera_info import of_camera_infos
from polemap.stereo.errors import StereoError

Floats = NDArray[np.float64]

_KINDS = (
    "OpenCV (M1, D1, M2, D2, R, T), a Kalibr camchain (cam0, cam1), two ROS CameraInfo files, "
    "KITTI's calib_cam_to_cam.txt"
)


def read_calibration(
    paths: Path | Sequence[Path], stated: Stated | None = None
) -> StereoCalibration:
    """The calibration of a raw pair, of whatever kind its file is.

    Args:
        paths: one file, or two: left and right CameraInfo, or OpenCV's intrinsics and extrinsics.
        stated: what is known beside the file.

    Raises:
        StereoError: a file cannot be read, is of no known kind, or says what cannot be.
    """
    stated = stated or Stated()
    files = [paths] if isinstance(paths, Path) else list(paths)
    if not 1 <= len(files) <= 2:
        raise StereoError(f"a calibration is one file or two, not {len(files)}")
    texts = [_read_text(file) for file in files]
    if len(files) == 1 and "S_00:" in texts[0] and "K_00:" in texts[0]:
        return read_kitti_calibration(files[0], *(stated.cameras or ("00", "01")))
    trees = []
    for file, text in zip(files, texts, strict=True):
        with named(file, StereoError, "calibration"):
            trees.append(parse_opencv(text))
    place = " and ".join(str(file) for file in files)
    if len(trees) == 2 and all(_is_camera_info(tree) for tree in trees):
        infos = []
        for file, tree in zip(files, trees, strict=True):
            with _at(str(file)):
                infos.append(of_ros(tree, stated))
        with _at(place):
            return of_camera_infos(infos[0], infos[1], stated.baseline_m)
    tree = {name: value for one in trees for name, value in one.items()}
    with _at(place):
        return _of_tree(tree, stated)


def _of_tree(tree: Mapping[str, Any], stated: Stated) -> StereoCalibration:
    if any(name.startswith("cam") and name[3:].isdigit() for name in tree):
        chain = {name: part for name, part in tree.items() if isinstance(part, dict)}
        return of_kalibr(chain, stated)
    if _is_camera_info(tree):
        raise StereoError("is the CameraInfo of one camera: name both files, the left one first")
    if not any(name in tree for name in ("R", "T", "P2", "M1", "K1", "cameraMatrix1", "LEFT.K")):
        raise StereoError(f"is no stereo calibration of a known kind: {_KINDS}")
    return of_opencv(tree, stated)


def _is_camera_info(tree: Mapping[str, Any]) -> bool:
    return any(key in tree for key in ("projection_matrix", "P", "p", "rectification_matrix")) or (
        "camera_matrix" in tree and "distortion_model" in tree
    )


@contextmanager
def _at(place: str) -> Iterator[None]:
    """Errors of the block begin with a place."""
    try:
        yield
    except StereoError as error:
        raise StereoError(f"{place}: {error}") from error


def _read_text(path: Path) -> str:
    with named(path, StereoError, "calibration"):
        return read_text(path, MEGABYTE)


def read_kitti_calibration(path: Path, left: str = "00", right: str = "01") -> StereoCalibration:
    """The raw cameras `left` and `right` of a KITTI raw `calib_cam_to_cam.txt`.

    The file's own rectification (R_rect, P_rect, S_rect) comes with them, where it is there: with
    it `_extract` pictures become those of the `_sync` drive.

    Raises:
        StereoError: the file cannot be read, or lacks a line or a number.
    """
    rows: dict[str, str] = {}
    for line in _read_text(path).splitlines():
        key, colon, value = line.partition(":")
        if colon:
            rows[key.strip()] = value

    def row(key: str, count: int) -> Floats:
        if key not in rows:
            raise StereoError(f"has no line '{key}:'")
        try:
            values = np.array([float(part) for part in rows[key].split()])
        except ValueError as error:
            raise StereoError(f"line '{key}:' holds no numbers ({short(error)})") from error
        if len(values) != count or not np.isfinite(values).all():
            raise StereoError(f"line '{key}:' needs {count} finite numbers")
        return values

    cameras, rotations, translations = [], [], []
    with _at(str(path)):
        for tag in (left, right):
            width, height = row(f"S_{tag}", 2)
            matrix, lens = row(f"K_{tag}", 9).reshape(3, 3), row(f"D_{tag}", 5)
            with _at(f"camera {tag}"):
                cameras.append(
                    CameraCalibration(int(width), int(height), matrix, "plumb_bob", lens)
                )
            rotations.append(row(f"R_{tag}", 9).reshape(3, 3))
            translations.append(row(f"T_{tag}", 3))
        rectification = None
        if all(f"{key}_{tag}" in rows for key in ("R_rect", "P_rect") for tag in (left, right)):
            p = row(f"P_rect_{left}", 12).reshape(3, 4)
            width, height = row(f"S_rect_{left}", 2)
            rectification = Rectification(
                row(f"R_rect_{left}", 9).reshape(3, 3), row(f"R_rect_{right}", 9).reshape(3, 3),
                float(p[0, 0]), float(p[0, 2]), float(p[1, 2]), int(width), int(height),
            )  # fmt: skip
        rotation = rotations[1] @ rotations[0].T
        translation = translations[1] - rotation @ translations[0]
        return StereoCalibration(cameras[0], cameras[1], rotation, translation, rectification)
