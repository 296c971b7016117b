"""KITTI folders of all shapes: cut out, in colour, not rectified, with less than everything."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from polemap.drivelog.errors import InputError
from polemap.drivelog.readers.registry import open_drive
from polemap.stereo.rectify import Rectifier
from tests.drivelog.drives import picture, png
from tests.drivelog.test_kitti import make_sequence
from tests.drivelog.test_kitti_raw import stamp
from tests.stereo.calibrations import make_calibration, write_kitti


def renumber(folder: Path, first: int) -> None:
    for file in sorted(folder.glob("image_*/*.png"), reverse=True):
        file.rename(file.with_name(f"{int(file.stem) + first:06d}.png"))


def cut(path: Path, lines: slice) -> None:
    path.write_text("\n".join(path.read_text().splitlines()[lines]) + "\n")


def keep(folder: Path, numbers: range) -> None:
    for file in folder.glob("image_*/*.png"):
        if int(file.stem) not in numbers:
            file.unlink()


def test_pictures_from_any_number_on_keep_their_line(tmp_path: Path) -> None:
    folder = make_sequence(tmp_path)
    whole = open_drive(folder)
    keep(folder, range(10, 25))
    drive = open_drive(folder)
    np.testing.assert_array_equal(drive.frame_stamps_s, whole.frame_stamps_s[10:25])
    assert drive.reference is not None
    assert whole.reference is not None
    np.testing.assert_allclose(drive.reference.poses, whole.reference.poses[10:25], atol=1e-3)
    assert any("the pictures begin with number 10" in note for note in drive.notes)
    assert any("only 25 of 30 frames have images" in note for note in drive.notes)


def test_times_and_poses_that_were_cut_out_with_the_pictures(tmp_path: Path) -> None:
    folder = make_sequence(tmp_path)
    whole = open_drive(folder)
    keep(folder, range(10, 25))
    for path in (folder / "times.txt", tmp_path / "poses" / "07.txt"):
        cut(path, slice(10, 25))
    drive = open_drive(folder)
    assert drive.frame_numbers.tolist() == list(range(10, 25))
    np.testing.assert_allclose(drive.frame_stamps_s, whole.frame_stamps_s[10:25])
    assert drive.reference is not None
    assert len(drive.reference) == 15
    notes = " ".join(drive.notes)
    assert "have the 15 times of times.txt in their order" in notes
    assert "15 poses for as many pictures, taken in their order" in notes


def test_pictures_beyond_the_times_are_counted_or_refused(tmp_path: Path) -> None:
    folder = make_sequence(tmp_path)
    cut(folder / "times.txt", slice(0, 12))
    drive = open_drive(folder)
    assert len(drive.frame_stamps_s) == 12
    assert drive.problems["frames_without_time"] == 18
    renumber(folder, 100)
    with pytest.raises(InputError, match="12 times, but the pictures are numbered 100 to 129"):
        open_drive(folder)


def test_a_sequence_in_colour_alone(tmp_path: Path) -> None:
    folder = make_sequence(tmp_path)
    grey = open_drive(folder)
    for number in (0, 1):
        (folder / f"image_{number}").rename(folder / f"image_{number + 2}")
        for file in (folder / f"image_{number + 2}").iterdir():
            image = cv2.imread(str(file), cv2.IMREAD_GRAYSCALE)
            assert cv2.imwrite(str(file), np.dstack([image, image, image]))
    with pytest.raises(InputError, match="entry 'P2:' is missing"):
        open_drive(folder)
    with (folder / "calib.txt").open("a") as calibration:
        calibration.write("P2: 80 0 31.5 4.8  0 80 23.5 0  0 0 1 0\n")
        calibration.write("P3: 80 0 31.5 -20  0 80 23.5 0  0 0 1 0\n")
    drive = open_drive(folder)
    assert drive.rig is not None
    assert grey.rig is not None
    assert drive.rig.baseline_m == pytest.approx(24.8 / 80)
    # 0.06 m to the left of the grey camera, whose poses are known
    assert drive.rig.vehicle_from_camera.y_m == pytest.approx(0.06, abs=1e-4)
    assert drive.read_frame(3).left.ndim == 2
    assert any("the colour pair image_2, image_3 is taken" in note for note in drive.notes)
    assert drive.reference is not None
    assert grey.reference is not None
    np.testing.assert_array_equal(drive.reference.poses, grey.reference.poses)


@pytest.mark.parametrize(
    ("remove", "message"),
    [
        ("times.txt", "times.txt: cannot be read"),
        ("image_1", "30 pictures in image_0 and 0 in image_1, none with the same number"),
    ],
)
def test_what_a_sequence_cannot_do_without(tmp_path: Path, remove: str, message: str) -> None:
    folder = make_sequence(tmp_path)
    (folder / remove).rename(tmp_path / "elsewhere")
    with pytest.raises(InputError, match=message):
        open_drive(folder)


Extract = Callable[[], Path]


def make_extract(root: Path, n: int = 6) -> Path:
    """A raw drive of unrectified pictures, without OXTS."""
    calibration = make_calibration()
    write_kitti(root / "calib_cam_to_cam.txt", calibration)
    forward = "R: 0 -1 0 0 0 -1 1 0 0\nT: 0 -0.08 -0.27\n"
    (root / "calib_velo_to_cam.txt").write_text(forward)
    (root / "calib_imu_to_velo.txt").write_text("R: 1 0 0 0 1 0 0 0 1\nT: -0.81 0.32 -0.8\n")
    folder = root / "2011_09_26_drive_0009_extract"
    for side in (0, 1):
        for i in range(n):
            image = cv2.resize(picture(i + side), (320, 240))
            png(folder / f"image_0{side}" / "data" / f"{i:010d}.png", image)
        lines = "\n".join(stamp(i) for i in range(n)) + "\n"
        (folder / f"image_0{side}" / "timestamps.txt").write_text(lines)
    return folder


def test_the_pictures_of_an_extract_are_rectified_as_they_are_read(tmp_path: Path) -> None:
    folder = make_extract(tmp_path)
    drive = open_drive(folder)
    rectifier = Rectifier(make_calibration())
    assert drive.rig is not None
    assert drive.rig.focal_px == pytest.approx(rectifier.rig.focal_px)
    raw = [cv2.imread(str(folder / f"image_0{s}/data/0000000002.png"), 0) for s in (0, 1)]
    expected = rectifier.rectify(raw[0], raw[1])
    frame = drive.read_frame(2)
    np.testing.assert_array_equal(frame.left, expected[0])
    np.testing.assert_array_equal(frame.right, expected[1])
    assert any("the pictures are not rectified" in note for note in drive.notes)
    assert any("no OXTS data" in note for note in drive.notes)


def test_pictures_of_neither_size_are_refused(tmp_path: Path) -> None:
    folder = make_extract(tmp_path)
    for file in folder.glob("image_0*/data/*.png"):
        png(file, picture(1))
    with pytest.raises(InputError, match=r"64x48 pixels, but .* 320x240"):
        open_drive(folder)


def oxts(folder: Path, stamps: list[str], latitudes: list[float]) -> None:
    (folder / "oxts" / "data").mkdir(parents=True)
    (folder / "oxts" / "timestamps.txt").write_text("\n".join(stamps) + "\n")
    for i, latitude in enumerate(latitudes):
        row = [latitude, 8.4, 110.0, *np.zeros(20), 0.05, 0.0, 4, 10, 6, 6, 6]
        text = " ".join(str(value) for value in row)
        (folder / "oxts" / "data" / f"{i:010d}.txt").write_text(text + "\n")


def test_oxts_in_part_without_times_and_with_a_clock_that_steps_back(tmp_path: Path) -> None:
    folder = make_extract(tmp_path)
    places = [49.0 + 1e-5 * i for i in range(5)]
    oxts(folder, [stamp(0), stamp(1), stamp(3), stamp(2), stamp(4)], places)
    drive = open_drive(folder)
    assert drive.odometry is not None
    assert len(drive.odometry) == 4
    assert drive.problems["oxts_time_runs_back"] == 1
    assert any("OXTS rows missing" in note for note in drive.notes)
    (folder / "oxts" / "timestamps.txt").unlink()
    drive = open_drive(folder)
    assert drive.reference is None
    assert any("5 OXTS rows have no times" in note for note in drive.notes)


def test_raw_pictures_without_a_time_at_all(tmp_path: Path) -> None:
    folder = make_extract(tmp_path)
    for side in (0, 1):
        for file in sorted((folder / f"image_0{side}" / "data").iterdir(), reverse=True):
            file.rename(file.with_name(f"{int(file.stem) + 50:010d}.png"))
    with pytest.raises(InputError, match="none of the pictures 50 to 55 has a time"):
        open_drive(folder)
    (folder / "image_00" / "timestamps.txt").unlink()
    with pytest.raises(InputError, match=r"timestamps\.txt: cannot be read"):
        open_drive(folder)
