"""lines.csv and the kinds of poles.csv: read, written, refused."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from polemap.drivelog.detections import NOTHING_IN_VIEW, VisibleRegion, pole_detections
from polemap.drivelog.drive import Drive
from polemap.drivelog.errors import InputError
from polemap.drivelog.frames import EarthFrame
from polemap.drivelog.landmark_kind import LandmarkKind, LineStyle
from polemap.drivelog.line_detections import LineDetections, line_detections
from polemap.drivelog.plausibility.lines import line_findings
from polemap.drivelog.plausibility.time import overlap_findings
from polemap.drivelog.readers.folder import reader
from polemap.drivelog.writers.folder import write_drive

HEAD = """\
format_version: 1
name: kinds
frame: {kind: local, name: yard}
vehicle: {wheelbase_m: 2.7}
"""
COLUMNS = "stamp_s,kind,x0_m,y0_m,x1_m,y1_m,offset_sd_m,direction_sd_rad"
KERB = "kerb,4.0,-2.0,9.0,-2.1,0.05,0.01"
POLES = "stamp_s,x_m,y_m,var_x_m2,var_y_m2,cov_xy_m2"
POLE = "10.0,4.0,0.01,0.01,0.0"


def _folder(tmp_path: Path, **files: str) -> Path:
    (tmp_path / "drive.yaml").write_text(HEAD)
    for name, text in files.items():
        (tmp_path / f"{name}.csv").write_text(text)
    return tmp_path


def test_lines_join_the_scan_of_their_stamp(tmp_path: Path) -> None:
    lines = f"{COLUMNS},style\n1.0,{KERB},\n1.0,lane_marking,3,1.5,8,1.5,0.04,0.01,dashed\n"
    place = _folder(tmp_path, poles=f"{POLES}\n1.0,{POLE}\n2.0,{POLE}\n", lines=lines)
    first, second = reader.read(place).scans
    assert first.lines is not None
    assert second.lines is not None
    assert first.lines.kind.tolist() == [LandmarkKind.KERB, LandmarkKind.LANE_MARKING]
    assert first.lines.style.tolist() == [LineStyle.UNKNOWN, LineStyle.DASHED]
    np.testing.assert_allclose(first.lines.end_vehicle_m, [[9.0, -2.1], [8.0, 1.5]])
    assert len(first) == len(second) == 1
    assert len(second.lines) == 0, "it looked, and saw none"


def test_lines_of_a_detector_with_own_stamps_make_scans_that_say_nothing_of_poles(
    tmp_path: Path,
) -> None:
    rows = "".join(f"{t},{KERB}\n" for t in (1.03, 1.53, 2.03))
    place = _folder(
        tmp_path, poles=f"{POLES}\n1.0,{POLE}\n2.0,{POLE}\n", lines=f"{COLUMNS}\n{rows}"
    )
    scans = reader.read(place).scans
    assert [scan.stamp_s for scan in scans] == [1.0, 1.03, 1.53, 2.0, 2.03]
    assert [scan.lines is None for scan in scans] == [True, False, False, True, False]
    for scan in scans:
        if scan.lines is not None:
            assert scan.view is not None
            assert scan.view.sees_nothing
            assert not scan.view.contains(np.array([[5.0, 1.0], [0.0, 0.0]])).any()


def test_corners_stand_in_the_table_of_poles(tmp_path: Path) -> None:
    text = f"{POLES},kind,facing_rad\n1.0,{POLE},,\n1.0,20,4,0.01,0.01,0,corner,-4.0\n"
    (scan,) = reader.read(_folder(tmp_path, poles=text)).scans
    assert scan.kind.tolist() == [LandmarkKind.POLE, LandmarkKind.CORNER]
    np.testing.assert_allclose(scan.facing_rad, [np.nan, 2 * np.pi - 4.0])


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        ("lines", f"{COLUMNS}\n1.0,{KERB}\n1.1,fence,1,2,3,4,1,1\n",
         r"lines.csv, line 3: kind is 'fence'; write one of lane_marking, kerb, facade"),
        ("lines", f"{COLUMNS},style\n1.0,{KERB},zigzag\n",
         r"lines.csv, line 2: style is 'zigzag'; write one of unknown, solid, dashed, double"),
        ("lines", f"{COLUMNS}\n1.0,kerb,a,2,3,4,1,1\n", r"lines.csv, line 2: x0_m is 'a'"),
        ("lines", f"{COLUMNS[:-17]}\n1.0\n", r"lines.csv: column 'direction_sd_rad' is missing"),
        ("lines", f"{COLUMNS}\n" + f"1.0,{KERB}\n" * 301,
         r"lines.csv, line 2: 301 lines at stamp_s 1.000000"),
        ("poles", f"{POLES},kind\n1.0,{POLE},kerb\n",
         r"poles.csv, line 2: kind is 'kerb'; write one of pole, corner"),
        ("poles", f"{POLES},kind,facing_rad\n1.0,{POLE},corner,90\n",
         r"poles.csv, line 2: facing_rad is 90, more than a turn; write radians"),
    ],
)  # fmt: skip
def test_refusals_name_file_row_value_and_remedy(
    tmp_path: Path, name: str, text: str, said: str
) -> None:
    with pytest.raises(InputError, match=said):
        reader.read(_folder(tmp_path, **{name: text}))


def test_rows_that_cannot_be_used_are_counted(tmp_path: Path) -> None:
    rows = [f"1.0,{KERB}", "1.0,kerb,4,2,9,2,0,0.01", "1.0,kerb,4,2,4,2,0.1,0.01",
            "1.0,kerb,nan,2,4,2,0.1,0.01"]  # fmt: skip
    drive = reader.read(_folder(tmp_path, lines="\n".join([COLUMNS, *rows]) + "\n"))
    assert drive.problems == {
        "lines_sd_not_positive": 1, "lines_ends_in_one_point": 1, "lines_not_finite": 1,
    }  # fmt: skip
    (scan,) = drive.scans
    assert scan.lines is not None
    assert len(scan.lines) == 1


def _drive() -> Drive:
    rng = np.random.default_rng(5)
    view = VisibleRegion(np.zeros(2), -1.0, 1.0, 2.0, np.array([30.0]))
    lines = line_detections(
        LandmarkKind.KERB, rng.uniform(1, 9, (3, 2)), rng.uniform(10, 20, (3, 2)),
        np.full(3, 0.05), np.full(3, 0.01), style=LineStyle.SOLID,
    )  # fmt: skip
    points, spread = rng.uniform(3, 9, (2, 2)), np.tile(np.eye(2) * 0.01, (2, 1, 1))
    seen = pole_detections(1.0, 1.1, points, spread, view=view)
    seen = replace(
        seen, lines=lines, kind=np.array([0, 1], dtype=np.int8),
        facing_rad=np.array([np.nan, 1.25]),
    )  # fmt: skip
    bare = pole_detections(1.5, 1.5, np.empty((0, 2)), np.empty((0, 2, 2)), view=NOTHING_IN_VIEW)
    alone = replace(bare, lines=lines.take(slice(1)))
    empty = pole_detections(2.0, 2.0, np.empty((0, 2)), np.empty((0, 2, 2)), view=view)
    none = replace(empty, lines=LineDetections.none())
    return Drive("kinds", Path("x"), EarthFrame("local", name="y"), 2.7, scans=(seen, alone, none))


def test_what_is_written_is_read_again(tmp_path: Path) -> None:
    drive = _drive()
    write_drive(drive, tmp_path / "out")
    again = reader.read(tmp_path / "out")
    assert not again.problems
    for mine, theirs in zip(drive.scans, again.scans, strict=True):
        assert (mine.stamp_s, mine.arrival_s) == (theirs.stamp_s, theirs.arrival_s)
        assert mine.view is not None
        assert theirs.view is not None
        assert mine.view.sees_nothing == theirs.view.sees_nothing
        assert mine.kind.tolist() == theirs.kind.tolist()
        np.testing.assert_allclose(mine.facing_rad, theirs.facing_rad, atol=1e-6)
        assert mine.lines is not None
        assert theirs.lines is not None
        for name, values in mine.lines.arrays().items():
            np.testing.assert_allclose(theirs.lines.arrays()[name], values, atol=1e-5)


@pytest.mark.parametrize(
    ("column", "factor", "kind"),
    [("direction_sd_rad", 180 / np.pi, "line_direction_sd"), ("offset_sd_m", 1e3, "line_offset_sd"),
     ("start_vehicle_m", 1e3, "line_range"), ("probability", 100.0, "line_probability")],
)  # fmt: skip
def test_other_units_are_found(column: str, factor: float, kind: str) -> None:
    drive = _drive()
    assert line_findings(drive) == []

    def spoilt(lines: LineDetections | None) -> LineDetections | None:
        return lines and lines.with_columns(**{column: lines.arrays()[column] * factor})

    scans = tuple(replace(scan, lines=spoilt(scan.lines)) for scan in drive.scans)
    assert [found.kind for found in line_findings(replace(drive, scans=scans))] == [kind]


@pytest.mark.parametrize(
    ("stamp", "kind"),
    [(lambda t: t + 1.7e9, "clock_apart"), (lambda t: 1e3 * t, "stamp_unit"), (lambda t: t, None)],
)  # fmt: skip
def test_lines_of_another_clock_are_found(
    tmp_path: Path, stamp: Callable[[float], float], kind: str | None
) -> None:
    times = np.arange(2.0, 42.0, 0.1).tolist()
    odometry = ["stamp_s,speed_mps,yaw_rate_radps", *(f"{t:.2f},5.0,0.01" for t in times)]
    lines = [COLUMNS, *(f"{stamp(t):.3f},{KERB}" for t in times)]
    text = {"odometry": "\n".join(odometry) + "\n", "lines": "\n".join(lines) + "\n"}
    found = overlap_findings(reader.read(_folder(tmp_path, **text)))
    assert [(f.kind, f.severity, f.stream) for f in found] == (
        [(kind, "error", "lines.csv")] if kind else []
    )
