"""Files of a drive that are there: whether they are files, and whether their rows can be used."""

from __future__ import annotations

import os
from pathlib import Path

from polemap.drivelog.errors import InputError
from polemap.drivelog.findings import Finding
from polemap.drivelog.tables import Table

_LOST_MAX = 0.05
# left out for what they hold, not for when they came
_TIMELY = ("duplicate_stamps", "stamp_far_from_rest")


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


def row_findings(table: Table) -> list[Finding]:
    """A file without rows, and one of which many rows were left out for what they hold."""
    lost = {why: count for why, count in table.dropped.items() if why not in _TIMELY}
    left_out, name = sum(lost.values()), table.path.name
    if not len(table) and not left_out:
        return [
            Finding(
                "no_rows", "warning", name, "holds a header and no rows", "one row a sample",
                "remove the file if the car has no such sensor",
            )
        ]  # fmt: skip
    if left_out <= _LOST_MAX * (len(table) + left_out):
        return []
    reasons = ", ".join(why.replace("_", " ") for why in lost)
    return [
        Finding(
            "rows_left_out", "warning" if len(table) else "error", name,
            f"{left_out} of {len(table) + left_out} rows cannot be used ({reasons})",
            f"at most {100 * _LOST_MAX:.0f} % of them", "write finite numbers in SI units",
        )
    ]  # fmt: skip
