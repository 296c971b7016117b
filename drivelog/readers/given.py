"""Files of a drive that are there: whether they are files, and whether their rows can be used."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from polemap.drivelog.errors import InputError
from polemap.drivelog.findings import Finding
from polemap.drivelog.tables import Table

_LOST_MAX = 0.01
# left out for when they came, or with a finding of their own
_APART = ("duplicate_stamps", "stamp_far_from_rest", "at_zero", "old_fix_repeated")
_REMEDIES = {
    "same_pole_twice_in_a_scan": "write each pole of a scan once",
    "sd_not_positive": "write standard deviations above 0",
    "ends_in_one_point": "write both ends of a piece, in metres",
    "latitude_beyond_utm": "leave the rows out in which the receiver had no fix",
}
# of latitude and longitude zero from the other fixes, in degrees as in metres
_ZERO_APART = {"latitude_deg": 0.01, "east_m": 100.0}
# of a fix that comes back from those around it: metres, steps of these, and how often
_REPEATED_M, _REPEATED_STEPS, _REPEATED_MIN = 20.0, 4.0, 4
_DEGREE_M = 111_000.0


def is_given(path: Path) -> bool:
    """Whether a drive has the file; what only has its name is no absent sensor.

    Raises:
        InputError: a folder, a device, or a link that leads nowhere stands there.
    """
    if path.is_file():
        return True
    if not os.path.lexists(path):
        return False
    if path.is_dir():
        what = "a folder"
    else:
        what = "a device or pipe" if path.exists() else "a link that leads nowhere"
    raise InputError(f"{path}: is {what}, not a file; put the file there, or remove it")


def _remedy(why: str) -> str:
    return _REMEDIES.get(why, "write finite numbers in SI units")


def row_findings(table: Table) -> list[Finding]:
    """A file without rows, and one of which many rows were left out for what they hold."""
    lost = {why: count for why, count in table.dropped.items() if why not in _APART}
    left_out, name = sum(lost.values()), table.path.name
    if not len(table) and not left_out:
        return [
            Finding(
                "no_rows", "warning", name, "holds a header and no rows", "one row a sample",
                "remove the file if the car has no such sensor",
            )
        ]  # fmt: skip
    if not left_out:
        return []
    few = left_out <= _LOST_MAX * (len(table) + left_out)
    reasons = ", ".join(why.replace("_", " ") for why in lost)
    return [
        Finding(
            "rows_left_out", ("note" if few else "warning") if len(table) else "error", name,
            f"{left_out} of {len(table) + left_out} rows cannot be used ({reasons})",
            "none, or leave the row out", "; ".join(dict.fromkeys(_remedy(why) for why in lost)),
        )
    ]  # fmt: skip


def without_zero_places(table: Table, columns: tuple[str, ...]) -> Table:
    """The rows without those at 0, 0 that stand far from the others: the receiver had no fix.

    Args:
        table: the rows of gnss.csv or reference.csv.
        columns: the two that name the place.
    """
    points = np.stack([table[name] for name in columns], axis=1)
    zero = (points == 0.0).all(axis=1)
    others = points[~zero]
    if not zero.any() or not len(others):
        return table
    # nearest in time before and after: a drive through the origin keeps its place
    after = np.cumsum(~zero)[zero]
    nearest = np.stack([others[np.clip(after + k, 0, len(others) - 1)] for k in (-1, 0)])
    far = np.hypot(nearest[..., 0], nearest[..., 1]).min(axis=0) > _ZERO_APART[columns[0]]
    zero[np.flatnonzero(zero)[~far]] = False
    return table.keep(~zero, "at_zero")


def without_repeated_places(table: Table, columns: tuple[str, ...]) -> Table:
    """The rows without those that give an old place again, far from where fixes around stand.

    A receiver that has lost its fix may repeat its last one between others that are right.

    Args:
        table: the rows of gnss.csv.
        columns: the two that name the place.
    """
    points = np.stack([table[name] for name in columns], axis=1)
    if len(points) <= 2 * _REPEATED_MIN:
        return table
    if columns[0] == "latitude_deg":
        narrower = np.cos(np.radians(np.clip(points[0, 0], -89.0, 89.0)))
        points = points * _DEGREE_M * np.array([1.0, narrower])
    _, place = np.unique(points, axis=0, return_inverse=True)
    place = place.reshape(-1)
    # rows after one another at one place are one visit
    starts = np.flatnonzero(np.diff(place, prepend=-1) != 0)
    at, visited = points[starts], place[starts]
    counts = np.bincount(visited)
    again = counts[visited] >= _REPEATED_MIN
    if not again.any() or again.all():
        return table
    step = np.hypot(*np.diff(at[~again], axis=0).T)
    limit = max(_REPEATED_M, _REPEATED_STEPS * float(np.median(step)) if len(step) else 0.0)
    # against the nearest visits before and after of places that do not come back
    after = np.cumsum(~again)
    others = at[~again]
    around = [others[np.clip(after + k, 0, len(others) - 1)] for k in (-1, 0)]
    far = np.min([np.hypot(*(at - other).T) for other in around], axis=0) > limit
    stale = again & far
    if np.count_nonzero(stale) < _REPEATED_MIN:
        return table
    visit = np.cumsum(np.isin(np.arange(len(points)), starts)) - 1
    return table.keep(~stale[visit], "old_fix_repeated")
