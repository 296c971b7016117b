"""Columns of a text log, block by block, so that long logs need little memory.

Each wanted column is parsed by a function of its own; lines that are no rows are counted by kind.
"""

from __future__ import annotations

import csv
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import IO

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.errors import InputError
from polemap.drivelog.logs.layout import Layout
from polemap.drivelog.logs.text import lines_of, open_text
from polemap.parsing.csv_text import LONGEST_CELL
from polemap.parsing.errors import short

Floats = NDArray[np.float64]
Values = NDArray[np.float64] | NDArray[np.object_]
Cells = Sequence[Sequence[str]]
Numbers = Callable[[Cells, Sequence[int]], Floats]
Parser = Callable[[Cells, Sequence[int]], Values]
"""Cells of one or more columns, and the numbers of their lines, to values; an `InputError` that it
raises begins with the line, not with the file."""

_BLOCK_ROWS = 50_000


@dataclass(frozen=True, slots=True)
class Columns:
    """Values of the wanted columns `(n,)` by key, and the line that each row stands on."""

    values: Mapping[str, Values]
    lines: NDArray[np.int64]
    rows_read: int
    dropped: Counter[str]


def number_parser(layout: Layout, name: str) -> Numbers:
    """Numbers as the log writes them; cells without a value are NaN."""

    def parse(columns: Cells, lines: Sequence[int]) -> Floats:
        (cells,) = columns
        if layout.thousands:
            cells = [cell.replace(layout.thousands, "") for cell in cells]
        if layout.decimal != ".":
            cells = [cell.replace(layout.decimal, ".") for cell in cells]
        if "_" not in "".join(cells):  # Python takes 1_000 for a number
            try:
                return np.fromiter(map(float, cells), np.float64, len(cells))
            except ValueError:
                pass
        values = np.full(len(cells), np.nan)
        for row, cell in enumerate(cells):
            text = cell.strip()
            if text.lower() in layout.missing:
                continue
            try:
                values[row] = float(text if "_" not in text else "")
            except ValueError:
                raise InputError(
                    f"line {lines[row]}: {name} is '{text[:40]}', not a number; if it stands for "
                    f"no value add to the mapping `format: {{missing: ['{text[:40]}']}}`"
                ) from None
        return values

    return parse


def text_parser(columns: Cells, _lines: Sequence[int]) -> NDArray[np.object_]:
    """Cells as they are, without blanks around them."""
    (cells,) = columns
    values = np.empty(len(cells), dtype=object)
    values[:] = [cell.strip() for cell in cells]
    return values


def read_columns(
    path: Path, layout: Layout, wanted: Mapping[str, tuple[tuple[int, ...], Parser]]
) -> Columns:
    """The wanted columns of a log.

    Args:
        path: the log.
        layout: as `find_layout` found it.
        wanted: by key, the numbers of columns (from 0) and what parses them together.

    Raises:
        InputError: a line of another width, or a cell that a parser refuses, by file and line.
    """
    dropped: Counter[str] = Counter()
    parts: dict[str, list[Values]] = {key: [] for key in wanted}
    numbers: list[NDArray[np.int64]] = []
    with open_text(path, layout.encoding) as file:
        rows = _rows(path, file, layout, dropped)
        while block := list(islice(rows, _BLOCK_ROWS)):
            lines = [number for number, _ in block]
            numbers.append(np.array(lines, dtype=np.int64))
            for key, (columns, parse) in wanted.items():
                cells = [[row[column] for _, row in block] for column in columns]
                try:
                    parts[key].append(parse(cells, lines))
                except InputError as error:
                    raise InputError(f"{path}, {error}") from error
    count = sum(map(len, numbers))
    return Columns(
        {key: _joined(part) for key, part in parts.items()},
        np.concatenate(numbers) if numbers else np.empty(0, dtype=np.int64),
        count + sum(dropped.values()),
        dropped,
    )


def _joined(parts: list[Values]) -> Values:
    if not parts:
        return np.empty(0)
    if parts[0].dtype == np.object_:
        return np.concatenate([np.asarray(part, dtype=np.object_) for part in parts])
    return np.concatenate([np.asarray(part, dtype=np.float64) for part in parts])


def _rows(
    path: Path, file: IO[str], layout: Layout, dropped: Counter[str]
) -> Iterator[tuple[int, list[str]]]:
    """Rows of data with the numbers of their lines."""
    bad: tuple[int, int] | None = None
    for number, cells in _cells(path, file, layout):
        if number < layout.first_line or number in layout.skip_lines:
            continue
        if not cells or (len(cells) == 1 and not cells[0].strip()):
            continue
        if cells[0].lstrip().startswith(layout.comments):
            continue
        if bad is not None:
            _refuse_width(path, bad, layout, dropped)
            bad = None
        width = len(cells)
        if width != layout.width and (
            width < layout.width or "".join(cells[layout.width :]).strip()
        ):
            bad = number, width  # refused if it is not the last one: a logger was switched off
            continue
        if layout.columns and cells[0].strip() == layout.columns[0] and _is_header(cells, layout):
            dropped["repeated headers"] += 1
            continue
        yield number, cells
    if bad is not None and bad[1] < layout.width:
        dropped["last line cut off"] += 1
    elif bad is not None:
        _refuse_width(path, bad, layout, dropped)


def _is_header(cells: Sequence[str], layout: Layout) -> bool:
    return [cell.strip() for cell in cells[: layout.width]] == list(layout.columns)


def _cells(path: Path, file: IO[str], layout: Layout) -> Iterator[tuple[int, list[str]]]:
    if layout.separator == " ":
        for number, line in enumerate(lines_of(file), start=1):
            yield number, line.split()
        return
    csv.field_size_limit(LONGEST_CELL)
    reader = csv.reader(lines_of(file), delimiter=layout.separator, skipinitialspace=True)
    last = 0
    while True:
        try:
            cells = next(reader)
        except StopIteration:
            return
        except csv.Error as error:
            raise InputError(
                f"{path}, line {last + 1}: no cells ({short(error)}); a quote that is never closed?"
            ) from error
        yield last + 1, cells
        last = reader.line_num


def _refuse_width(path: Path, bad: tuple[int, int], layout: Layout, dropped: Counter[str]) -> None:
    """Count a line of another width, or refuse it.

    Raises:
        InputError: the mapping does not say that such lines are left out.
    """
    line, width = bad
    if not layout.drop_bad_lines:
        raise InputError(
            f"{path}, line {line}: {width} cells under {layout.width} columns; mend the line, or "
            "add to the mapping `format: {bad_lines: drop}`"
        )
    dropped["lines of another width"] += 1
