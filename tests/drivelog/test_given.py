"""Files that are none, files without rows, and rows that cannot be used."""

from __future__ import annotations

import os
import re
from collections.abc import Callable
from pathlib import Path

import pytest

from polemap.drivelog.errors import InputError
from polemap.drivelog.plausibility.check import check_drive
from polemap.drivelog.readers.registry import open_drive

STREAMS = ("odometry.csv", "gnss.csv", "reference.csv", "poles.csv", "scans.csv")


def _link(path: Path, to: str) -> None:
    path.symlink_to(to)


NO_FILES: dict[str, Callable[[Path], None]] = {
    "a folder": lambda path: path.mkdir(),
    "a device or pipe": lambda path: os.mkfifo(path),
    "a link that leads nowhere": lambda path: _link(path, path.name),
}


@pytest.mark.parametrize("name", [*STREAMS, "laps.csv", "frames.csv"])
@pytest.mark.parametrize("what", NO_FILES)
def test_what_only_has_a_file_s_name_is_no_absent_sensor(
    folder: Path, name: str, what: str
) -> None:
    (folder / name).unlink(missing_ok=True)
    NO_FILES[what](folder / name)
    with pytest.raises(InputError, match=rf"{name}: is {what}, not a file"):
        open_drive(folder)


@pytest.mark.parametrize("name", STREAMS)
@pytest.mark.parametrize("rows", [0, 1, 2])
def test_a_file_with_few_rows_is_checked_like_any(folder: Path, name: str, rows: int) -> None:
    lines = (folder / name).read_text().splitlines()
    (folder / name).write_text("\n".join(lines[: 1 + rows]) + "\n")
    found = [f for f in check_drive(open_drive(folder)) if f.kind == "no_rows"]
    assert [f.stream for f in found] == ([name] if rows == 0 else [])


@pytest.mark.parametrize(
    ("share", "severity"), [(0.0, None), (0.005, "note"), (0.03, "warning"), (1.0, "error")]
)
@pytest.mark.parametrize("cell", ["nan", "", "1e300"])
def test_rows_that_cannot_be_used_are_a_finding(
    folder: Path, cell: str, share: float, severity: str | None
) -> None:
    path = folder / "odometry.csv"
    head, *rows = path.read_text().splitlines()
    # long enough that a two hundredth of the rows is one at least
    last = rows[-1].split(",")
    rows += [",".join([repr(float(last[0]) + 0.1 * i), *last[1:]]) for i in range(1, 300)]
    for i in range(int(share * len(rows))):
        cells = rows[i].split(",")
        cells[head.split(",").index("speed_mps")] = cell
        rows[i] = ",".join(cells)
    path.write_text("\n".join([head, *rows]) + "\n")
    found = [f for f in check_drive(open_drive(folder)) if f.kind == "rows_left_out"]
    assert [f.severity for f in found] == ([severity] if severity else [])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda text: text.replace(",", ";"), "separate columns by commas"),
        (lambda text: text.replace(",", "\t"), "separate columns by commas"),
        (lambda text: text.replace(",", ";").replace(".", ","), "separate columns by commas"),
        (lambda text: "# a recorder\n" + text, "delete the comment"),
    ],
)
def test_other_marks_between_columns_are_named(
    folder: Path, change: Callable[[str], str], message: str, recwarn: pytest.WarningsRecorder
) -> None:
    path = folder / "odometry.csv"
    path.write_text(change(path.read_text()))
    with pytest.raises(InputError, match=message):
        open_drive(folder)
    assert not recwarn.list


def test_spaces_around_names_of_columns_are_no_part_of_them(folder: Path) -> None:
    path = folder / "odometry.csv"
    before = open_drive(folder).odometry
    path.write_text(path.read_text().replace(",", " , "))
    after = open_drive(folder).odometry
    assert before is not None
    assert after is not None
    assert (before.speed_mps == after.speed_mps).all()


def test_a_detector_s_place_in_millimetres_is_refused(folder: Path) -> None:
    path = folder / "drive.yaml"
    head, mark, detector = path.read_text().partition("pole_detector:")
    assert mark
    path.write_text(head + mark + re.sub(r"x_m: .*", "x_m: 1500", detector, count=1))
    with pytest.raises(InputError, match=r"pole_detector.x_m.*15 .*1500"):
        open_drive(folder)


@pytest.mark.parametrize("word", ["yes", "true", "on", "no"])
def test_yes_is_no_wheelbase(folder: Path, word: str) -> None:
    path = folder / "drive.yaml"
    path.write_text(re.sub(r"wheelbase_m: .*", f"wheelbase_m: {word}", path.read_text()))
    with pytest.raises(InputError, match=r"wheelbase_m: is (true|false), which is no number"):
        open_drive(folder)
