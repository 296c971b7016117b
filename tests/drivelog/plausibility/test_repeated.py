"""Fixes that come back or cannot be, poles twice in a scan, and how far poles are believed."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from polemap.drivelog.drive import Drive
from polemap.drivelog.plausibility.check import check_drive
from polemap.drivelog.readers.registry import open_drive
from polemap.drivelog.writers.folder import write_drive
from tests.drivelog.plausibility.made import clean_drive, with_points


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    write_drive(replace(clean_drive(0), reference=None), tmp_path / "drive")
    return tmp_path / "drive"


def _found(folder: Path) -> dict[str, tuple[str, str, str]]:
    return {f.kind: (f.severity, f.stream, f.value) for f in check_drive(open_drive(folder))}


@pytest.mark.parametrize("old", [0, 60, "yesterday"])
@pytest.mark.parametrize("every", [5])
def test_an_old_fix_between_others_is_left_out_and_told(
    old: int | str, every: int, folder: Path
) -> None:
    table = pd.read_csv(folder / "gnss.csv", dtype={"stamp_s": str})
    columns = ["latitude_deg", "longitude_deg"]
    place = table.loc[old, columns] if isinstance(old, int) else [52.45, 13.3]
    table.loc[::every, columns] = np.asarray(place, dtype=np.float64)
    table.to_csv(folder / "gnss.csv", index=False)
    found = _found(folder)
    assert set(found) == {"gnss_repeated"}
    severity, stream, value = found["gnss_repeated"]
    assert (severity, stream) == ("warning", "gnss.csv")
    count = int(value.split()[0])
    assert 0.6 * len(table) / every < count <= len(table) / every + 1
    assert len(open_drive(folder).gnss) == len(table) - count


@pytest.mark.parametrize(("latitude", "every"), [(90.0, 1), (-90.0, 2), (90.0, 5)])
def test_fixes_at_a_pole_of_the_earth_are_left_out_and_told(
    latitude: float, every: int, folder: Path
) -> None:
    table = pd.read_csv(folder / "gnss.csv", dtype={"stamp_s": str})
    table.loc[::every, "latitude_deg"] = latitude
    table.to_csv(folder / "gnss.csv", index=False)
    found = _found(folder)
    assert set(found) == {"rows_left_out"}
    severity, stream, value = found["rows_left_out"]
    assert severity == ("error" if every == 1 else "warning")
    assert stream == "gnss.csv"
    assert value.endswith("rows cannot be used (latitude beyond utm)")


@pytest.mark.parametrize("moved_m", [0.0, 1e-4])
def test_a_pole_that_stands_twice_in_a_scan_counts_once(moved_m: float, folder: Path) -> None:
    before = open_drive(folder)
    table = pd.read_csv(folder / "poles.csv", dtype={"stamp_s": str})
    table = table.loc[table.index.repeat(2)].reset_index(drop=True)
    table["x_m"] = table["x_m"].round(3) + np.where(table.index % 2, moved_m, 0.0)
    table.to_csv(folder / "poles.csv", index=False)
    found = _found(folder)
    assert found["rows_left_out"][:2] == ("warning", "poles.csv")
    assert f"{len(table) // 2} of {len(table)} rows" in found["rows_left_out"][2]
    after = open_drive(folder)
    (told,) = (f for f in after.findings if f.kind == "rows_left_out")
    assert told.remedy == "write each pole of a scan once"
    assert [len(scan) for scan in after.scans] == [len(scan) for scan in before.scans]


def _with_probability(drive: Drive, probability: float) -> Drive:
    scans = tuple(
        replace(s, probability=np.full(len(s), probability)) if len(s) else s for s in drive.scans
    )
    return replace(drive, scans=scans)


@pytest.mark.parametrize(
    ("probability", "severity"),
    [(0.0, "error"), (0.1, "warning"), (0.5, None), (90.0, "error")],
)
def test_probabilities_with_which_nothing_matches_are_told(
    probability: float, severity: str | None
) -> None:
    found = check_drive(_with_probability(clean_drive(0), probability))
    assert [(f.kind, f.severity) for f in found] == (
        [("pole_probability", severity)] if severity else []
    )


def test_an_axis_of_another_scale_is_an_error() -> None:
    """Poles twice as far to the sides look as if they were seen from far ahead."""
    drive = with_points(clean_drive(0), lambda points: points * np.array([1.0, 2.0]))
    found = {f.stream: f for f in check_drive(drive)}
    assert found["poles.csv"].severity == "error"
