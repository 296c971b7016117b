"""The same journey in the dialects of many loggers becomes the same drive."""

from __future__ import annotations

from collections.abc import Callable
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from polemap.drivelog.drive import Drive
from polemap.drivelog.readers.registry import open_drive
from polemap.tools import cli
from tests.drivelog.logs.recorded import (
    START_S,
    ZONE,
    Journey,
    cells,
    clock,
    journey,
    table,
    write_mapping,
)

KMH = 3.6
Dialect = Callable[[Journey], tuple[str | bytes, dict[str, Any]]]


def convert(tmp_path: Path, log: str | bytes, sections: dict[str, Any], *words: str) -> Drive:
    """The drive that a log becomes by the command."""
    path = tmp_path / "log.csv"
    path.write_bytes(log.encode() if isinstance(log, str) else log)
    mapping = write_mapping(tmp_path / "map.yaml", **sections)
    arguments = ["convert", str(path), "--mapping", str(mapping), "--out", str(tmp_path / "drive")]
    assert cli.run([*arguments, *words]) == cli.GOOD
    return open_drive(tmp_path / "drive")


def _columns(speed: str = "v", rate: str = "gz") -> dict[str, Any]:
    return {
        "speed_mps": {"column": speed, "unit": "km/h"},
        "yaw_rate_radps": {"column": rate, "unit": "deg/s"},
    }


def _plain(road: Journey, decimal: str = ".") -> dict[str, list[str]]:
    return {
        "v": cells(road.speed_mps * KMH, decimal=decimal),
        "gz": cells(np.degrees(road.yaw_rate_radps), decimal=decimal),
    }


def iso_zulu(road: Journey) -> tuple[str, dict[str, Any]]:
    times = clock(road.stamp_s, lambda t: t.isoformat().replace("+00:00", "Z"))
    return table({"time": times, **_plain(road)}), {
        "odometry": {"stamp_s": {"column": "time"}, **_columns()}
    }


def iso_in_berlin(road: Journey) -> tuple[str, dict[str, Any]]:
    times = clock(road.stamp_s + 7200.0, lambda t: t.replace(tzinfo=None).isoformat(" "))
    return table({"time": times, **_plain(road)}), {
        "odometry": {"stamp_s": {"column": "time", "zone": "Europe/Berlin"}, **_columns()}
    }


def german_excel(road: Journey) -> tuple[str, dict[str, Any]]:
    """Semicolons, decimal commas, a preamble, units below the names, an empty cell at the end."""
    times = clock(road.stamp_s, lambda t: t.strftime("%d.%m.%Y"))
    of_day = clock(road.stamp_s, lambda t: t.strftime("%H:%M:%S.%f"))
    body = table({"Datum": times, "Zeit": of_day, **_plain(road, ",")}, ";", header=False)
    head = "Messung 7;;;;\nFahrer;A. B.;;;\nDatum;Zeit;v;gz;\n;;[km/h];[°/s];\n"
    text = head + "".join(f"{line};\n" for line in body.splitlines())
    stamps = {"columns": ["Datum", "Zeit"], "format": "%d.%m.%Y %H:%M:%S.%f", "zone": "UTC"}
    return text, {"odometry": {"stamp_s": stamps, "speed_mps": "v", "yaw_rate_radps": "gz"}}


def utf16_tabs(road: Journey) -> tuple[bytes, dict[str, Any]]:
    text = table({"t [ms]": cells(road.stamp_s * 1e3, "%.0f"), **_plain(road)}, "\t")
    return text.encode("utf-16"), {"odometry": {"stamp_s": {"column": "t [ms]"}, **_columns()}}


def byte_order_mark_and_comments(road: Journey) -> tuple[bytes, dict[str, Any]]:
    lines = table({"t_us": cells(road.stamp_s * 1e6, "%.0f"), **_plain(road)}).splitlines()
    lines.insert(5, "# the driver sneezed, twice")
    text = "\n".join(["# logger 4", *lines]) + "\n"
    return text.encode("utf-8-sig"), {"odometry": {"stamp_s": {"column": "t_us"}, **_columns()}}


def no_header(road: Journey) -> tuple[str, dict[str, Any]]:
    text = table({"t": cells(road.stamp_s * 1e9, "%.0f"), **_plain(road)}, header=False)
    return text, {
        "odometry": {"stamp_s": {"column": 1, "unit": "ns"}, **_columns(2, 3)}  # type: ignore[arg-type]
    }


def savetxt(road: Journey) -> tuple[str, dict[str, Any]]:
    """Blanks between the columns, names in a comment."""
    text = table({"t": cells(road.stamp_s), **_plain(road)}, "   ", header=False)
    return "# t v gz\n" + text, {
        "odometry": {"stamp_s": {"column": "t", "unit": "s"}, **_columns()}
    }


def quoted(road: Journey) -> tuple[str, dict[str, Any]]:
    """Every cell in quotes, decimal commas inside, an unused text column with commas."""
    rows = {"t_s": cells(road.stamp_s, decimal=","), **_plain(road, ",")}
    rows["remark"] = ["dry, warm"] * len(road.stamp_s)
    rows = {f'"{name}"': [f'"{cell}"' for cell in column] for name, column in rows.items()}
    return table(rows), {"odometry": {"stamp_s": "t_s", **_columns()}}


def gps_time(road: Journey) -> tuple[str, dict[str, Any]]:
    gps = road.stamp_s - 315_964_800.0 + 18.0
    week = np.floor(gps / 604_800.0)
    rows = {"week": cells(week, "%.0f"), "tow": cells(gps - 604_800.0 * week), **_plain(road)}
    stamps = {"column": "tow", "week": "week", "unit": "s", "leap_seconds": 18}
    return table(rows), {"odometry": {"stamp_s": stamps, **_columns()}}


def clockwise_and_wheels(road: Journey) -> tuple[str, dict[str, Any]]:
    """Two rear wheels in mph, clockwise yaw rate, an unsigned speed with a gear."""
    half = 0.8 * road.yaw_rate_radps
    mph = 1.0 / 0.44704
    rows = {
        "t_s": cells(road.stamp_s),
        "rl": cells((road.speed_mps - half) * mph),
        "rr": cells((road.speed_mps + half) * mph),
        "gear": ["D"] * len(road.stamp_s),
        "gz": cells(-road.yaw_rate_radps * 1e3),
    }
    odometry = {
        "stamp_s": "t_s",
        "speed_mps": {
            "columns": ["rl", "rr"], "unit": "mph",
            "negative_where": {"column": "gear", "in": ["R"]},
        },
        "yaw_rate_radps": {"column": "gz", "unit": "mrad/s", "turn": "clockwise"},
    }  # fmt: skip
    return table(rows), {"odometry": odometry}


def long_form(road: Journey) -> tuple[str, dict[str, Any]]:
    """A row a signal, as CAN loggers write them; the gyro is half a sample off."""
    lines = ["t_s,name,value"]
    for t, v, r in zip(road.stamp_s, road.speed_mps, road.yaw_rate_radps, strict=True):
        lines += [f"{t:.4f},speed,{v:.9f}", f"{t:.4f},gyro,{r:.9f}", f"{t:.4f},other,{r:.3f}"]
    odometry = {
        "stamp_s": "t_s",
        "where": {"column": "name", "in": ["speed"]},
        "speed_mps": {"column": "value", "unit": "m/s"},
        "yaw_rate_radps": {
            "column": "value", "unit": "rad/s", "where": {"column": "name", "in": ["gyro"]},
        },
    }  # fmt: skip
    return "\n".join(lines) + "\n", {"odometry": odometry}


DIALECTS = (
    iso_zulu, iso_in_berlin, german_excel, utf16_tabs, byte_order_mark_and_comments, no_header,
    savetxt, quoted, gps_time, clockwise_and_wheels, long_form,
)  # fmt: skip


@pytest.mark.parametrize("dialect", DIALECTS, ids=lambda dialect: dialect.__name__)
def test_odometry_of_every_dialect(dialect: Dialect, tmp_path: Path) -> None:
    road = journey(120)
    log, sections = dialect(road)
    sections["drive"] = {
        "vehicle": {"wheelbase_m": 2.7},
        "frame": {"kind": "local", "name": "here"},
    }
    drive = convert(tmp_path, log, sections)
    assert drive.odometry is not None
    np.testing.assert_allclose(drive.odometry.stamp_s, road.stamp_s, atol=2e-6)
    np.testing.assert_allclose(drive.odometry.speed_mps, road.speed_mps, atol=2e-7)
    np.testing.assert_allclose(drive.odometry.yaw_rate_radps, road.yaw_rate_radps, atol=2e-8)


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
        "odometry": {"stamp_s": "t_s", **_columns()},
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
        "odometry": {"stamp_s": "t_s", **_columns(), "speed_mps": {"column": "v", "unit": "m/s"}},
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
                     **_columns()},
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
                                 "zone": "-05:00"}, **_columns()},
    }  # fmt: skip
    times = clock(road.stamp_s - 5 * 3600.0, american)
    drive = convert(tmp_path, table({"time": times, **_plain(road)}), sections)
    assert drive.odometry is not None
    np.testing.assert_allclose(drive.odometry.stamp_s, road.stamp_s, atol=2e-6)
