"""Rows of our streams from logs, in the order of their stamps; what is left out is counted."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.errors import InputError
from polemap.drivelog.logs.column_parts import Stamps, Value
from polemap.drivelog.logs.columns import Wanted, membership, stamps_wanted, values_of
from polemap.drivelog.logs.log_files import LogFile
from polemap.drivelog.logs.mapping import HEADINGS, SIGNALS, STREAMS, TEXTS, StreamPart
from polemap.drivelog.logs.resampling import held_or_linear
from polemap.drivelog.logs.rows import Rows
from polemap.drivelog.logs.times import leap_seconds_on
from polemap.drivelog.problems import Gathered

Floats = NDArray[np.float64]

# rows of several senders may come a little out of order; a clock that is set back is another thing
_BACK_MOST_S = 1.0
_POSITIONS = (("latitude_deg", "longitude_deg"), ("east_m", "north_m"))


def read_stream(part: StreamPart, logs: Sequence[LogFile], others: Mapping[str, LogFile]) -> Rows:
    """Rows of a stream from one log or its parts, sorted by stamp, in our units.

    Args:
        part: what the mapping says.
        logs: the files that hold it, in order.
        others: logs of columns that have a file of their own, by column.

    Raises:
        InputError: a column, unit or zone that is missing (several as `Mistakes`), a cell that
            cannot be read, or a clock that is set back.
    """
    parts = [_read_log(part, log) for log in logs]
    rows = Rows(
        {n: np.concatenate([one.columns[n] for one in parts]) for n in parts[0].columns},
        sum(one.rows_read for one in parts),
        sum((one.dropped for one in parts), Counter()),
        list(dict.fromkeys(note for one in parts for note in one.notes)),
    )
    rows.keep(np.isfinite(rows.numbers("stamp_s")), "no stamp")
    _sort(part, rows)
    _check_leap_seconds(part.stamp_s, rows)
    for name, value in part.values.items():
        if _has_own_rows(value) or value.fill is not None:
            _fill(part, name, value, others.get(name, logs[0]), rows)
    _drop_incomplete(part, rows)
    if part.name != "poles":
        rising = np.diff(rows.numbers("stamp_s"), prepend=-np.inf) > 0.0
        rows.keep(np.asarray(rising), "repeated stamps")
    return rows


def _has_own_rows(value: Value) -> bool:
    return value.file is not None or value.stamp_s is not None or value.where is not None


def _read_log(part: StreamPart, log: LogFile) -> Rows:
    """The columns that stand in one file, as they come."""
    gathered = Gathered()
    wanted: Wanted = {}
    notes: list[str] = []
    given = _with_ours(part, log, notes)
    gathered.at(part.name, _check_complete, part, given)
    times = {"stamp_s": part.stamp_s or _our_stamps(log), **part.times}
    for key, stamps in times.items():
        found = gathered.at(f"{part.name}.{key}", stamps_wanted, log, stamps)
        if found is not None:
            wanted[key] = found
    if part.where is not None:
        chosen = gathered.at(f"{part.name}.where", membership, log, part.where)
        if chosen is not None:
            wanted["where"] = chosen
    makers = {
        name: gathered.at(f"{part.name}.{name}", values_of, log, name, value, wanted, notes)
        for name, value in given.items()
        if value.value is None and not _has_own_rows(value)
    }
    if gathered.errors:
        raise gathered.error(log.path)
    read = log.read(wanted)
    rows = Rows({key: read.values[key] for key in times}, read.rows_read, read.dropped, notes)
    for name, make in makers.items():
        assert make is not None  # refused above
        rows.columns[name] = make(read.values)
    for name, value in given.items():
        if value.value is not None:
            rows.columns[name] = np.full(len(read.lines), value.value)
    if part.where is not None:
        rows.keep(np.asarray(read.values["where"] == 1.0), "not meant by `where`")
    return rows


def _with_ours(part: StreamPart, log: LogFile, notes: list[str]) -> dict[str, Value]:
    """The columns of the mapping, and those that the log calls as we do."""
    given = dict(part.values)
    required, optional = STREAMS.get(part.name, ((), ()))
    positions = {column for pair in _POSITIONS for column in pair}
    whole = [pair for pair in _POSITIONS if set(pair) <= set(log.names)]
    if positions & set(given) or not whole or part.name == "poles":
        usable = set(log.names) - positions
    else:
        usable = set(log.names) - positions | set(whole[0])
    for name in (*required, *optional):
        if name in given or name not in usable or name.endswith("arrival_s"):
            continue
        given[name] = Value(column=name)
        notes.append(f"{name}: taken from the log's column of that name")
    return given


def _our_stamps(log: LogFile) -> Stamps:
    if "stamp_s" in log.names:
        return Stamps(column="stamp_s", unit="s")
    raise InputError(
        f"{log.path}: no stamps are mapped; add `stamp_s: {{column: NAME, unit: s}}` to the stream"
    )


def _check_complete(part: StreamPart, given: Mapping[str, Value]) -> None:
    required, _ = STREAMS.get(part.name, ((), ()))
    missing = [name for name in required if name not in given]
    has_pair = any(set(pair) <= set(given) for pair in _POSITIONS)
    if part.name in ("gnss", "reference") and not has_pair:
        missing.append("latitude_deg and longitude_deg (or east_m and north_m)")
    if missing:
        raise InputError(
            f"no column is mapped to {', '.join(missing)}; add a line such as "
            f"`{missing[0].partition(' ')[0]}: {{column: NAME, unit: UNIT}}`"
        )
    for name in HEADINGS:
        value = given.get(name)
        if value is None or value.value is not None or value.column == name:
            continue
        if value.turn is None or value.zero is None:
            raise InputError(
                f"{name} needs its convention; add `turn: clockwise, from: true_north` for a "
                "compass heading (or counter_clockwise, grid_north, true_east, grid_east)"
            )


def _sort(part: StreamPart, rows: Rows) -> None:
    """Rows in the order of their stamps.

    Raises:
        InputError: stamps that go back by more than senders that overtake each other do.
    """
    stamps = rows.numbers("stamp_s")
    step = np.diff(stamps)
    if not len(step) or step.min() >= 0.0:
        return
    worst = int(np.argmin(step))
    if step[worst] < -_BACK_MOST_S:
        raise InputError(
            f"{part.name}: stamps go back by {-step[worst]:.3f} s, from {stamps[worst]:.3f} to "
            f"{stamps[worst + 1]:.3f} s (row {worst + 2}); the clock was set, or a log begins "
            "anew: split the log there, and give its parts as files in their order"
        )
    order = np.argsort(stamps, kind="stable")
    rows.columns = {name: values[order] for name, values in rows.columns.items()}
    rows.notes.append(f"{int(np.count_nonzero(step < 0.0))} rows came out of order and were sorted")


def _check_leap_seconds(stamps: Stamps | None, rows: Rows) -> None:
    if stamps is None or not stamps.leap_seconds or not len(rows.columns["stamp_s"]):
        return
    known = leap_seconds_on(float(rows.numbers("stamp_s")[0]))
    if known is not None and known != stamps.leap_seconds:
        rows.notes.append(
            f"GPS time was ahead of UTC by {known} s then, the mapping's {stamps.leap_seconds} s "
            "are taken"
        )


def _fill(part: StreamPart, name: str, value: Value, log: LogFile, rows: Rows) -> None:
    """A column that is sampled at other stamps, at those of the stream."""
    if _has_own_rows(value):
        plain = value.model_copy(
            update={"file": None, "stamp_s": None, "where": None, "fill": None}
        )
        own = StreamPart(
            SIGNALS, stamp_s=value.stamp_s or part.stamp_s, where=value.where, values={name: plain}
        )
        source = _read_log(own, log)
        source.keep(np.isfinite(source.numbers("stamp_s")), "no stamp")
        _sort(part, source)
        rows.notes += source.notes
    else:
        source = Rows(dict(rows.columns))
    source.keep(np.isfinite(source.numbers(name)), "no value")
    rising = np.diff(source.numbers("stamp_s"), prepend=-np.inf) > 0.0
    source.keep(np.asarray(rising), "repeated stamps")
    how = value.fill or "linear"
    stamps = rows.numbers("stamp_s")
    rows.columns[name] = held_or_linear(
        stamps, source.numbers("stamp_s"), source.numbers(name), how, value.fill_max_s,
        is_angle=name in HEADINGS,
    )  # fmt: skip
    word = "between its neighbours" if how == "linear" else "from the sample before"
    rows.notes.append(
        f"{name}: {len(source.columns[name])} samples, at the other stamps {word} within "
        f"{value.fill_max_s:g} s"
    )


def _drop_incomplete(part: StreamPart, rows: Rows) -> None:
    """Rows without a value that the stream must have."""
    required, _ = STREAMS.get(part.name, ((), ()))
    names = [name for name in required if name not in TEXTS]
    if part.name in ("gnss", "reference"):
        names += [n for pair in _POSITIONS for n in pair if set(pair) <= set(rows.columns)]
    for name in names:
        rows.keep(np.isfinite(rows.numbers(name)), f"{name} not given")
    for name in required:
        if name in TEXTS:
            rows.keep(
                np.array([bool(t) for t in rows.columns[name]], dtype=bool), f"{name} not given"
            )
    if part.name == SIGNALS:
        filled = [np.isfinite(rows.numbers(n)) for n in rows.columns if n != "stamp_s"]
        if filled:
            rows.keep(np.any(filled, axis=0), "no signal given")
