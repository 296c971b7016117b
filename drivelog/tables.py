"""CSV files with a header, read into columns; what is wrong is named by file, line and value."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.errors import InputError
from polemap.parsing.csv_text import check_csv
from polemap.parsing.errors import named

if TYPE_CHECKING:
    import pandas as pd

Floats = NDArray[np.float64]

# far beyond what any drive or map can hold, and far below where squares overflow
_LARGEST = (
    ("_mps", 1e5),
    ("_radps", 1e5),
    ("_m2", 1e16),
    ("_m", 1e9),
    ("_rad", 1e6),
    ("_deg", 1e9),
    ("_px", 1e6),
    # nanoseconds since 1970 are converted later
    ("_s", 1e20),
)
_LARGEST_ELSE = 1e18
_MARKS = {";": "semicolons", "\t": "tabs", "|": "bars", " ": "blanks"}


@dataclass(frozen=True, slots=True)
class Table:
    """Columns of one CSV file.

    Attributes:
        columns: numbers, `(n,)` each.
        texts: text columns, `(n,)` each.
        lines: `(n,)` line of the file that each row stands on.
        dropped: rows that were left out, by kind.
    """

    path: Path
    columns: Mapping[str, Floats]
    texts: Mapping[str, NDArray[np.object_]]
    lines: NDArray[np.int64]
    dropped: Mapping[str, int]

    def __len__(self) -> int:
        return len(self.lines)

    def __getitem__(self, name: str) -> Floats:
        return self.columns[name]

    def __contains__(self, name: str) -> bool:
        return name in self.columns

    def keep(self, rows: NDArray[np.bool_], reason: str) -> Table:
        """Only some rows; the others are counted under `reason`."""
        lost = int(np.count_nonzero(~rows))
        if not lost:
            return self
        return Table(
            self.path,
            {name: values[rows] for name, values in self.columns.items()},
            {name: values[rows] for name, values in self.texts.items()},
            self.lines[rows],
            {**self.dropped, reason: self.dropped.get(reason, 0) + lost},
        )


def read_table(
    path: Path,
    required: Sequence[str],
    *,
    optional: Sequence[str] = (),
    texts: Sequence[str] = (),
    optional_texts: Sequence[str] = (),
    drop_not_finite: bool = True,
) -> Table:
    """Read a CSV file with a header, UTF-8; unknown columns are left aside.

    Args:
        path: the file.
        required: number columns that must be there.
        optional: number columns that may be there; an empty cell is NaN.
        texts: text columns that must be there.
        optional_texts: text columns that may be there.
        drop_not_finite: leave rows out (and count them) in which a required number is missing or
            not finite; otherwise such a row is an error.

    Raises:
        InputError: an unreadable file, a missing column, a cell that is no number.
    """
    with named(path, InputError, "table"):
        check_csv(path)
    raw = _read_text(path)
    if _separator(list(raw.columns)) == "" or set(required) <= set(raw.columns):
        _check_width(path, len(raw.columns))
    _check_names(path, list(raw.columns), (*required, *texts))
    lines = np.arange(len(raw), dtype=np.int64) + 2
    filled = (raw != "").any(axis=1).to_numpy() if len(raw) else np.zeros(0, dtype=bool)
    raw, lines = raw[filled], lines[filled]
    present = [*required, *(name for name in optional if name in raw.columns)]
    told = [*texts, *(name for name in optional_texts if name in raw.columns)]
    table = Table(
        path,
        {name: _numbers(raw[name].to_numpy(dtype=object), path, name, lines) for name in present},
        {name: raw[name].to_numpy(dtype=object) for name in told},
        lines,
        {},
    )
    sane = np.ones(len(table), dtype=bool)
    for name in present:
        wild = np.abs(table[name]) > largest(name)
        sane &= ~(wild & np.isfinite(table[name]))
    if not drop_not_finite and not sane.all():
        row = int(np.flatnonzero(~sane)[0])
        name = next(n for n in present if abs(table[n][row]) > largest(n))
        raise InputError(
            f"{path}, line {table.lines[row]}: {name} is {table[name][row]:g}, beyond the "
            f"{largest(name):g} that such a value may have"
        )
    table = table.keep(sane, "out_of_range")
    finite = np.ones(len(table), dtype=bool)
    for name in required:
        finite &= np.isfinite(table[name])
    if not drop_not_finite and not finite.all():
        row = int(np.flatnonzero(~finite)[0])
        name = next(name for name in required if not np.isfinite(table[name][row]))
        raise InputError(
            f"{path}, line {table.lines[row]}: {name} is {table[name][row]}, not a number"
        )
    return table.keep(finite, "not_finite")


def largest(name: str) -> float:
    """What a value in a column may be at most, by the unit that its name ends in."""
    return next((value for unit, value in _LARGEST if name.endswith(unit)), _LARGEST_ELSE)


def _read_text(path: Path, rows: int | None = None) -> pd.DataFrame:
    import pandas as pd  # slow to import, and many commands read no table

    try:
        with warnings.catch_warnings():
            # rows longer than the header are refused, by line, in `_check_width`
            warnings.simplefilter("ignore", pd.errors.ParserWarning)
            table = pd.read_csv(
                path, dtype=str, keep_default_na=False, skip_blank_lines=False,
                encoding="utf-8-sig", skipinitialspace=True, na_filter=False, index_col=False,
                nrows=rows,
            )  # fmt: skip
        return table.rename(columns=lambda name: str(name).strip())
    except pd.errors.EmptyDataError as error:
        raise InputError(f"{path}: empty file, a header line is needed") from error
    except (ValueError, UnicodeError, OverflowError) as error:
        detail = str(error).strip().splitlines()[-1]
        raise InputError(f"{path}: not a UTF-8 CSV file ({detail[:120]})") from error
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from error


def check_header(path: Path, required: Sequence[str]) -> None:
    """Look for columns in a file's header, and at nothing else.

    Raises:
        InputError: an unreadable file, or missing columns.
    """
    with named(path, InputError, "table"):
        check_csv(path)
    _check_names(path, list(_read_text(path, rows=0).columns), required)


def _check_names(path: Path, found: Sequence[str], required: Sequence[str]) -> None:
    missing = [name for name in required if name not in found]
    if not missing:
        return
    what = f"column '{missing[0]}' is missing"
    if len(missing) > 1:
        what = "columns " + ", ".join(f"'{name}'" for name in missing) + " are missing"
    shown = ", ".join(name[:30] for name in found[:20])
    raise InputError(f"{path}: {what} (found: {shown}){_separator(found)}")


def _separator(columns: Sequence[str]) -> str:
    """What to do about a header that is one cell: other marks than commas, or a comment."""
    header = str(columns[0]) if len(columns) == 1 else ""
    if header.startswith("#"):
        return "; delete the comment, the header comes first"
    mark = next((mark for mark in _MARKS if mark in header), None)
    if mark is None:
        return ""
    return (
        f"; its columns are separated by {_MARKS[mark]}: separate columns by commas and write "
        "decimals with a point, as `polemap convert` does"
    )


def _check_width(path: Path, width: int) -> None:
    """Rows longer than the header lose cells in silence: a decimal comma makes two of one.

    Raises:
        InputError: the first such row.
    """
    with path.open("rb") as file:
        for number, line in enumerate(file, start=1):
            if line.count(b",") < width or b'"' in line:
                continue
            # empty cells at the end hold nothing that could be lost
            if line.rstrip(b",\r\n ").count(b",") >= width:
                raise InputError(
                    f"{path}, line {number}: {line.count(b',') + 1} cells under {width} columns; "
                    "write decimals with a point, not a comma"
                )


def _numbers(cells: NDArray[np.object_], path: Path, name: str, lines: NDArray[np.int64]) -> Floats:
    try:
        return np.asarray(cells, dtype=np.float64)
    except (TypeError, ValueError):
        pass
    values = np.full(len(cells), np.nan)
    for row, cell in enumerate(cells):
        text = "" if cell is None or cell != cell else str(cell).strip()
        if text == "":
            continue
        try:
            values[row] = float(text)
        except ValueError:
            raise InputError(
                f"{path}, line {lines[row]}: {name} is '{text[:40]}', not a number"
            ) from None
    return values


def sorted_by_stamp(table: Table, *, duplicates: str) -> Table:
    """Check that `stamp_s` rises.

    Args:
        table: with the column `stamp_s`.
        duplicates: `error`, `drop` (the first row of a stamp stays, the rest are counted) or
            `allow` (several rows a stamp are meant).

    Raises:
        InputError: a stamp that is smaller than the one before, or equal where that is an error.
    """
    stamps = table["stamp_s"]
    step = np.diff(stamps)
    back = np.flatnonzero(step < 0)
    if len(back):
        row = int(back[0]) + 1
        raise InputError(
            f"{table.path}, line {table.lines[row]}: stamp_s {stamps[row]:.6f} after "
            f"{stamps[row - 1]:.6f}; sort the rows by stamp_s, or delete a row without a clock"
        )
    equal = np.flatnonzero(step == 0)
    if not len(equal) or duplicates == "allow":
        return table
    if duplicates == "error":
        row = int(equal[0]) + 1
        raise InputError(
            f"{table.path}, line {table.lines[row]}: stamp_s {stamps[row]:.6f} stands twice; "
            "keep one row a stamp"
        )
    return table.keep(np.concatenate([[True], step > 0]), "duplicate_stamps")
