"""One of our columns from a log: its clock, unit, sign, and the rows that are meant."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.errors import InputError
from polemap.drivelog.logs.column_parts import Stamps, Value, Where
from polemap.drivelog.logs.log_files import CsvLog, LogFile
from polemap.drivelog.logs.mapping import TEXTS
from polemap.drivelog.logs.marks import is_number
from polemap.drivelog.logs.table import Cells, Numbers, Parser, Values, number_parser, text_parser
from polemap.drivelog.logs.times import gps_stamps, number_unit, text_reader
from polemap.drivelog.logs.units import DEGREES_AND_MINUTES, factor, units_for

Floats = NDArray[np.float64]
Wanted = dict[str, tuple[tuple[int, ...], Parser]]


def stamps_wanted(log: LogFile, stamps: Stamps) -> tuple[tuple[int, ...], Parser]:
    """Columns and parser of a stream's stamps.

    Raises:
        InputError: a column that is not there, or a unit, zone or format that is not said.
    """
    names = stamps.columns or ((stamps.column,) if stamps.column is not None else ())
    indices = tuple(log.index(name) for name in names)
    layout = log.layout if isinstance(log, CsvLog) else None
    if layout is None:
        return indices, text_parser
    samples = _joined_samples(log, indices)
    number = number_parser(layout, "the stamp")
    numbers = [s for s in samples if is_number(s, layout.decimal)]
    # a word among numbers is a cell to be told of, not a time of day
    numeric = 2 * len(numbers) > len(samples)
    if len(indices) == 1 and stamps.format is None and (numeric or not samples):
        size = number_unit(
            stamps,
            log.unit(indices[0], "stamp_s"),
            np.asarray(number([numbers], range(len(numbers))), dtype=np.float64),
        )
        if not stamps.uses_gps:
            return indices, lambda cells, lines: number(cells, lines) * size + stamps.offset
        if stamps.week is None:
            return (
                indices,
                lambda cells, lines: (
                    gps_stamps(number(cells, lines) * size, None, stamps.leap_seconds or 0)
                    + stamps.offset
                ),
            )
        week = number_parser(layout, "the GPS week")
        return (
            (*indices, log.index(stamps.week)),
            lambda cells, lines: (
                gps_stamps(
                    number(cells[:1], lines) * size,
                    week(cells[1:], lines),
                    stamps.leap_seconds or 0,
                )
                + stamps.offset
            ),
        )
    if not samples:
        return indices, lambda cells, lines: np.full(len(cells[0]), np.nan)
    read = text_reader(stamps, samples, layout.missing)
    return (
        indices,
        lambda cells, lines: (
            read([" ".join(c.strip() for c in row) for row in zip(*cells, strict=True)], lines)
            + stamps.offset
        ),
    )


def _joined_samples(log: LogFile, indices: Sequence[int]) -> list[str]:
    columns = [log.samples(index) for index in indices]
    return [" ".join(row) for row in zip(*columns, strict=False)]


def membership(log: LogFile, where: Where) -> tuple[tuple[int, ...], Parser]:
    """Column and parser that give 1 for the rows that `where` means.

    Raises:
        InputError: the column is not there.
    """
    index = log.index(where.column)
    wanted = {_plain(value) for value in where.values}

    def among(cells: Cells, _lines: Sequence[int]) -> Floats:
        return np.array([float(_plain(cell) in wanted) for cell in cells[0]])

    if where.values:
        return (index,), among
    number: Numbers = lambda cells, _lines: np.array([float(cell) for cell in cells[0]])  # noqa: E731
    if isinstance(log, CsvLog):
        number = number_parser(log.layout, str(where.column))

    def between(cells: Cells, lines: Sequence[int]) -> Floats:
        values = number(cells, lines)
        low = -np.inf if where.least is None else where.least
        high = np.inf if where.most is None else where.most
        return ((values >= low) & (values <= high)).astype(np.float64)

    return (index,), between


def _plain(value: object) -> str:
    """4, 4.0 and `4` are the same."""
    text = str(value).strip().lower()
    try:
        return repr(float(text))
    except ValueError:
        return text


def unit_factor(log: LogFile, index: int, name: str, value: Value, notes: list[str]) -> float:
    """What takes a cell to the unit of our column.

    Raises:
        InputError: neither mapping nor log say the unit.
    """
    units = units_for(name)
    stated = log.unit(index, name)
    if value.scale is not None and value.unit is None:
        return value.scale
    unit = value.unit or stated
    if not units:
        return 1.0
    if unit is None:
        shown = log.names[index] if log.names else str(index + 1)
        raise InputError(
            f"the unit of column '{shown}' is not said (first values "
            f"{', '.join(log.samples(index)[:3])}); add `unit:` {' or '.join(units)}"
        )
    if stated is not None and stated != unit:
        notes.append(f"{name}: the log says {stated}, the mapping's {unit} is taken")
    size = factor(name, unit)
    assert size is not None  # the mapping was checked
    return size * (1.0 if value.scale is None else value.scale)


def values_of(
    log: LogFile, name: str, value: Value, wanted: Wanted, notes: list[str]
) -> Callable[[Mapping[str, Values]], Values]:
    """Add what a column needs to `wanted`, and give what makes our column of it.

    Raises:
        InputError: a column or a unit that is missing.
    """
    if name in TEXTS:
        assert value.column is not None
        wanted[name] = ((log.index(value.column),), text_parser)
        return lambda read: read[name]
    sizes = []
    for number, column in enumerate(value.sources):
        index = log.index(column)
        sizes.append(unit_factor(log, index, name, value, notes))
        parse = number_parser(log.layout, name) if isinstance(log, CsvLog) else text_parser
        wanted[f"{name} {number}"] = ((index,), parse)
    if value.negative_where is not None:
        wanted[f"{name} negative"] = membership(log, value.negative_where)
    minutes = value.unit == DEGREES_AND_MINUTES
    sign = float(value.sign) * (-1.0 if value.turn == "clockwise" and not value.zero else 1.0)

    def make(read: Mapping[str, Values]) -> Values:
        parts = []
        for number, size in enumerate(sizes):
            cells = np.asarray(read[f"{name} {number}"], dtype=np.float64)
            parts.append((_degrees(cells) if minutes else cells) * size)
        mean = np.mean(parts, axis=0) if len(parts) > 1 else parts[0]
        if value.negative_where is not None:
            negative = np.asarray(read[f"{name} negative"], dtype=np.float64)
            mean = np.where(negative > 0.0, -np.abs(mean), mean)
        return np.asarray(sign * mean + value.offset)

    return make


def _degrees(cells: Floats) -> Floats:
    whole = np.trunc(cells / 100.0)
    return np.asarray(whole + (cells - 100.0 * whole) / 60.0)
