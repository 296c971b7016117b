"""Rectification against KITTI's own, against projection by hand, and through files."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
import yaml

from polemap.stereo.calibration import CameraCalibration, StereoCalibration
from polemap.stereo.errors import StereoError
from polemap.stereo.io import read_calibration, read_kitti_calibration
from polemap.stereo.rectify import Rectifier, rectifying_rotations
from tests.stereo.calibrations import LENSES, make_calibration, write_ros


def raw_pixels(camera, points):
    """Pixels of camera points, written out from the lens equations."""
    x, y = points[:, 0] / points[:, 2], points[:, 1] / points[:, 2]
    k = camera.coefficients
    if camera.distortion == "equidistant":
        r = np.hypot(x, y)
        t = np.arctan(r)
        bent = t * (1 + k[0] * t**2 + k[1] * t**4 + k[2] * t**6 + k[3] * t**8)
        x, y = x * bent / r, y * bent / r
    else:
        r2 = x * x + y * y
        top = 1 + k[0] * r2 + k[1] * r2**2 + k[4] * r2**3
        below = 1 + k[5] * r2 + k[6] * r2**2 + k[7] * r2**3 if len(k) == 8 else 1.0
        x, y = (
            x * top / below + 2 * k[2] * x * y + k[3] * (r2 + 2 * x * x),
            y * top / below + k[2] * (r2 + 2 * y * y) + 2 * k[3] * x * y,
        )
    return np.stack(
        [
            camera.matrix[0, 0] * x + camera.matrix[0, 2],
            camera.matrix[1, 1] * y + camera.matrix[1, 2],
        ]
    )


@pytest.mark.parametrize("distortion", list(LENSES))
def test_a_point_falls_where_the_rig_says(distortion):
    calibration = make_calibration(distortion)
    rectifier = Rectifier(calibration)
    rig = rectifier.rig
    rng = np.random.default_rng(2)
    points = rng.uniform([-1, -0.8, 4], [1, 0.8, 9], (40, 3))  # left camera
    right_points = points @ calibration.rotation.T + calibration.translation_m
    rectified = points @ rectifying_rotations(calibration)[0].T
    u = rig.cx_px + rig.focal_px * rectified[:, 0] / rectified[:, 2]
    v = rig.cy_px + rig.focal_px * rectified[:, 1] / rectified[:, 2]
    d = rig.focal_px * rig.baseline_m / rectified[:, 2]
    for side, camera, where, columns in (
        (0, calibration.left, points, u),
        (1, calibration.right, right_points, u - d),
    ):
        raw = raw_pixels(camera, where)
        map_x, map_y = rectifier.maps()[side]
        got = [
            cv2.remap(m, columns.astype(np.float32), v.astype(np.float32), cv2.INTER_LINEAR)
            for m in (map_x, map_y)
        ]
        # remap rounds its weights to 1/32 px of slowly varying maps
        np.testing.assert_allclose(np.ravel(got[0]), raw[0], atol=0.06)
        np.testing.assert_allclose(np.ravel(got[1]), raw[1], atol=0.06)


def test_kitti_cameras_give_kittis_baseline_and_rotation(recording):
    path = recording("kitti_raw") / "2011_09_26" / "calib_cam_to_cam.txt"
    calibration = read_kitti_calibration(path)
    left, _ = rectifying_rotations(calibration)
    rows = dict(line.split(":", 1) for line in path.read_text().splitlines() if ":" in line)
    published = np.array(rows["R_rect_00"].split(), dtype=float).reshape(3, 3)
    projection = np.array(rows["P_rect_01"].split(), dtype=float).reshape(3, 4)
    baseline = -projection[0, 3] / projection[0, 0]
    assert np.linalg.norm(calibration.translation_m) == pytest.approx(baseline, abs=1e-3)
    # KITTI rectified all four cameras at once, so a turn about the baseline is free
    turn = left @ published.T
    assert np.arccos(np.clip(turn[0, 0], -1, 1)) < np.radians(0.3)


def test_ros_files_come_back_as_the_same_geometry(tmp_path):
    calibration = make_calibration()
    paths = write_ros(tmp_path, calibration)
    again = read_calibration(paths)
    np.testing.assert_allclose(again.rotation, calibration.rotation, atol=1e-9)
    np.testing.assert_allclose(again.translation_m, calibration.translation_m, atol=1e-9)
    with pytest.raises(StereoError, match="no baseline"):
        read_calibration(paths[::-1])
    paths[0].write_text(yaml.safe_dump({"image_width": 3, "projection_matrix": []}))
    with pytest.raises(StereoError, match=r"l\.yaml: has no 'distortion_model'"):
        read_calibration(paths)


def test_what_is_no_calibration_is_refused(tmp_path):
    good = make_calibration()
    with pytest.raises(StereoError, match="exchange the cameras"):
        StereoCalibration(good.left, good.right, np.eye(3), np.array([0.3, 0, 0]))
    with pytest.raises(StereoError, match="no rotation matrix"):
        StereoCalibration(good.left, good.right, 2 * np.eye(3), np.array([-0.3, 0, 0]))
    with pytest.raises(StereoError, match="lens model"):
        CameraCalibration(3, 3, np.eye(3), "bent", np.zeros(5))
    with pytest.raises(StereoError, match="coefficients, not 3"):
        CameraCalibration(3, 3, np.eye(3), "plumb_bob", np.zeros(3))
    with pytest.raises(StereoError, match="focal"):
        CameraCalibration(3, 3, np.zeros((3, 3)), "plumb_bob", np.zeros(5))
    with pytest.raises(StereoError, match="raw images"):
        Rectifier(good).rectify(np.zeros((3, 3), np.uint8), np.zeros((240, 320), np.uint8))
    with pytest.raises(StereoError, match="cannot be read"):
        read_kitti_calibration(tmp_path / "none.txt")
    (tmp_path / "c.txt").write_text("S_00: 3 x\n")
    with pytest.raises(StereoError, match=r"c\.txt: line 'S_00:'"):
        read_kitti_calibration(tmp_path / "c.txt")
