"""Plain drive folders: round trips, and every way in which one can be wrong."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from drivelog.drive import open_drive
from drivelog.errors import InputError, PolemapError
from drivelog.frames import EarthFrame
from drivelog.samples import OdometrySample, PoleScan, StereoFrame
from drivelog.writers.folder import folder_writer, write_drive
from tests.drivelog.drives import RIG, VIEW, edit, picture, streams, write_small


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return write_small(tmp_path / "drive")


def one_line(error: pytest.ExceptionInfo[PolemapError], *parts: str) -> None:
    text = str(error.value)
    assert "\n" not in text
    for part in parts:
        assert part in text


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
        kind: sum(isinstance(s, kind) for s in samples) for kind in (OdometrySample, PoleScan)
    }
    assert counts == {OdometrySample: 40, PoleScan: 2}
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


def test_a_missing_image_is_named_when_the_drive_is_opened(folder: Path) -> None:
    (folder / "right" / "000001.png").unlink()
    with pytest.raises(InputError) as error:
        open_drive(folder)
    one_line(error, "000001.png", "missing")


@pytest.mark.parametrize("share", [0.1, 0.5, 0.99])
def test_a_truncated_png_is_named_and_never_decoded(folder: Path, share: float) -> None:
    path = folder / "left" / "000001.png"
    data = path.read_bytes()
    path.write_bytes(data[: int(len(data) * share)])
    drive = open_drive(folder)
    drive.read_frame(0)
    with pytest.raises(InputError) as error:
        drive.read_frame(1)
    one_line(error, "000001.png", "truncated PNG")


def test_a_flipped_byte_in_a_png_is_noticed(folder: Path) -> None:
    path = folder / "left" / "000000.png"
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 0xFF
    path.write_bytes(bytes(data))
    with pytest.raises(InputError, match="damaged PNG"):
        open_drive(folder).read_frame(0)


def test_an_image_that_is_none(folder: Path) -> None:
    (folder / "left" / "000000.png").write_bytes(b"")
    with pytest.raises(InputError, match="not an image"):
        open_drive(folder).read_frame(0)


def test_an_image_of_another_size(folder: Path) -> None:
    edit(folder / "drive.yaml", "width_px: 64", "width_px: 65")
    with pytest.raises(InputError, match=r"64x48 pixels, but the camera of the drive has 65x48"):
        open_drive(folder).read_frame(0)


def test_rows_with_nan_are_left_out_and_counted(folder: Path) -> None:
    lines = (folder / "odometry.csv").read_text().splitlines()
    lines[5] = lines[5].replace("10.000000", "nan")
    lines[9] = lines[9].replace("10.000000", "")
    lines[12] = lines[12].replace("10.000000", "inf")
    lines.insert(20, "")
    (folder / "odometry.csv").write_text("\n".join(lines) + "\n\n")
    drive = open_drive(folder)
    assert drive.odometry is not None
    assert len(drive.odometry) == 37
    assert drive.problems == {"odometry_not_finite": 3}


def test_a_second_row_of_a_stamp_is_left_out_and_counted(folder: Path) -> None:
    lines = (folder / "gnss.csv").read_text().splitlines()
    lines.insert(3, lines[2])
    (folder / "gnss.csv").write_text("\n".join(lines) + "\n")
    drive = open_drive(folder)
    assert drive.gnss is not None
    assert len(drive.gnss) == 8
    assert drive.problems == {"gnss_duplicate_stamps": 1}


@pytest.mark.parametrize("name", ["odometry", "gnss", "reference", "frames", "scans"])
def test_stamps_that_run_back_are_an_error(folder: Path, name: str) -> None:
    path = folder / f"{name}.csv"
    lines = path.read_text().splitlines()
    lines[1], lines[2] = lines[2], lines[1]
    path.write_text("\n".join(lines) + "\n")
    with pytest.raises(InputError) as error:
        open_drive(folder)
    one_line(error, f"{name}.csv, line 3", "sort the rows by stamp_s")


def test_a_frame_that_stands_twice_is_an_error(folder: Path) -> None:
    lines = (folder / "frames.csv").read_text().splitlines()
    (folder / "frames.csv").write_text("\n".join([*lines, lines[-1]]) + "\n")
    with pytest.raises(InputError, match=r"frames.csv, line 5: .* stands twice"):
        open_drive(folder)


def test_a_frame_without_a_stamp_is_an_error(folder: Path) -> None:
    edit(folder / "frames.csv", "100.300000,", "nan,")
    with pytest.raises(InputError, match=r"frames.csv, line 3: stamp_s is nan"):
        open_drive(folder)


@pytest.mark.parametrize(
    ("file", "old", "new", "message"),
    [
        ("odometry.csv", "speed_mps", "speed", r"column 'speed_mps' is missing \(found: stamp_s"),
        ("odometry.csv", "10.000000", "ten", r"odometry.csv, line 2: speed_mps is 'ten'"),
        ("gnss.csv", "latitude_deg", "lat", "column 'latitude_deg' is missing"),
        ("frames.csv", "left/000000.png", "../x.png", "leads out of the drive"),
        ("laps.csv", "two,102", "two,105", "lap 'two' ends before it starts"),
        ("laps.csv", "two,", "one,", "two laps have the same name"),
        ("drive.yaml", "format_version: 1", "format_version: 2", "format_version"),
        ("drive.yaml", "wheelbase_m: 2.7", "wheelbase_m: -1", "vehicle.wheelbase_m"),
        ("drive.yaml", "wheelbase_m: 2.7", "wheelbase_m: .nan", "vehicle.wheelbase_m"),
        ("drive.yaml", "epsg: 32632", "epsg: 4326", "no UTM zone"),
        ("drive.yaml", "kind: utm", "kind: [utm", "not YAML"),
        ("drive.yaml", "camera:", "kamera:", "describes no camera"),
    ],
)
def test_what_is_wrong_is_named(folder: Path, file: str, old: str, new: str, message: str) -> None:
    edit(folder / file, old, new)
    with pytest.raises(InputError, match=message) as error:
        open_drive(folder)
    one_line(error, str(folder))


def test_a_latitude_in_metres_is_refused(folder: Path) -> None:
    path = folder / "gnss.csv"
    lines = path.read_text().splitlines()
    lines[2] = "100.6,5430000.0,458000.0,1.0,100.7"
    path.write_text("\n".join(lines) + "\n")
    with pytest.raises(InputError, match=r"gnss.csv, line 3: .* is no latitude and longitude"):
        open_drive(folder)


def test_an_empty_file_and_a_binary_one(folder: Path) -> None:
    (folder / "odometry.csv").write_text("")
    with pytest.raises(InputError, match="a header line is needed"):
        open_drive(folder)
    (folder / "odometry.csv").write_bytes(b"\xff\xfe\x00\x01,\n\x80,1\n")
    with pytest.raises(InputError, match="not a UTF-8 CSV file"):
        open_drive(folder)


def test_a_key_that_nothing_reads_is_noted(folder: Path) -> None:
    with (folder / "drive.yaml").open("a") as file:
        file.write("weather: rain\n")
    assert any("unknown key 'weather'" in note for note in open_drive(folder).notes)


def test_an_arrival_before_its_stamp_is_the_stamp(folder: Path) -> None:
    lines = (folder / "odometry.csv").read_text().splitlines()
    lines[1] = lines[1].rsplit(",", 1)[0] + ",99.0"
    (folder / "odometry.csv").write_text("\n".join(lines) + "\n")
    drive = open_drive(folder)
    assert drive.odometry is not None
    assert drive.odometry.arrival_s[0] == drive.odometry.stamp_s[0]
    assert drive.problems == {"odometry_arrival_before_stamp": 1}


def test_a_covariance_that_is_none_is_left_out(folder: Path) -> None:
    edit(folder / "poles.csv", "0.04,0.02,0.01", "0.04,0.02,0.9")
    drive = open_drive(folder)
    assert [len(scan) for scan in drive.scans] == [1, 0]
    assert drive.problems == {"poles_covariance_not_positive": 1}


def test_what_is_no_drive(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such drive"):
        open_drive(tmp_path / "nowhere")
    with pytest.raises(InputError, match="not a drive that can be read"):
        open_drive(tmp_path)


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
