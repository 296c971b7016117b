"""How much one scan may hold."""

from __future__ import annotations

import numpy as np

from polemap.drivelog.errors import InputError
from polemap.drivelog.tables import Table

MOST_A_SCAN = 300


def check_crowd(table: Table, what: str, advice: str) -> None:
    """No scan holds more than a street has: matching takes the square of their number.

    Args:
        what: rows are: "poles".
        advice: which of them to keep.

    Raises:
        InputError: the first scan that holds more.
    """
    stamps = table["stamp_s"]
    if len(stamps) <= MOST_A_SCAN:
        return
    crowded = np.flatnonzero(stamps[MOST_A_SCAN:] == stamps[:-MOST_A_SCAN])
    if len(crowded):
        row = int(crowded[0])
        count = int(np.count_nonzero(stamps == stamps[row]))
        raise InputError(
            f"{table.path}, line {table.lines[row]}: {count} {what} at stamp_s {stamps[row]:.6f}, "
            f"a scan may have {MOST_A_SCAN}; {advice}, or give each scan its own stamp"
        )
