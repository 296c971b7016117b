"""Timestamps of KITTI raw drives: one line a file, with blank lines and gaps."""

from __future__ import annotations

from collections import Counter
from datetime import UTC, datetime
from itertools import pairwise
from pathlib import Path

import numpy as np

from polemap.drivelog.errors import InputError
from polemap.drivelog.readers.kitti import read_text


def read_timestamps(
    path: Path, problems: Counter[str], *, leave_out: str | None = None
) -> dict[int, float]:
    """Seconds since 1970 (the recording's clock read as UTC) by number of the file.

    A blank line can stand for a file without a time or be mere dirt. The clock tells: where it
    jumps by two periods over the blank line, a file was skipped.

    Args:
        path: the file.
        problems: counts what was left out.
        leave_out: kind of problem under which times that run back are left out, as those of the
            OXTS unit do here and there in drives that are not synchronised; None to refuse them.

    Raises:
        InputError: unreadable, no time in it, or a time that does not follow the one before.
    """
    entries: list[float | None] = []
    for number, line in enumerate(read_text(path).splitlines(), start=1):
        entries.append(_seconds(line.strip(), path, number) if line.strip() else None)
    while entries and entries[-1] is None:
        entries.pop()
    if not entries:
        raise InputError(f"{path}: holds no times")
    if None in entries:
        problems["blank_timestamp_lines"] += entries.count(None)
    times: dict[int, float] = {}
    period = _period(entries)
    file, blank, last = 0, 0, -np.inf
    for row, value in enumerate(entries, start=1):
        if value is None:
            blank += 1
            continue
        if value <= last and leave_out is not None:
            problems[leave_out] += 1
            file += 1
            continue
        if value <= last:
            raise InputError(f"{path}, line {row}: time does not follow the one before it")
        if blank:
            skipped = round((value - last) / period) - 1 if np.isfinite(last) and period else blank
            file += int(np.clip(skipped, 0, blank))
            blank = 0
        times[file] = last = value
        file += 1
    return times


def _seconds(text: str, path: Path, line: int) -> float:
    whole, _, fraction = text.partition(".")
    try:
        moment = datetime.strptime(whole, "%Y-%m-%d %H:%M:%S").replace(tzinfo=UTC)
        nanoseconds = int(f"{fraction or '0':0<9}"[:9])
    except ValueError:
        raise InputError(
            f"{path}, line {line}: '{text[:40]}' is no time like 2011-09-26 13:02:25.967790592"
        ) from None
    return moment.timestamp() + nanoseconds * 1e-9


def _period(entries: list[float | None]) -> float:
    steps = [b - a for a, b in pairwise(entries) if a is not None and b is not None]
    return float(np.median(steps)) if steps else 0.0


def gap_note(what: str, numbers: list[int], expected: int, first: int = 0) -> str | None:
    """What is missing of the numbers first … expected - 1, in words, or None."""
    missing = sorted(set(range(first, expected)) - set(numbers))
    if not missing:
        return None
    runs: list[list[int]] = []
    for number in missing:
        if runs and number == runs[-1][1] + 1:
            runs[-1][1] = number
        else:
            runs.append([number, number])
    shown = ", ".join(f"{a}" if a == b else f"{a}-{b}" for a, b in runs[:4])
    more = " …" if len(runs) > 4 else ""
    return f"{what} missing in the recording: {shown}{more} ({len(missing)} of {expected - first})"
