"""KITTI sequences and raw drives: real ones, and small ones made to be damaged."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from polemap.drivelog.errors import InputError
from polemap.drivelog.frames import EarthFrame
from polemap.drivelog.readers import derived
from polemap.drivelog.readers.registry import open_drive
from tests.drivelog.drives import picture, png

Recording = Callable[[str], Path]


def make_sequence(root: Path, n: int = 30) -> Path:
    """A car that drives a left bend at 8 m/s; the camera looks straight ahead and is level."""
    folder = root / "sequences" / "07"
    t = 0.1 * np.arange(n)
    yaw = 0.05 * np.maximum(t - 1.5, 0.0)
    chord = (yaw[1:] + yaw[:-1]) / 2.0  # an arc's chord points along its mean heading
    step = 0.8 * np.stack([np.cos(chord), np.sin(chord)], axis=1)
    axle = np.concatenate([[[0.0, 0.0]], np.cumsum(step, axis=0)])
    rows = []
    for (x, y), angle in zip(axle, yaw, strict=True):
        c, s = np.cos(angle), np.sin(angle)
        camera = np.array([x + 1.03 * c, y + 1.03 * s]) - (1.03, 0.0)
        # camera axes: x right, y down, z forward; the first camera is the origin
        rotation = np.array([[c, 0, -s], [0, 1, 0], [s, 0, c]])
        rows.append(np.column_stack([rotation, [-camera[1], 0.0, camera[0]]]).ravel())
    (root / "poses").mkdir(parents=True)
    np.savetxt(root / "poses" / "07.txt", np.array(rows))
    for side in (0, 1):
        for i in range(n):
            png(folder / f"image_{side}" / f"{i:06d}.png", picture(i + side))
    np.savetxt(folder / "times.txt", t)
    p = "80 0 31.5 {shift} 0 80 23.5 0 0 0 1 0"
    lidar = "0 -1 0 0  0 0 -1 -0.08  1 0 0 -0.27"
    lines = [f"P0: {p.format(shift=0)}", f"P1: {p.format(shift=-24)}", f"Tr: {lidar}"]
    (folder / "calib.txt").write_text("\n".join(lines) + "\n")
    return folder


def test_poses_of_the_camera_become_poses_of_the_rear_axle(tmp_path: Path) -> None:
    drive = open_drive(make_sequence(tmp_path))
    assert drive.frame == EarthFrame("local", name="kitti_odometry_07")
    assert drive.reference is not None
    poses = drive.reference.poses
    # the LiDAR hangs 0.76 m ahead of the axle, and its frame is the map's
    np.testing.assert_allclose(poses[0], [-0.76, 0.0, 0.0], atol=1e-5)
    np.testing.assert_allclose(
        np.linalg.norm(np.diff(poses[:, :2], axis=0), axis=1), 0.8, atol=1e-6
    )
    assert poses[-1, 2] == pytest.approx(0.05 * (2.9 - 1.5), abs=1e-5)
    rig = drive.rig
    assert rig is not None
    assert rig.baseline_m == pytest.approx(0.3)
    assert rig.vehicle_from_camera.yaw_rad == pytest.approx(0.0, abs=1e-5)
    assert rig.vehicle_from_camera.x_m == pytest.approx(1.03)


def test_a_camera_that_looks_aside_is_found_out(tmp_path: Path) -> None:
    """The car's axis is the one along which the rear axle moves, not the one it looks along."""
    folder = make_sequence(tmp_path)
    poses = np.loadtxt(tmp_path / "poses" / "07.txt").reshape(-1, 3, 4)
    angle, dip = 0.012, -0.02
    c, s = np.cos(angle), np.sin(angle)
    aside = np.array([[c, 0, -s], [0, 1, 0], [s, 0, c]])  # camera axes from turned camera axes
    down = np.array([[1, 0, 0], [0, np.cos(dip), -np.sin(dip)], [0, np.sin(dip), np.cos(dip)]])
    turn = aside @ down
    turned = [np.column_stack([turn.T @ p[:, :3] @ turn, turn.T @ p[:, 3]]).ravel() for p in poses]
    np.savetxt(tmp_path / "poses" / "07.txt", np.array(turned))
    rig = open_drive(folder).rig
    assert rig is not None
    assert rig.vehicle_from_camera.yaw_rad == pytest.approx(angle, abs=3e-4)
    assert rig.vehicle_from_camera.pitch_rad == pytest.approx(-dip, abs=3e-4)


def test_derived_sensors_are_seeded_and_said_to_be_derived(tmp_path: Path) -> None:
    folder = make_sequence(tmp_path)
    one, again, other = (open_drive(folder, seed=seed) for seed in (1, 1, 2))
    assert one.odometry is not None
    assert again.odometry is not None
    assert other.odometry is not None
    np.testing.assert_array_equal(one.odometry.speed_mps, again.odometry.speed_mps)
    assert np.abs(one.odometry.speed_mps - other.odometry.speed_mps).max() > 0.01
    assert sum("was not measured" in note for note in one.notes) == 2


def test_derived_noise_is_as_stated() -> None:
    """Statistics over 300 drives; tolerances are four standard errors."""
    t = 0.1 * np.arange(600)
    poses = np.column_stack([10.0 * t, np.zeros(600), np.zeros(600)])
    speed, bias, white, gnss, late = [], [], [], [], []
    for seed in range(300):
        rng = np.random.default_rng(seed)
        odometry = derived.derived_odometry(t, poses, rng)
        fixes = derived.derived_gnss(t, poses, rng)
        speed.append(odometry.speed_mps.mean() / 10.0 - 1.0)
        white.append(odometry.speed_mps.std())
        bias.append(odometry.yaw_rate_radps.mean())
        gnss.append([fixes.north_m[0], fixes.north_m[-1]])
        late.append(fixes.north_m[50] * fixes.north_m[0])
    assert np.std(speed) == pytest.approx(0.01, rel=4 / np.sqrt(600))
    assert np.mean(white) == pytest.approx(0.05, rel=0.01)
    np.testing.assert_allclose(np.abs(bias), 0.001, atol=4 * 0.002 / np.sqrt(3000))
    assert 90 < np.count_nonzero(np.array(bias) > 0) < 210
    assert np.std(gnss) == pytest.approx(2.5, rel=4 / np.sqrt(2 * 500))
    # 50 fixes at 5 Hz are 10 s of 60
    assert np.mean(late) / 2.5**2 == pytest.approx(np.exp(-10 / 60), abs=4 * 1.4 / np.sqrt(300))


def test_without_poses_there_is_no_reference(tmp_path: Path) -> None:
    folder = make_sequence(tmp_path)
    (tmp_path / "poses" / "07.txt").unlink()
    drive = open_drive(folder)
    assert drive.reference is None
    assert drive.odometry is None
    assert drive.has_frames
    assert any("no poses lie beside" in note for note in drive.notes)


def test_an_excerpt_may_end_early_and_have_holes(tmp_path: Path) -> None:
    folder = make_sequence(tmp_path)
    for i in (28, 29):
        (folder / "image_1" / f"{i:06d}.png").unlink()
    drive = open_drive(folder)
    assert len(drive.frame_stamps_s) == 28
    assert any("only 28 of 30 frames" in note for note in drive.notes)
    (folder / "image_0" / "000011.png").unlink()
    holed = open_drive(folder)
    assert holed.frame_numbers.tolist() == [*range(11), *range(12, 28)]
    assert holed.problems == {"frames_one_side_missing": 3}
    assert any("frames missing in the recording: 11 (1 of 28)" in note for note in holed.notes)
    # the poses of the hole are still there
    assert holed.reference is not None
    assert drive.reference is not None
    np.testing.assert_array_equal(holed.reference.poses, drive.reference.poses)


@pytest.mark.parametrize(
    ("file", "old", "new", "message"),
    [
        ("times.txt", "3.00000000", "x3", "times.txt, line"),
        ("calib.txt", "Tr:", "Tx:", "entry 'Tr:' is missing"),
        ("calib.txt", "P1: 80", "P1: nan", "entry 'P1:' must hold 12 finite numbers"),
        ("calib.txt", "31.5 -24", "31.5 24", "baseline of the two cameras is"),
        ("../../poses/07.txt", " ", " oops ", "07.txt, line 1"),
    ],
)
def test_damaged_sequences(tmp_path: Path, file: str, old: str, new: str, message: str) -> None:
    folder = make_sequence(tmp_path)
    path = folder / file
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(InputError, match=message):
        open_drive(folder)


def test_times_that_run_back_and_poses_that_are_too_few(tmp_path: Path) -> None:
    folder = make_sequence(tmp_path)
    times = np.loadtxt(folder / "times.txt")
    np.savetxt(folder / "times.txt", times[[0, 2, 1, *range(3, 30)]])
    with pytest.raises(InputError, match="of frame 2 does not follow"):
        open_drive(folder)
    np.savetxt(folder / "times.txt", times)
    poses = tmp_path / "poses" / "07.txt"
    poses.write_text("\n".join(poses.read_text().splitlines()[:20]) + "\n")
    drive = open_drive(folder)
    assert drive.reference is not None
    assert len(drive.reference) == 20
    assert any("only 20 of 30 pictures have one" in note for note in drive.notes)


def test_sequence_03(recording: Recording) -> None:
    drive = open_drive(recording("kitti_odometry") / "sequences" / "03")
    assert len(drive.frame_stamps_s) == 99
    assert drive.reference is not None
    poses = drive.reference.poses
    length = np.linalg.norm(np.diff(poses[:, :2], axis=0), axis=1).sum()
    assert length == pytest.approx(57.8, abs=0.6)
    # the rear axle moves along the car: on the straight first part within its jitter
    step = np.diff(poses[:45, :2], axis=0)
    slip = np.arctan2(step[:, 1], step[:, 0]) - poses[1:45, 2]
    assert abs(np.degrees(np.median(slip))) < 0.3
    assert drive.read_frame(98).left.shape == (375, 1242)
