"""Every way in which a plain drive folder can be wrong."""

from __future__ import annotations

from pathlib import Path

import pytest

from polemap.drivelog.errors import InputError, PolemapError
from polemap.drivelog.readers.registry import open_drive
from tests.drivelog.drives import edit


def one_line(error: pytest.ExceptionInfo[PolemapError], *parts: str) -> None:
    text = str(error.value)
    assert "\n" not in text
    for part in parts:
        assert part in text


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
