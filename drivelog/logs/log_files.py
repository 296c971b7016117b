"""A log on disk: a text table, or fixes of NMEA and GPX; both give columns by name or number."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.errors import InputError
from polemap.drivelog.logs.column_parts import Column
from polemap.drivelog.logs.format_part import FormatPart
from polemap.drivelog.logs.layout import Layout, find_layout
from polemap.drivelog.logs.table import Columns, Parser, Values, read_columns, text_parser
from polemap.drivelog.logs.units import unit_in_header, unit_named, units_for
from polemap.drivelog.problems import did_you_mean

Floats = NDArray[np.float64]
Wanted = Mapping[str, tuple[tuple[int, ...], Parser]]


class LogFile(Protocol):
    """What every kind of log can do."""

    @property
    def path(self) -> Path:
        """The file."""

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the columns; empty where they have none."""

    @property
    def says(self) -> str:
        """How the file was read, for the summary."""

    def index(self, column: Column) -> int:
        """Number, from 0, of a column.

        Raises:
            InputError: there is no such column, or several.
        """

    def unit(self, index: int, ours: str) -> str | None:
        """The unit that the log states for what is to be our column; None if it does not."""

    def samples(self, index: int) -> list[str]:
        """First cells of a column that hold something."""

    def read(self, wanted: Wanted) -> Columns:
        """Values of columns, by key."""


@dataclass(frozen=True, slots=True)
class CsvLog:
    """A text table."""

    path: Path
    layout: Layout

    @property
    def names(self) -> tuple[str, ...]:
        return self.layout.columns

    @property
    def says(self) -> str:
        return self.layout.says

    def index(self, column: Column) -> int:
        if isinstance(column, int):
            if 1 <= column <= self.layout.width:
                return column - 1
            raise InputError(f"no column {column}; {self.path.name} has {self.layout.width}")
        if not self.names:
            raise InputError(
                f"no column '{column}': {self.path.name} has no header; give its number, 1 to "
                f"{self.layout.width}"
            )
        found = [i for i, name in enumerate(self.names) if name == column.strip()]
        if len(found) == 1:
            return found[0]
        if found:
            numbers = " and ".join(str(i + 1) for i in found)
            raise InputError(
                f"'{column}' stands twice in {self.path.name}, in columns {numbers}; give the "
                "number"
            )
        shown = ", ".join(name[:20] for name in self.names[:12])
        more = f" and {len(self.names) - 12} more" if len(self.names) > 12 else ""
        raise InputError(
            f"no column '{column}' in {self.path.name} ({shown}{more})"
            f"{did_you_mean(column, self.names)}"
        )

    def unit(self, index: int, ours: str) -> str | None:
        if self.layout.units:
            unit = unit_named(self.layout.units[index]) if index < len(self.layout.units) else None
            return unit if unit in units_for(ours) else None
        return unit_in_header(self.names[index], ours) if self.names else None

    def samples(self, index: int) -> list[str]:
        cells = [row[index] for row in self.layout.rows if index < len(row)]
        return [cell for cell in cells if cell.lower() not in self.layout.missing]

    def read(self, wanted: Wanted) -> Columns:
        return read_columns(self.path, self.layout, wanted)


@dataclass(frozen=True, slots=True)
class PointLog:
    """Fixes that have been read as a whole: columns `(n,)` named with our units."""

    path: Path
    says: str
    columns: Mapping[str, Floats]
    lines: NDArray[np.int64]
    rows_read: int
    dropped: Mapping[str, int]

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(self.columns)

    def index(self, column: Column) -> int:
        if isinstance(column, int) and 1 <= column <= len(self.names):
            return column - 1
        if column in self.names:
            return self.names.index(str(column))
        raise InputError(
            f"no column '{column}' in {self.path.name} ({', '.join(self.names)})"
            f"{did_you_mean(str(column), self.names)}"
        )

    def unit(self, index: int, ours: str) -> str | None:
        return unit_in_header(self.names[index], ours)

    def samples(self, index: int) -> list[str]:
        values = self.columns[self.names[index]][:20]
        return [repr(float(value)) for value in values if np.isfinite(value)]

    def read(self, wanted: Wanted) -> Columns:
        values: dict[str, Values] = {}
        lines = [int(line) for line in self.lines]
        for key, (index, parse) in wanted.items():
            column = self.columns[self.names[index[0]]]
            # these are numbers already, but for what looks for single values among them
            is_text = parse is text_parser
            values[key] = column if is_text else parse([[repr(v) for v in column.tolist()]], lines)
        return Columns(values, self.lines, self.rows_read, Counter(self.dropped))


def open_csv(path: Path, part: FormatPart) -> CsvLog:
    """A text table with its layout.

    Raises:
        InputError: see `find_layout`.
    """
    return CsvLog(path, find_layout(path, part))
