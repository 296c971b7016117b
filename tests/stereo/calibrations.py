"""A raw pair, and the files in which calibrations of it come."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, cast

import cv2
import numpy as np
import yaml

from polemap.stereo.calibration import CameraCalibration, Distortion, StereoCalibration
from polemap.stereo.rectify import rectification_of

LENSES = {
    "plumb_bob": np.array([-0.3, 0.1, 0.001, -0.002, 0.01]),
    "rational_polynomial": np.array([0.3, 0.05, 0.001, -0.001, 0.002, 0.6, 0.1, 0.01]),
    "equidistant": np.array([0.02, -0.01, 0.003, -0.001]),
}


def make_calibration(distortion: str = "plumb_bob") -> StereoCalibration:
    cameras = [
        CameraCalibration(
            320,
            240,
            np.array([[f, 0, cx], [0, f + 1, cy], [0, 0, 1.0]]),
            cast(Distortion, distortion),
            LENSES[distortion],
        )
        for f, cx, cy in ((260.0, 161.0, 118.0), (256.0, 157.0, 123.0))
    ]
    rotation = np.asarray(cv2.Rodrigues(np.array([0.02, -0.03, 0.015]))[0], dtype=np.float64)
    return StereoCalibration(cameras[0], cameras[1], rotation, np.array([-0.3, 0.004, -0.01]))


def projections(calibration: StereoCalibration) -> list[np.ndarray]:
    """P `(3, 4)` of both sides of its rectification."""
    given = rectification_of(calibration)
    shift = -given.focal_px * calibration.baseline_m
    row = [0, given.focal_px, given.cy_px, 0]
    return [
        np.array([[given.focal_px, 0, given.cx_px, s], row, [0, 0, 1, 0]]) for s in (0.0, shift)
    ]


def opencv_values(calibration: StereoCalibration) -> dict[str, Any]:
    """What stereoCalibrate and stereoRectify give, under the names of OpenCV's samples."""
    given = rectification_of(calibration)
    p = projections(calibration)
    return {
        "M1": calibration.left.matrix, "D1": calibration.left.coefficients[None],
        "M2": calibration.right.matrix, "D2": calibration.right.coefficients[None],
        "R": calibration.rotation, "T": calibration.translation_m[:, None],
        "R1": given.left, "R2": given.right, "P1": p[0], "P2": p[1],
        "image_width": calibration.left.width_px, "image_height": calibration.left.height_px,
    }  # fmt: skip


def write_opencv(path: Path, values: dict[str, Any]) -> Path:
    """By OpenCV itself; the ending chooses YAML, XML or JSON."""
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    for name, value in values.items():
        storage.write(name, value)
    storage.release()
    return path


def write_kalibr(path: Path, calibration: StereoCalibration) -> Path:
    model = {"plumb_bob": "radtan", "equidistant": "equidistant"}[calibration.left.distortion]
    tree: dict[str, Any] = {}
    for name, camera in (("cam0", calibration.left), ("cam1", calibration.right)):
        k = camera.matrix
        tree[name] = {
            "camera_model": "pinhole",
            "distortion_model": model,
            "distortion_coeffs": camera.coefficients[:4].tolist(),
            "intrinsics": [float(v) for v in (k[0, 0], k[1, 1], k[0, 2], k[1, 2])],
            "resolution": [camera.width_px, camera.height_px],
            "rostopic": f"/{name}/image_raw",
        }
    step = np.eye(4)
    step[:3, :3], step[:3, 3] = calibration.rotation, calibration.translation_m
    tree["cam1"]["T_cn_cnm1"] = step.tolist()
    path.write_text(yaml.safe_dump(tree))
    return path


def write_ros(folder: Path, calibration: StereoCalibration) -> list[Path]:
    given, p = rectification_of(calibration), projections(calibration)
    paths = []
    for k, (name, camera) in enumerate((("l", calibration.left), ("r", calibration.right))):
        tree = {
            "image_width": camera.width_px,
            "image_height": camera.height_px,
            "distortion_model": camera.distortion,
            "camera_matrix": {"rows": 3, "cols": 3, "data": camera.matrix.ravel().tolist()},
            "distortion_coefficients": {"data": camera.coefficients.tolist()},
            "rectification_matrix": {"data": (given.left, given.right)[k].ravel().tolist()},
            "projection_matrix": {"data": p[k].ravel().tolist()},
        }
        paths.append(folder / f"{name}.yaml")
        paths[-1].write_text(yaml.safe_dump(tree))
    return paths


def write_kitti(path: Path, calibration: StereoCalibration) -> Path:
    """`calib_cam_to_cam.txt` of two cameras, the rectification of its own included."""
    given, p = rectification_of(calibration), projections(calibration)
    lines = ["calib_time: 09-Jan-2012 13:57:47"]
    for tag, camera, r, t, turn, projection in (
        ("00", calibration.left, np.eye(3), np.zeros(3), given.left, p[0]),
        ("01", calibration.right, calibration.rotation, calibration.translation_m,
         given.right, p[1]),
    ):  # fmt: skip
        for key, value in (
            ("S", np.array([camera.width_px, camera.height_px])), ("K", camera.matrix),
            ("D", camera.coefficients), ("R", r), ("T", t),
            ("S_rect", np.array([given.width_px, given.height_px])), ("R_rect", turn),
            ("P_rect", projection),
        ):  # fmt: skip
            text = " ".join(f"{number:.12e}" for number in np.ravel(value))
            lines.append(f"{key}_{tag}: {text}")
    path.write_text("\n".join(lines) + "\n")
    return path


Writer = Callable[[Path, StereoCalibration], Path | list[Path]]
WRITERS: dict[str, Writer] = {
    "opencv yaml": lambda folder, c: write_opencv(folder / "c.yml", opencv_values(c)),
    "opencv xml": lambda folder, c: write_opencv(folder / "c.xml", opencv_values(c)),
    "opencv json": lambda folder, c: write_opencv(folder / "c.json", opencv_values(c)),
    "ros": write_ros,
}
