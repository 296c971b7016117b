"""Stamps as recorders write them: other units than seconds, and single rows without a clock.

Seconds since 1970 have ten digits before the point until the year 2286; thirteen, sixteen and
nineteen digits are milli-, micro- and nanoseconds and are converted. Stamps that count from a
drive's own start carry no such mark: `plausibility.time` holds their rate against the motion.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.findings import Finding
from polemap.drivelog.tables import Table, sorted_by_stamp

Floats = NDArray[np.float64]

# upper bounds of the median: seconds reach 5e9 in the year 2128
_UNITS = ((1e11, 1.0, "s"), (1e14, 1e3, "ms"), (1e17, 1e6, "us"), (1e20, 1e9, "ns"))
# a row is far from the rest beyond this and a hundred times the span of the middle half
_FAR_S = 3600.0
_FAR_SPANS = 100.0
_FAR_ROWS_MAX, _FAR_SHARE_MAX = 3, 0.001
_TIMES = ("stamp_s", "arrival_s", "start_s", "end_s")


def ticks_per_second(stamps: Floats) -> tuple[float, str]:
    """Ticks in a second, and the unit's name, of stamps `(n,)` that count from 1970."""
    known = np.abs(stamps[np.isfinite(stamps)])
    if not len(known):
        return 1.0, "s"
    # a row or two without a clock must not hide the unit of the rest
    middle = float(np.median(known))
    return next(((ticks, name) for bound, ticks, name in _UNITS if middle < bound), (1.0, "s"))


def in_seconds(table: Table, findings: list[Finding], name: str = "stamp_s") -> Table:
    """The table with its times in seconds; a conversion is noted in `findings`."""
    ticks, unit = ticks_per_second(table[name])
    if ticks == 1.0:
        return table
    columns = {
        key: values / ticks if key in _TIMES else values for key, values in table.columns.items()
    }
    findings.append(
        Finding(
            "stamp_unit",
            "note",
            table.path.name,
            f"{name} of {float(np.median(table[name])):.0f}",
            f"seconds (these are {unit} since 1970)",
            f"taken as {unit} and divided by {ticks:.0e}; write seconds to silence this",
        )
    )
    return replace(table, columns=columns)


def without_far_stamps(table: Table, findings: list[Finding]) -> Table:
    """The table without the few rows whose stamp is hours away from all the others.

    A recorder writes them before its clock is set. Many rows far away are a real gap and stay.
    """
    stamps = table["stamp_s"]
    if len(stamps) < 4:
        return table
    low, middle, high = np.percentile(stamps, [25, 50, 75])
    far = np.abs(stamps - middle) > _FAR_S + _FAR_SPANS * (high - low)
    count = int(np.count_nonzero(far))
    if not count or count > max(_FAR_ROWS_MAX, _FAR_SHARE_MAX * len(stamps)):
        return table
    row = int(np.flatnonzero(far)[0])
    kept = stamps[~far]
    findings.append(
        Finding(
            "stamp_far_from_rest",
            "warning",
            table.path.name,
            f"line {table.lines[row]} has stamp_s {stamps[row]:.3f} ({count} such rows)",
            f"{kept.min():.3f} to {kept.max():.3f} as in the other {len(kept)} rows",
            "left out; delete the rows that were written before the clock was set",
        )
    )
    return table.keep(~far, "stamp_far_from_rest")


def in_order(table: Table, findings: list[Finding], *, duplicates: str) -> Table:
    """The table with `stamp_s` in seconds and rising; see `tables.sorted_by_stamp`.

    Raises:
        InputError: stamps that fall, or equal ones where that is an error.
    """
    timed = without_far_stamps(in_seconds(table, findings), findings)
    return sorted_by_stamp(timed, duplicates=duplicates)
