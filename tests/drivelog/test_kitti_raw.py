"""Raw KITTI drives: clocks of their files, damage, and the recorded one."""

from __future__ import annotations

from collections import Counter
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest

from polemap.drivelog.errors import InputError
from polemap.drivelog.frames import EarthFrame, convergence_rad, grid_from_geographic
from polemap.drivelog.readers.kitti_clock import read_timestamps
from polemap.drivelog.readers.registry import open_drive
from tests.drivelog.test_kitti import Recording


def raw_day(recording: Recording) -> Path:
    return recording("kitti_raw") / "2011_09_26" / "2011_09_26_drive_0001_sync"


def test_raw_drive_0001(recording: Recording) -> None:
    drive = open_drive(raw_day(recording))
    assert drive.frame == EarthFrame("utm", 32632)
    assert drive.frame_numbers.tolist() == [0, 1, 2, 3, 4, 5, 25]
    assert drive.frame_stamps_s[-1] - drive.frame_stamps_s[-2] == pytest.approx(2.062, abs=0.01)
    assert sum("missing in the recording" in note for note in drive.notes) == 2
    reference, gnss, odometry = drive.reference, drive.gnss, drive.odometry
    assert reference is not None
    assert gnss is not None
    assert odometry is not None
    # the heading passed through the convergence: OXTS says -2.6133 from geographic east (row 2)
    turn = reference.poses[2, 2] - -2.6133139803847
    expected = convergence_rad(drive.frame, reference.poses[2:3, :2])[0]
    assert turn == pytest.approx(expected, abs=1e-7)
    assert np.degrees(expected) == pytest.approx(-0.4275, abs=0.001)
    third = grid_from_geographic(drive.frame, [49.014991107977], [8.4342648138193])[0]
    np.testing.assert_allclose([gnss.east_m[2], gnss.north_m[2]], third, atol=1e-6)
    # moving by speed along the yaw leads to the next position
    moved = np.linalg.norm(np.diff(reference.poses[:, :2], axis=0), axis=1)
    np.testing.assert_allclose(
        moved, odometry.speed_mps[:-1] * np.diff(reference.stamp_s) * 0.9996, rtol=0.012
    )


def clock(path: Path, lines: list[str]) -> tuple[dict[int, float], Counter[str]]:
    path.write_text("\n".join(lines) + "\n")
    problems: Counter[str] = Counter()
    return read_timestamps(path, problems), problems


def stamp(i: int) -> str:
    return f"2011-09-26 13:02:{25 + i // 10:02d}.{i % 10}00000123"


def test_blank_lines_in_timestamps(tmp_path: Path) -> None:
    """A blank line keeps its number where the clock shows that a file was skipped, else not."""
    path = tmp_path / "timestamps.txt"
    placeholder, problems = clock(path, [stamp(0), stamp(1), "", stamp(3), stamp(4), "", ""])
    assert sorted(placeholder) == [0, 1, 3, 4]
    assert problems["blank_timestamp_lines"] == 1
    dirt, _ = clock(path, [stamp(0), stamp(1), "", stamp(2), " ", stamp(3)])
    assert sorted(dirt) == [0, 1, 2, 3]
    expected = datetime(2011, 9, 26, 13, 2, 25, tzinfo=UTC).timestamp() + 0.3 + 123e-9
    assert dirt[3] == pytest.approx(expected, abs=1e-6)


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        ([""], "holds no times"),
        ([stamp(0), "yesterday"], "line 2: 'yesterday' is no time"),
        ([stamp(1), stamp(0)], "line 2: time does not follow"),
    ],
)
def test_timestamps_that_are_none(tmp_path: Path, lines: list[str], message: str) -> None:
    with pytest.raises(InputError, match=message):
        clock(tmp_path / "timestamps.txt", lines)


def copy_raw(recording: Recording, root: Path) -> Path:
    """A copy of the raw drive whose images are links, to be damaged."""
    source = raw_day(recording)
    for name in ("calib_cam_to_cam.txt", "calib_imu_to_velo.txt", "calib_velo_to_cam.txt"):
        (root / name).write_bytes((source.parent / name).read_bytes())
    target = root / source.name
    for file in source.rglob("*"):
        if file.is_file():
            copy = target / file.relative_to(source)
            copy.parent.mkdir(parents=True, exist_ok=True)
            if file.suffix == ".png":
                copy.symlink_to(file)
            else:
                copy.write_bytes(file.read_bytes())
    return target


def test_a_raw_drive_with_damage_goes_on(recording: Recording, tmp_path: Path) -> None:
    folder = copy_raw(recording, tmp_path)
    (folder / "image_01" / "data" / "0000000003.png").unlink()
    (folder / "oxts" / "data" / "0000000002.txt").write_text("49.0 broken\n")
    stamps = folder / "image_00" / "timestamps.txt"
    lines = stamps.read_text().splitlines()
    lines[4] = ""
    stamps.write_text("\n".join(lines) + "\n")
    drive = open_drive(folder)
    assert drive.frame_numbers.tolist() == [0, 1, 2, 5, 25]
    assert drive.problems == {
        "blank_timestamp_lines": 1,
        "frames_one_side_missing": 1,
        "frames_without_time": 1,
        "oxts_unusable_rows": 1,
    }
    assert drive.odometry is not None
    assert len(drive.odometry) == 4


def test_a_raw_drive_without_oxts_and_one_without_calibration(
    recording: Recording, tmp_path: Path
) -> None:
    folder = copy_raw(recording, tmp_path)
    for file in (folder / "oxts" / "data").iterdir():
        file.unlink()
    drive = open_drive(folder)
    assert drive.reference is None
    assert drive.has_frames
    (tmp_path / "calib_velo_to_cam.txt").unlink()
    with pytest.raises(InputError, match=r"calib_velo_to_cam.txt: cannot be read"):
        open_drive(folder)
