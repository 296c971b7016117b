"""What only the user knows is asked for, with the first rows and the line that settles it."""

from __future__ import annotations

import csv
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from polemap.drivelog.readers.registry import open_drive
from polemap.tools import cli
from tests.drivelog.logs.recorded import cells, journey, table

DRIVE = {"vehicle": {"wheelbase_m": 2.7}, "frame": {"kind": "local", "name": "here"}}
ODOMETRY = {
    "stamp_s": {"column": "t", "unit": "s"},
    "speed_mps": {"column": "v", "unit": "m/s"},
    "yaw_rate_radps": {"column": "r", "unit": "rad/s"},
}
GOOD = "t,v,r\n0,1,0\n1,1,0.1\n2,1,0.1\n3,1,0\n"


def run(tmp_path: Path, log: str | bytes, **sections: Any) -> int:
    tree = {"drive": DRIVE, "odometry": ODOMETRY, **sections}
    (tmp_path / "log.csv").write_bytes(log.encode() if isinstance(log, str) else log)
    (tmp_path / "map.yaml").write_text(yaml.safe_dump(tree, sort_keys=False))
    words = ["convert", tmp_path / "log.csv", "--mapping", tmp_path / "map.yaml",
             "--out", tmp_path / "drive"]  # fmt: skip
    return cli.run([str(word) for word in words])


def refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], log: str | bytes, **sections: Any
) -> str:
    assert run(tmp_path, log, **sections) == cli.USER_ERROR
    error = capsys.readouterr().err
    assert all(line.startswith("polemap: ") for line in error.splitlines())
    assert not (tmp_path / "drive").exists()
    return error


def stamps(**keys: Any) -> dict[str, Any]:
    return {"odometry": {**ODOMETRY, "stamp_s": {"column": "t", **keys}}}


ASKED = [
    # is it more than a thousand?
    ("t;v;r\n0;1,234;0\n1;1,235;0\n", {}, ["1,234", "decimal: ','", "thousands: ','"]),
    ("t;v;r\n0;1.234,5;0\n1;2.234,5;0\n", {}, ["1.234,5", "decimal: ',', thousands: '.'"]),
    ("t;v;r\n0;1,5;0\n1;1.5;0\n", {}, ["«0;1,5;0»", "decimal: ','"]),
    # decimal commas between commas
    ("t,v,r\n0,5,1,5,0,0\n1,5,1,5,0,0\n", {}, ["3 names above rows of 6 cells", "«t,v,r»"]),
    # what separates?
    ("t v r\n0,5 1,5 0,5\n1,5 1,5 0,5\n", {}, ["blanks or commas", "separator: blanks"]),
    ("t v r,\n0 1;5,0\n1|2 3\n", {}, ["names above rows"]),
    # names or values?
    ("t,v,1\n0,1,0\n1,1,0\n", {}, ["names or values", "header_line: 1", "header_line: none"]),
    ("t,v,r\nx,y,z\n0,1,0\n1,1,0\n", {}, ["units_line: 2", "skip_lines: [2]"]),
    # times
    (GOOD, stamps(), ["unit of the stamps is not said", "`unit: s`"]),
    (GOOD.replace("\n1,", "\n1714564800000,"), stamps(), ["unit of the stamps"]),
    ("t,v,r\n2024-05-01T12:00:00,1,0\n", stamps(), ["the zone of", "zone: UTC"]),
    ("t,v,r\n01/02/2024 12:00,1,0\n", stamps(), ["day or month first", "'%d/%m/%Y %H:%M'"]),
    ("t,v,r\n12:00:00,1,0\n", stamps(), ["has no day", "date: 2024-05-31"]),
    ("t,v,r\nnoon,1,0\n", stamps(), ["no time of ISO 8601", "add its format"]),
    ("t,v,r\n2024-05-01T12:00:00,1,0\n", stamps(zone="Atlantis"), ["zone 'Atlantis' is unknown"]),
    ("t,v,r\n2024-10-27T01:59:59,1,0\n2024-10-27T03:00:01,1,0\n", stamps(zone="Europe/Berlin"),
     ["clocks are changed", "+02:00"]),
    ("t,w,v,r\n5,290,1,0\n", stamps(unit="s", week="w", leap_seconds=18), ["GPS week 290", "full"]),
    ("t,w,v,r\n9e6,2300,1,0\n", stamps(unit="s", week="w", leap_seconds=18), ["seconds of week"]),
    (GOOD, stamps(unit="s", week="v"), ["needs leap_seconds"]),
    (GOOD, stamps(unit="s", leap_seconds=18), ["leap_seconds needs"]),
    (GOOD, stamps(unit="parsec"), ["'parsec' is no unit of time"]),
    ("t,v,r\n5,1,0\n9,1,0\n1,1,0\n", {}, ["go back by 8.000 s", "row 3"]),
    # columns and units
    (GOOD, {"odometry": {**ODOMETRY, "speed_mps": "v"}}, ["unit of column 'v'", "km/h", "1, 1, 1"]),
    (GOOD, {"odometry": {**ODOMETRY, "speed_mps": {"column": "V", "unit": "m/s"}}},
     ["no column 'V'", "did you mean 'v'"]),
    (GOOD, {"odometry": {**ODOMETRY, "speed_mps": {"column": 7, "unit": "m/s"}}},
     ["no column 7", "has 3"]),
    (GOOD.replace("v,r", "v,v"), {}, ["'v' stands twice", "columns 2 and 3"]),
    (GOOD, {"odometry": {**ODOMETRY, "speed_mps": {"column": "v", "unit": "furlong"}}},
     ["'furlong' is no unit", "km/h"]),
    (GOOD, {"scans": ODOMETRY}, ["scans.speed_mps: unknown column"]),
    ("t,e,n,h\n0,1,2,3\n", {"odometry": {}, "reference": {
        "stamp_s": {"column": "t", "unit": "s"}, "east_m": {"column": "e", "unit": "m"},
        "north_m": {"column": "n", "unit": "m"}, "yaw_rad": {"column": "h", "unit": "deg"}}},
     ["needs its convention", "turn: clockwise, from: true_north"]),
    # lines
    ("t,v,r\n0,1,0\n1,1\n2,1,0\n", {}, ["line 3: 2 cells under 3 columns", "bad_lines: drop"]),
    ("t,v,r\n0,1,0\n1,one,0\n2,1,0\n", {}, ["line 3: speed_mps is 'one'", "missing: ['one']"]),
    ("t,v,r\n0,1_0,0\n", {}, ["speed_mps is '1_0'"]),
    ('t,v,r\n0,"1,0\n', {}, ["what separates", "separator: ','"]),
    ("t,v,r\n0,1,0\nOFF,1,0\n2,1,0\n", {}, ["line 3: the stamp is 'OFF'", "missing: ['OFF']"]),
    ("t;v;r\n0;1;0\n1,1,0\n2;1;0\n3;1;0\n", {}, ["line 3: 1 cells under 3 columns"]),
    # nothing is left
    ("t,v,r\n0,nan,0\n1,nan,0\n", {}, ["none of 2 rows can be used (2 speed_mps not given)"]),
    ("t,v,r\n", {}, ["none of 0 rows can be used (the log is empty)"]),
    # files
    ("", {}, ["empty file"]),
    ("\n\n# nothing\n", {}, ["holds no rows"]),
    (b"\x00\x01\x02\x00\x00\x01", {}, ["NUL bytes and is no text"]),
    ("t,v,gr\xfc\xdf\n0,1,0\n".encode("latin-1"), {}, ["0xfc", "encoding: latin-1"]),
    (GOOD, {"format": {"encoding": "klingon"}}, ["encoding 'klingon' is unknown"]),
    (GOOD, {"format": {"header_line": 9}}, ["holds no rows"]),
    (GOOD, {"odometry": {**ODOMETRY, "file": "other.csv"}}, ["no log is called 'other.csv'"]),
]  # fmt: skip


@pytest.mark.parametrize(("log", "sections", "parts"), ASKED, ids=lambda value: repr(value)[:40])
def test_what_is_open_is_asked_for(
    log: str | bytes,
    sections: dict[str, Any],
    parts: list[str],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    error = refused(tmp_path, capsys, log, **sections)
    for part in parts:
        assert part in error


ANSWERED = [
    ("t;v;r\n0;1,234;0\n1;1,234;0\n", {"decimal": ","}, 1.234),
    ("t;v;r\n0;1,234;0\n1;1,234;0\n", {"decimal": ".", "thousands": ","}, 1234.0),
    ("t;v;r\n0;1.234,5;0\n1;1.234,5;0\n", {"decimal": ",", "thousands": "."}, 1234.5),
    ("t v r\n0,5 1,5 0,5\n1,5 1,5 0,5\n", {"separator": "blanks", "decimal": ","}, 1.5),
    ("t,v,r\nx,y,z\n0,5,0\n1,5,0\n", {"skip_lines": [2]}, 5.0),
    ("nonsense\nt,v,r\n0,5,0\n1,5,0\n", {"header_line": 2}, 5.0),
    ("t,v,r\n0,5,0\n1,5\n2,5,0\n", {"bad_lines": "drop"}, 5.0),
    ("! hear\nt,v,r\n0,5,0\n! hear\n1,5,0\n", {"comment": "!"}, 5.0),
    ("t,v,gr\xfc\xdf,r\n0,5,0,0\n".encode("latin-1"), {"encoding": "latin-1"}, 5.0),
]


@pytest.mark.parametrize(("log", "layout", "speed"), ANSWERED)
def test_the_line_that_was_asked_for_settles_it(
    log: str | bytes, layout: dict[str, Any], speed: float, tmp_path: Path
) -> None:
    tree = {"drive": DRIVE, "odometry": ODOMETRY, "format": layout}
    (tmp_path / "log.csv").write_bytes(log.encode() if isinstance(log, str) else log)
    (tmp_path / "map.yaml").write_text(yaml.safe_dump(tree))
    words = ["convert", tmp_path / "log.csv", "--mapping", tmp_path / "map.yaml", "--force",
             "--out", tmp_path / "drive"]  # fmt: skip
    assert cli.run([str(word) for word in words]) == cli.GOOD
    odometry = open_drive(tmp_path / "drive").odometry
    assert odometry is not None
    np.testing.assert_array_equal(odometry.speed_mps, speed)


def test_all_mistakes_of_a_mapping_at_once(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    error = refused(
        tmp_path,
        capsys,
        GOOD,
        drive={"vehicle": {"wheelbase_m": -1}, "frame": {"kind": "mars"}},
        format={"separator": "x", "header": 1},
        odometri={},
        odometry={
            "stamp_s": {"unit": "s"},
            "speed_mps": {"column": "v", "units": "m/s", "sign": 2},
            "yaw_rate_radps": {"column": "r", "unit": "m"},
            "speed": "v",
            "measured_at": {"x_m": 1},
        },
        signals={"yaw_rate_radps": 1, "sidesliprad": 1},
        scans=3,
    )
    for part in (
        "odometri: unknown section", "did you mean 'odometry'", "drive.vehicle.wheelbase_m",
        "drive.frame: kind is 'mars'", "format.separator", "format.header: unknown key",
        "odometry.stamp_s: needs `column`", "odometry.speed_mps.units: unknown key",
        "did you mean 'unit'", "odometry.speed_mps.sign", "'m' is no unit for it",
        "odometry.speed: unknown column", "measured_at.y_m: is missing", "only a reference has it",
        "signals.sidesliprad: unknown column", "scans: is no section",
    ):  # fmt: skip
        assert part in error, part


def test_all_missing_columns_at_once(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    error = refused(tmp_path, capsys, "a,b,c\n0,1,0\n1,1,0\n")
    for name in ("t", "v", "r"):
        assert f"no column '{name}' in log.csv (a, b, c)" in error


@pytest.mark.parametrize("text", ["", "[1, 2]", "odometry", "a: [", "drive: 5"])
def test_no_mapping(text: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "log.csv").write_text(GOOD)
    (tmp_path / "map.yaml").write_text(text)
    words = ["convert", str(tmp_path / "log.csv"), "--mapping", str(tmp_path / "map.yaml")]
    assert cli.run([*words, "--out", str(tmp_path / "d")]) == cli.USER_ERROR
    assert "map.yaml" in capsys.readouterr().err


def test_without_a_mapping_one_is_offered_and_completes(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    road = journey(100)
    log = tmp_path / "can.csv"
    log.write_text(
        table({
            "Time [ms]": cells(road.stamp_s * 1e3, "%.3f"),
            "VehicleSpeed_kmh": cells(road.speed_mps * 3.6),
            "gyro_z": cells(road.yaw_rate_radps),
            "lat": cells(road.latitude_deg),
            "lon": cells(road.longitude_deg),
        })
    )  # fmt: skip
    assert cli.run(["convert", str(log), "--out", str(tmp_path / "d")]) == cli.USER_ERROR
    assert "--write-mapping" in capsys.readouterr().err
    made = tmp_path / "map.yaml"
    assert cli.run(["convert", str(log), "--write-mapping", str(made)]) == cli.GOOD
    assert "5 values say CHOOSE" in capsys.readouterr().out
    words = ["convert", str(log), "--mapping", str(made), "--out", str(tmp_path / "d")]
    assert cli.run(words) == cli.USER_ERROR
    assert capsys.readouterr().err.count("still says CHOOSE") == 5
    text = made.read_text()
    text = text.replace("wheelbase_m: CHOOSE", "wheelbase_m: 2.7")
    text = text.replace("unit: CHOOSE, turn: CHOOSE", "unit: rad/s, turn: counter_clockwise")
    made.write_text(text.replace("unit: CHOOSE", "unit: deg"))
    assert cli.run(words) == cli.GOOD
    drive = open_drive(tmp_path / "d")
    assert drive.gnss is not None
    assert drive.odometry is not None
    np.testing.assert_allclose(drive.odometry.speed_mps, road.speed_mps, atol=1e-6)
    assert cli.run(["convert", str(log), "--write-mapping", str(made)]) == cli.USER_ERROR
    assert "is there already" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("names", "section", "unused"),
    [
        (("t [s]", "speed [m/s]", "foo"), "odometry", '"foo"'),
        (("t [s]", "east", "north", "foo", "bar"), "reference", '"foo", "bar"'),
        (("t [s]", "foo", "bar"), "odometry", '"foo", "bar"'),
    ],
)
def test_columns_whose_names_tell_nothing_have_a_place_in_the_mapping(
    names: tuple[str, ...], section: str, unused: str, tmp_path: Path
) -> None:
    log, made = tmp_path / "log.csv", tmp_path / "map.yaml"
    rows = [",".join(str(0.1 * row + column) for column in range(len(names))) for row in range(30)]
    log.write_text("\n".join([",".join(names), *rows]) + "\n")
    assert cli.run(["convert", str(log), "--write-mapping", str(made)]) == cli.GOOD
    text = made.read_text()
    assert list(yaml.safe_load(text)) == ["drive", section]
    assert f"their names tell nothing: {unused}." in text
    assert "column: CHOOSE" in text


def test_two_logs_need_names(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name in ("a.csv", "b.csv"):
        (tmp_path / name).write_text(GOOD)
    (tmp_path / "m.yaml").write_text(yaml.safe_dump({"drive": DRIVE, "odometry": ODOMETRY}))
    words = ["convert", "a.csv", "b.csv", "--mapping", "m.yaml", "--out", "d"]
    words = [str(tmp_path / w) if "." in w or w == "d" else w for w in words]
    assert cli.run(words) == cli.USER_ERROR
    assert "which log holds it? add `file: a.csv`" in capsys.readouterr().err


_QUOTED = '"' + "9," * 100_000


@pytest.mark.parametrize("line", [1, 60, 900])
@pytest.mark.parametrize(
    ("cell", "said"),
    [
        ("9" * 200_000, "a cell of more than 10000|field larger"),
        (f'{_QUOTED}"', "field larger"),
        (_QUOTED, "field larger"),
        ('"1', "never closed|field larger|cells under|names above"),
        ("\0", "NUL"),
    ],
)
def test_cells_beyond_every_limit_are_told_in_one_line(
    cell: str, said: str, line: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Python's own limit of a cell holds until a reader sets another: each sets it first."""
    csv.field_size_limit(131_072)
    rows = ["t,v,r", *(f"{k / 10:.1f},{5 + k % 3},0.1" for k in range(2000))]
    cells = rows[line - 1].split(",")
    rows[line - 1] = ",".join([cells[0], cell, cells[2]])
    error = refused(tmp_path, capsys, "\n".join(rows) + "\n", odometry=ODOMETRY)
    assert re.search(said, error)
    assert error.count("\n") <= 1
    assert len(error) < 400
