"""Logs of a whole drive: files, clocks, signals, pictures, what is left out or refused."""

from __future__ import annotations

from datetime import datetime
from pathlib import Path

import numpy as np
import pytest

from polemap.drivelog.readers.registry import open_drive
from polemap.tools import cli
from tests.drivelog.logs.recorded import (
    START_S,
    ZONE,
    cells,
    clock,
    columns,
    convert,
    journey,
    table,
    write_mapping,
)
from tests.drivelog.logs.test_convert_shapes import _plain


def test_a_whole_drive_is_plausible(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Odometry, fixes in ten-millionths of a degree, a compass reference at a lever arm."""
    road = journey()
    lever = np.array([0.4, -0.3])
    ahead = np.stack([np.cos(road.yaw_rad), np.sin(road.yaw_rad)])
    left = np.stack([-np.sin(road.yaw_rad), np.cos(road.yaw_rad)])
    antenna = np.stack([road.east_m, road.north_m]) + lever[0] * ahead + lever[1] * left
    rows = {
        "t_s": cells(road.stamp_s),
        **_plain(road),
        "lat": cells(road.latitude_deg * 1e7, "%.0f"),
        "lon": cells(road.longitude_deg * 1e7, "%.0f"),
        "fix": ["4"] * 590 + ["0"] * 10,
        "e": cells(antenna[0], "%.4f"),
        "n": cells(antenna[1], "%.4f"),
        "compass": cells(road.compass_deg, "%.8f"),
    }
    degrees = {"unit": "1e-7 deg"}
    sections = {
        "odometry": {"stamp_s": "t_s", **columns()},
        "gnss": {
            "stamp_s": "t_s",
            "where": {"column": "fix", "in": [1, 2, 4]},
            "latitude_deg": {"column": "lat", **degrees},
            "longitude_deg": {"column": "lon", **degrees},
            "hdop": {"value": 0.9},
        },
        "reference": {
            "stamp_s": "t_s",
            "east_m": {"column": "e", "unit": "m"},
            "north_m": {"column": "n", "unit": "m"},
            "yaw_rad": {
                "column": "compass",
                "unit": "deg",
                "turn": "clockwise",
                "from": "true_north",
            },
            "measured_at": {"x_m": 0.4, "y_m": -0.3},
        },
    }
    drive = convert(tmp_path, table(rows), sections)
    said = capsys.readouterr().out
    assert "gnss: 590 rows of 600 read; left out: 10 not meant by `where`" in said
    assert drive.frame == ZONE
    assert drive.reference is not None
    np.testing.assert_allclose(drive.reference.poses[:, 0], road.east_m, atol=1e-3)
    np.testing.assert_allclose(drive.reference.poses[:, 1], road.north_m, atol=1e-3)
    np.testing.assert_allclose(drive.reference.poses[:, 2], road.yaw_rad, atol=1e-7)
    assert cli.run(["info", str(tmp_path / "drive")]) == cli.GOOD
    assert "nothing speaks against it" in capsys.readouterr().out


def test_a_wrong_unit_is_refused_and_forced(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    road = journey()
    rows = {"t_s": cells(road.stamp_s), **_plain(road), "lat_deg": cells(road.latitude_deg),
            "lon_deg": cells(road.longitude_deg)}  # fmt: skip
    path = tmp_path / "log.csv"
    path.write_text(table(rows))
    sections = {
        "odometry": {"stamp_s": "t_s", **columns(), "speed_mps": {"column": "v", "unit": "m/s"}},
        "gnss": {"stamp_s": "t_s", "latitude_deg": "lat_deg", "longitude_deg": "lon_deg"},
    }
    words = ["convert", str(path), "--mapping", str(write_mapping(tmp_path / "m.yaml", **sections)),
             "--out", str(tmp_path / "drive")]  # fmt: skip
    assert cli.run(words) == cli.USER_ERROR
    error = capsys.readouterr().err
    assert "speed" in error
    assert "km/h" in error
    assert not (tmp_path / "drive").exists()
    assert cli.run([*words, "--force"]) == cli.GOOD


def test_several_files_parts_and_clocks(tmp_path: Path) -> None:
    """Wheels in two parts, the gyro at other stamps in a file of its own, fixes in NMEA order."""
    road = journey(200)
    for name, rows in (("can_1.csv", slice(0, 100)), ("can_2.csv", slice(100, 200))):
        part = {"t_s": cells(road.stamp_s[rows]), "v_mps": cells(road.speed_mps[rows])}
        (tmp_path / name).write_text(table(part))
    between = road.stamp_s[:-1] + 0.05
    rate = np.interp(between, road.stamp_s, road.yaw_rate_radps)
    (tmp_path / "imu.csv").write_text(
        table({"ns": cells((between + 3.0) * 1e9, "%.0f"), "wz": cells(rate)})
    )
    gyro = {
        "file": "imu.csv", "column": "wz", "unit": "rad/s",
        "stamp_s": {"column": "ns", "unit": "ns", "offset": -3.0},
    }  # fmt: skip
    mapping = write_mapping(
        tmp_path / "m.yaml",
        drive={"vehicle": {"wheelbase_m": 2.7}, "frame": {"kind": "local", "name": "x"}},
        odometry={"file": "can_*.csv", "stamp_s": "t_s", "speed_mps": "v_mps",
                  "yaw_rate_radps": gyro},
    )  # fmt: skip
    files = [str(tmp_path / name) for name in ("can_1.csv", "can_2.csv", "imu.csv")]
    words = ["convert", *files, "--mapping", str(mapping), "--out", str(tmp_path / "d")]
    assert cli.run(words) == cli.GOOD
    odometry = open_drive(tmp_path / "d").odometry
    assert odometry is not None
    assert len(odometry) == 198  # the first and the last have no gyro on both sides
    np.testing.assert_allclose(odometry.yaw_rate_radps, road.yaw_rate_radps[1:-1], atol=1e-4)


def test_what_is_left_out_is_counted(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    road = journey(100)
    lines = table({"t_s": cells(road.stamp_s), "v_mps": cells(road.speed_mps),
                   "gz_radps": cells(road.yaw_rate_radps)}).splitlines()  # fmt: skip
    lines[10] = lines[10].replace(lines[10].split(",")[1], "nan")
    lines[20] = lines[20].replace(lines[20].split(",")[1], "OFF")
    lines.insert(30, lines[0])
    lines[40], lines[41] = lines[41], lines[40]
    lines.insert(50, lines[50])
    lines[-1] = lines[-1].split(",")[0]
    sections = {
        "drive": {"vehicle": {"wheelbase_m": 2.7}, "frame": {"kind": "local", "name": "x"}},
        "format": {"missing": ["OFF"]},
        "odometry": {"stamp_s": "t_s", "speed_mps": "v_mps", "yaw_rate_radps": "gz_radps"},
    }
    drive = convert(tmp_path, "\n".join(lines), sections)
    said = capsys.readouterr().out
    assert drive.odometry is not None
    assert len(drive.odometry) == 97
    assert (
        "odometry: 97 rows of 102 read; left out: 1 last line cut off, 1 repeated headers, "
        "1 repeated stamps, 2 speed_mps not given" in said
    )
    assert "1 rows came out of order and were sorted" in said


def test_signals_for_polemap_estimate(tmp_path: Path) -> None:
    road = journey(50)
    rows = {
        "t_s": cells(road.stamp_s),
        "steer [deg]": cells(np.degrees(road.yaw_rate_radps)),
        "a [g]": cells(road.speed_mps / 9.80665),
        "course": cells(road.compass_deg),
    }
    rows["course"][1::2] = [""] * 25
    (tmp_path / "log.csv").write_text(table(rows))
    signals = {
        "stamp_s": "t_s",
        "road_wheel_angle_rad": {"column": "steer [deg]", "turn": "clockwise", "scale": 0.1,
                                 "unit": "deg"},
        "ay_mps2": "a [g]",
        "course_rad": {"column": "course", "unit": "deg", "turn": "clockwise",
                       "from": "grid_north"},
    }  # fmt: skip
    mapping = write_mapping(tmp_path / "m.yaml", signals=signals)
    words = ["convert", str(tmp_path / "log.csv"), "--mapping", str(mapping)]
    assert cli.run([*words, "--out", str(tmp_path / "s.csv")]) == cli.GOOD
    from polemap.electric.io import read_signal_log

    log, ignored = read_signal_log(tmp_path / "s.csv")
    assert ignored == []
    np.testing.assert_allclose(log.columns["road_wheel_angle_rad"], -0.1 * road.yaw_rate_radps,
                               atol=1e-9)  # fmt: skip
    np.testing.assert_allclose(log.columns["ay_mps2"], road.speed_mps, atol=1e-7)
    assert np.isnan(log.columns["course_rad"][1::2]).all()
    assert cli.run([*words, "--out", str(tmp_path / "folder")]) == cli.USER_ERROR


def test_pictures_are_copied(tmp_path: Path) -> None:
    import cv2

    from tests.drivelog.drives import picture

    lines = ["time,left,right"]
    for row in range(3):
        for side in ("l", "r"):
            cv2.imwrite(str(tmp_path / f"{side}{row}.png"), picture(row))
        lines.append(f"{START_S + row},l{row}.png,r{row}.png")
    camera = {
        "width_px": 64, "height_px": 48, "focal_px": 80.0, "cx_px": 31.5, "cy_px": 23.5,
        "baseline_m": 0.3, "vehicle_from_camera": {"x_m": 1.9, "y_m": 0.1, "z_m": 1.3},
    }  # fmt: skip
    sections = {
        "drive": {"vehicle": {"wheelbase_m": 2.7}, "frame": {"kind": "local", "name": "x"},
                  "camera": camera},
        "frames": {"stamp_s": {"column": "time", "unit": "s"}, "left": "left", "right": "right"},
    }  # fmt: skip
    drive = convert(tmp_path, "\n".join(lines), sections, "--force")
    np.testing.assert_array_equal(drive.read_frame(2).left, picture(2))
    (tmp_path / "r1.png").unlink()
    words = ["convert", str(tmp_path / "log.csv"), "--mapping", str(tmp_path / "map.yaml")]
    assert cli.run([*words, "--out", str(tmp_path / "other")]) == cli.USER_ERROR


def test_midnight_of_times_without_a_day(tmp_path: Path) -> None:
    road = journey(100)
    stamps = road.stamp_s + 43_195.0  # five seconds to midnight
    times = clock(stamps, lambda t: t.strftime("%H:%M:%S.%f"))
    sections = {
        "drive": {"vehicle": {"wheelbase_m": 2.7}, "frame": {"kind": "local", "name": "x"}},
        "odometry": {"stamp_s": {"column": "time", "date": "2024-05-01", "zone": "UTC"},
                     **columns()},
    }  # fmt: skip
    drive = convert(tmp_path, table({"time": times, **_plain(road)}), sections)
    assert drive.odometry is not None
    np.testing.assert_allclose(drive.odometry.stamp_s, stamps, atol=2e-6)


def test_fractions_that_are_left_out(tmp_path: Path) -> None:
    """12:00:01 between 12:00:00.900000 and 12:00:01.100000."""
    road = journey(30)

    def american(t: datetime) -> str:
        return t.strftime("%m/%d/%Y %H:%M:%S") + (t.strftime(".%f") if t.microsecond else "")

    sections = {
        "drive": {"vehicle": {"wheelbase_m": 2.7}, "frame": {"kind": "local", "name": "x"}},
        "odometry": {"stamp_s": {"column": "time", "format": "%m/%d/%Y %H:%M:%S.%f",
                                 "zone": "-05:00"}, **columns()},
    }  # fmt: skip
    times = clock(road.stamp_s - 5 * 3600.0, american)
    drive = convert(tmp_path, table({"time": times, **_plain(road)}), sections)
    assert drive.odometry is not None
    np.testing.assert_allclose(drive.odometry.stamp_s, road.stamp_s, atol=2e-6)
