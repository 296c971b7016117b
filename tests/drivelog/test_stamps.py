"""Stamps in other units than seconds, and single rows whose clock was not set."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from polemap.drivelog.errors import InputError
from polemap.drivelog.readers.registry import open_drive
from tests.drivelog.drives import write_small


def _change(path: Path, name: str, change) -> None:  # type: ignore[no-untyped-def]
    head, *rows = (path / name).read_text("utf-8").splitlines()
    columns = head.split(",")
    cells = [row.split(",") for row in rows if row]
    (path / name).write_text("\n".join([head, *change(columns, cells)]) + "\n", "utf-8")


def _times(factor: float, offset_s: float):  # type: ignore[no-untyped-def]
    def change(columns: list[str], rows: list[list[str]]) -> list[str]:
        for row in rows:
            for name in ("stamp_s", "arrival_s"):
                if name in columns and row[columns.index(name)]:
                    k = columns.index(name)
                    row[k] = str(round((float(row[k]) + offset_s) * factor))
        return [",".join(row) for row in rows]

    return change


@pytest.mark.parametrize(("factor", "unit"), [(1e3, "ms"), (1e6, "us"), (1e9, "ns")])
def test_units_since_1970_are_taken_as_what_they_are(
    tmp_path: Path, factor: float, unit: str
) -> None:
    plain = open_drive(write_small(tmp_path / "plain", images=0))
    write_small(tmp_path / "ticks", images=0)
    for name in ("odometry.csv", "gnss.csv", "reference.csv", "poles.csv", "scans.csv"):
        _change(tmp_path / "ticks", name, _times(factor, 1.7e9))
    drive = open_drive(tmp_path / "ticks")
    notes = [finding for finding in drive.findings if finding.kind == "stamp_unit"]
    assert {f.stream for f in notes} >= {"odometry.csv", "gnss.csv", "reference.csv"}
    assert all(f.severity == "note" and unit in f.expected for f in notes)
    given = drive.odometry.stamp_s - 1.7e9
    assert given == pytest.approx(plain.odometry.stamp_s, abs=2.0 / factor + 1e-6)


@pytest.mark.parametrize(("place", "stamp"), [(0, "0"), (20, "0"), (40, "9e5"), (40, "-1e6")])
def test_a_row_without_a_clock_is_left_out_and_counted(
    tmp_path: Path, place: int, stamp: str
) -> None:
    write_small(tmp_path / "d", images=0)
    _change(tmp_path / "d", "odometry.csv", _times(1.0, 1.7e9))

    def add(columns: list[str], rows: list[list[str]]) -> list[str]:
        row = list(rows[min(place, len(rows) - 1)])
        row[columns.index("stamp_s")] = stamp
        return [",".join(r) for r in [*rows[:place], row, *rows[place:]]]

    _change(tmp_path / "d", "odometry.csv", add)
    drive = open_drive(tmp_path / "d")
    assert drive.problems["odometry_stamp_far_from_rest"] == 1
    finding = next(f for f in drive.findings if f.kind == "stamp_far_from_rest")
    assert finding.severity == "warning"
    assert f"line {place + 2}" in finding.value
    assert np.ptp(drive.odometry.stamp_s) < 60.0


def test_a_pause_of_a_day_is_no_mistake(tmp_path: Path) -> None:
    write_small(tmp_path / "d", images=0)

    def pause(columns: list[str], rows: list[list[str]]) -> list[str]:
        for number, row in enumerate(rows):
            for name in ("stamp_s", "arrival_s"):
                k = columns.index(name)
                row[k] = repr(float(row[k]) + (86_400.0 if number > 20 else 0.0))
        return [",".join(row) for row in rows]

    _change(tmp_path / "d", "odometry.csv", pause)
    drive = open_drive(tmp_path / "d")
    assert len(drive.odometry) == 40
    assert not drive.findings


def test_decimal_commas_are_refused(tmp_path: Path) -> None:
    write_small(tmp_path / "d", images=0)
    path = tmp_path / "d" / "odometry.csv"
    head, body = path.read_text("utf-8").split("\n", 1)
    path.write_text(head + "\n" + body.replace(".", ","), "utf-8")
    with pytest.raises(InputError, match=r"odometry.csv, line 2: .*cells"):
        open_drive(tmp_path / "d")
