"""A simulated drive in KITTI's layout reads back as the same drive in a local frame."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from polemap.drivelog.errors import ConfigError
from polemap.drivelog.readers.registry import open_drive
from polemap.drivelog.writers.kitti_odometry import kept_rows, write_kitti_odometry
from polemap.map.io import read_map
from polemap.simulate.camera_mounting import kitti_camera
from polemap.simulate.config import SimulateConfig
from polemap.simulate.drive import simulate_drive
from polemap.simulate.kitti_raw_layout import write_kitti_raw
from polemap.simulate.scenario import Scenario


def ranges(poses: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Poles in the vehicle frame: the same whatever the map's frame is."""
    c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    offset = points[None] - poses[:, None, :2]
    return np.stack(
        [
            c[:, None] * offset[..., 0] + s[:, None] * offset[..., 1],
            -s[:, None] * offset[..., 0] + c[:, None] * offset[..., 1],
        ],
        axis=-1,
    )


def test_poses_and_poles_keep_their_places(
    tmp_path: Path, street: Scenario, small: SimulateConfig
) -> None:
    camera = kitti_camera(width_px=124, height_px=40, focal_px=72.0, frame_rate_hz=1.0)
    config = small.model_copy(update={"camera": camera})
    made = simulate_drive(street, tmp_path / "plain", 1, 4, config, objects=True)
    drive = open_drive(made)
    poles = read_map(made / "objects.geojson", drive.frame)
    back = open_drive(write_kitti_odometry(drive, tmp_path / "kitti", "07", poles.points_m))
    assert back.reference is not None
    assert drive.reference is not None
    assert np.array_equal(back.read_frame(3).left, drive.read_frame(3).left)
    assert back.frame_stamps_s == pytest.approx(drive.frame_stamps_s - drive.frame_stamps_s[0])
    truth = drive.reference.at(drive.frame_stamps_s)
    local = read_map(tmp_path / "kitti" / "poles" / "07.csv", back.frame)
    assert len(local) == len(poles)

    found = ranges(back.reference.at(back.frame_stamps_s), local.points_m)
    expected = ranges(truth, poles.points_m)
    # the reader assumes KITTI's own mounting, which kitti_camera() has to a centimetre or two
    assert np.abs(found - expected).max() < 0.1


def test_a_raw_drive_reads_back_where_it_was_on_the_earth(
    tmp_path: Path, street: Scenario, small: SimulateConfig
) -> None:
    camera = kitti_camera(
        width_px=124, height_px=40, focal_px=72.0, frame_rate_hz=5.0, mount_pitch_rad=0.02
    )
    config = small.model_copy(update={"camera": camera})
    made = simulate_drive(street, tmp_path / "plain", 1, 4, config, objects=True)
    drive = open_drive(made)
    poles = read_map(made / "objects.geojson", drive.frame)
    back = open_drive(write_kitti_raw(drive, tmp_path / "day", poles))
    assert back.frame == drive.frame
    assert np.array_equal(back.read_frame(7).right, drive.read_frame(7).right)
    stamps = back.frame_stamps_s - back.frame_stamps_s[0]
    assert stamps == pytest.approx(drive.frame_stamps_s - drive.frame_stamps_s[0], abs=1e-6)
    assert back.reference is not None
    assert drive.reference is not None
    truth, found = drive.reference.at(drive.frame_stamps_s), back.reference.poses
    # the reader's axle lies straight behind the camera, which is mounted 6 cm to the left
    shift = 0.06 * np.stack([-np.sin(truth[:, 2]), np.cos(truth[:, 2])], 1)
    assert found[:, :2] == pytest.approx(truth[:, :2] + shift, abs=2e-3)
    assert np.abs(np.sin(found[:, 2] - truth[:, 2])).max() < 1e-6
    assert back.rig is not None
    assert drive.rig is not None
    assert back.rig.baseline_m == pytest.approx(drive.rig.baseline_m)
    assert back.rig.cx_px == pytest.approx(drive.rig.cx_px)
    assert back.rig.vehicle_from_camera.pitch_rad == pytest.approx(0.02)
    assert back.odometry is not None
    assert drive.odometry is not None
    way = np.sum(back.odometry.speed_mps[:-1] * np.diff(back.odometry.stamp_s))
    step = np.diff(drive.odometry.stamp_s)
    assert way == pytest.approx(np.sum(drive.odometry.speed_mps[:-1] * step), rel=0.02)
    again = read_map(tmp_path / "day" / "poles.geojson", back.frame)
    assert again.points_m == pytest.approx(poles.points_m, abs=1e-3)


def test_what_the_layout_cannot_hold_is_refused(
    tmp_path: Path, street: Scenario, small: SimulateConfig
) -> None:
    made = simulate_drive(street, tmp_path / "plain", 1, 4, small, images=False)
    with pytest.raises(ConfigError, match="layout needs images; write a folder"):
        write_kitti_odometry(open_drive(made), tmp_path / "kitti")
    assert not (tmp_path / "kitti").exists()
    deep = small.model_copy(update={"camera": small.camera.model_copy(update={"bits": 12})})
    drive = open_drive(simulate_drive(street, tmp_path / "deep", 1, 4, deep))
    with pytest.raises(ConfigError, match="8-bit pictures"):
        write_kitti_odometry(drive, tmp_path / "kitti")
    assert drive.reference is not None
    gone = replace(drive, reference=drive.reference.take(drive.reference.stamp_s < -5))
    with pytest.raises(ConfigError, match=r"knows a pose at 0 of \d+ pictures"):
        write_kitti_odometry(gone, tmp_path / "kitti")


def test_pairs_without_a_pose_are_left_out(
    tmp_path: Path, street: Scenario, small: SimulateConfig
) -> None:
    drive = open_drive(simulate_drive(street, tmp_path / "plain", 1, 4, small))
    assert drive.reference is not None
    middle = float(np.median(drive.frame_stamps_s))
    late = replace(drive, reference=drive.reference.take(drive.reference.stamp_s > middle))
    rows = kept_rows(late)
    assert 2 <= len(rows) < len(drive.frame_stamps_s)
    back = open_drive(write_kitti_odometry(late, tmp_path / "kitti"))
    assert len(back.frame_stamps_s) == len(rows)
    for new, old in enumerate(rows):
        np.testing.assert_array_equal(back.read_frame(new).left, drive.read_frame(int(old)).left)
    stamps = drive.frame_stamps_s[rows]
    np.testing.assert_allclose(np.diff(back.frame_stamps_s), np.diff(stamps), atol=1e-5)
