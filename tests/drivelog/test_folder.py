"""Plain drive folders: what is written is read."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from polemap.drivelog.detections import Detections
from polemap.drivelog.errors import InputError
from polemap.drivelog.frames import EarthFrame
from polemap.drivelog.readers.registry import open_drive
from polemap.drivelog.samples import OdometrySample, StereoFrame
from polemap.drivelog.writers.folder import folder_writer, write_drive
from polemap.vehicle.io import dump_car, load_car
from tests.drivelog.drives import RIG, VIEW, edit, picture, streams, write_small


def test_what_is_written_is_read(folder: Path) -> None:
    drive = open_drive(folder)
    odometry, gnss, reference = streams()
    assert drive.frame == EarthFrame("utm", 32632)
    assert drive.rig == RIG
    assert drive.odometry is not None
    assert drive.gnss is not None
    assert drive.reference is not None
    np.testing.assert_allclose(drive.odometry.arrival_s, odometry.arrival_s, atol=1e-6)
    np.testing.assert_allclose(drive.gnss.east_m, gnss.east_m, atol=1e-4)
    np.testing.assert_allclose(drive.gnss.north_m, gnss.north_m, atol=1e-4)
    np.testing.assert_allclose(drive.reference.poses, reference.poses, atol=2e-5)
    np.testing.assert_allclose(drive.gnss_antenna_m, [0.5, -0.2])
    assert [len(scan) for scan in drive.scans] == [2, 0]
    view = drive.scans[0].view
    assert view is not None
    assert view.bearing_max_rad == VIEW.bearing_max_rad
    assert drive.notes == ("made for a test",)
    assert not drive.problems


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_images_of_8_and_16_bit(tmp_path: Path, dtype: type) -> None:
    drive = open_drive(write_small(tmp_path / "drive", dtype=dtype))
    frame = drive.read_frame(2)
    np.testing.assert_array_equal(frame.left, picture(4, dtype))
    np.testing.assert_array_equal(frame.right, picture(5, dtype))
    assert frame.left.dtype == dtype


def test_a_local_frame_keeps_metres(tmp_path: Path) -> None:
    drive = open_drive(write_small(tmp_path / "d", frame=EarthFrame("local", name="yard")))
    assert drive.gnss is not None
    np.testing.assert_allclose(drive.gnss.east_m, streams()[1].east_m, atol=1e-4)


def test_samples_come_in_order_of_arrival(folder: Path) -> None:
    drive = open_drive(folder)
    samples = list(drive.samples())
    arrivals = [getattr(sample, "arrival_s", sample.stamp_s) for sample in samples]
    assert arrivals == sorted(arrivals)
    counts = {
        kind: sum(isinstance(s, kind) for s in samples) for kind in (OdometrySample, Detections)
    }
    assert counts == {OdometrySample: 40, Detections: 2}
    frames = [sample for sample in samples if isinstance(sample, StereoFrame)]
    assert [frame.index for frame in frames] == [0, 1, 2]


def test_laps_cut_every_stream(folder: Path) -> None:
    drive = open_drive(folder)
    one, two = drive.lap("one"), drive.lap("two")
    assert one.odometry is not None
    assert two.odometry is not None
    assert len(one.odometry) + len(two.odometry) == 40
    assert two.odometry.stamp_s.min() == pytest.approx(102.0)
    assert len(one.frame_stamps_s) == 3
    assert not two.has_frames
    assert one.read_frame(1).index == 1
    with pytest.raises(InputError, match="no lap is called 'three'; its laps are: one, two"):
        drive.lap("three")
    both = drive.lap("one:two")
    assert both.odometry is not None
    assert len(both.odometry) == 40
    assert [lap.name for lap in both.laps] == ["one", "two"]
    with pytest.raises(InputError, match="lap 'one' ends before 'two' begins"):
        drive.lap("two:one")
    with pytest.raises(InputError, match="no lap is called 'three'"):
        drive.lap("one:three")


def test_a_copy_is_the_same_drive(folder: Path, tmp_path: Path) -> None:
    drive = open_drive(folder)
    write_drive(drive, tmp_path / "copy")
    copy = open_drive(tmp_path / "copy")
    assert copy.laps == drive.laps
    np.testing.assert_array_equal(copy.read_frame(1).left, drive.read_frame(1).left)
    np.testing.assert_allclose(copy.scans[0].covariance_m2, drive.scans[0].covariance_m2, rtol=1e-8)


def test_files_that_are_missing_are_sensors_that_are_missing(folder: Path) -> None:
    for name in ("frames", "odometry", "gnss", "reference", "poles", "scans", "laps"):
        (folder / f"{name}.csv").unlink()
    drive = open_drive(folder)
    assert drive.odometry is None
    assert drive.gnss is None
    assert drive.reference is None
    assert not drive.scans
    assert list(drive.samples()) == []


def test_frames_must_be_written_in_order(tmp_path: Path) -> None:
    image = picture(0)

    def write_twice() -> None:
        frame = EarthFrame("utm", 32632)
        with folder_writer(tmp_path / "d", name="d", frame=frame, wheelbase_m=2.7) as writer:
            writer.frame(1.0, 1.0, image, image)
            writer.frame(1.0, 1.0, image, image)

    with pytest.raises(InputError, match="does not follow"):
        write_twice()
    assert list(tmp_path.iterdir()) == []


def test_victoria_park(recording: Callable[[str], Path]) -> None:
    drive = open_drive(recording("victoria_park") / "drive")
    assert drive.frame == EarthFrame("local", name="victoria_park")
    assert len(drive.scans) == 7249
    assert sum(len(scan) for scan in drive.scans) == 52974
    assert any(len(scan) == 0 for scan in drive.scans)
    assert {lap.name for lap in drive.laps} == {"map", "test"}
    assert not drive.problems
    assert drive.scans[0].view is not None
    assert any("field of view was estimated" in note for note in drive.notes)


def test_a_drive_may_name_a_car(folder: Path, tmp_path: Path) -> None:
    assert open_drive(folder).car is None
    passat = load_car("passat")
    edit(folder / "drive.yaml", "wheelbase_m: 2.7", "car: passat")
    drive = open_drive(folder)
    assert drive.car == passat
    assert drive.wheelbase_m == passat.wheelbase_m
    assert drive.lap("one").car == passat
    write_drive(drive, tmp_path / "copy")
    assert open_drive(tmp_path / "copy").car == passat


def test_a_car_file_in_the_folder_is_read_from_there(folder: Path) -> None:
    mine = replace(load_car("passat"), name="mine", rear_stiffness_nprad=41_000.0)
    (folder / "mine.yaml").write_text(dump_car(mine), encoding="utf-8")
    typed = f"wheelbase_m: {mine.wheelbase_m:.2f}\n  car: mine.yaml"
    edit(folder / "drive.yaml", "wheelbase_m: 2.7", typed)
    drive = open_drive(folder)
    assert drive.car == mine
    assert drive.wheelbase_m == mine.wheelbase_m


@pytest.mark.parametrize(
    ("vehicle", "message"),
    [
        ("car: batmobile", r"drive.yaml: vehicle.car: no car .*batmobile; known are .*passat"),
        ("car: gone.yaml", r"vehicle.car: .*gone.yaml: cannot be read"),
        ("wheelbase_m: 3.4\n  car: passat", r"wheelbase_m is 3.4 m, car passat has 2.\d+ m; leave"),
        ("length_m: 4.0", r"drive.yaml: vehicle: .*needs wheelbase_m or car"),
    ],
)
def test_a_car_that_cannot_be_is_named(folder: Path, vehicle: str, message: str) -> None:
    edit(folder / "drive.yaml", "wheelbase_m: 2.7", vehicle)
    with pytest.raises(InputError, match=message):
        open_drive(folder)
