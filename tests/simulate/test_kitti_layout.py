"""A simulated drive in KITTI's layout reads back as the same drive in a local frame."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from drivelog.drive import open_drive
from drivelog.errors import ConfigError
from polemap.io import read_map
from simulate.config import SimulateConfig, kitti_camera
from simulate.drive import simulate_drive
from simulate.kitti_layout import write_kitti_odometry
from simulate.scenario import Scenario


def test_poses_and_poles_keep_their_places(
    tmp_path: Path, street: Scenario, small: SimulateConfig
) -> None:
    camera = kitti_camera(width_px=124, height_px=40, focal_px=72.0, frame_rate_hz=1.0)
    config = small.model_copy(update={"camera": camera})
    made = simulate_drive(street, tmp_path / "plain", 1, 4, config, objects=True)
    drive = open_drive(made)
    poles = read_map(made / "objects.geojson", drive.frame)
    back = open_drive(write_kitti_odometry(drive, tmp_path / "kitti", "07", poles))
    assert back.reference is not None
    assert drive.reference is not None
    assert np.array_equal(back.read_frame(3).left, drive.read_frame(3).left)
    assert back.frame_stamps_s == pytest.approx(drive.frame_stamps_s - drive.frame_stamps_s[0])
    truth = drive.reference.at(drive.frame_stamps_s)
    local = read_map(tmp_path / "kitti" / "poles" / "07.csv", back.frame)
    assert len(local) == len(poles)

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

    found = ranges(back.reference.at(back.frame_stamps_s), local.points_m)
    expected = ranges(truth, poles.points_m)
    # the reader assumes KITTI's own mounting, which kitti_camera() has to a centimetre or two
    assert np.abs(found - expected).max() < 0.1


def test_what_the_layout_cannot_hold_is_refused(
    tmp_path: Path, street: Scenario, small: SimulateConfig
) -> None:
    made = simulate_drive(street, tmp_path / "plain", 1, 4, small, images=False)
    with pytest.raises(ConfigError, match="needs images and a reference"):
        write_kitti_odometry(open_drive(made), tmp_path / "kitti")
    assert not (tmp_path / "kitti").exists()
    deep = small.model_copy(update={"camera": small.camera.model_copy(update={"bits": 12})})
    drive = open_drive(simulate_drive(street, tmp_path / "deep", 1, 4, deep))
    with pytest.raises(ConfigError, match="8-bit pictures"):
        write_kitti_odometry(drive, tmp_path / "kitti")
    assert drive.reference is not None
    late = replace(drive, reference=drive.reference.rows(drive.reference.stamp_s > 5))
    with pytest.raises(ConfigError, match="does not cover every picture"):
        write_kitti_odometry(late, tmp_path / "kitti")
