"""Rows of our streams from logs, in the order of their stamps; what is left out is counted."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.errors import InputError
from polemap.drivelog.frames import EarthFrame, grid_from_geographic, grid_yaw
from polemap.drivelog.logs.column_parts import Stamps, Value
from polemap.drivelog.logs.columns import Wanted, membership, stamps_wanted, values_of
from polemap.drivelog.logs.log_files import LogFile
from polemap.drivelog.logs.mapping import HEADINGS, SIGNALS, STREAMS, TEXTS, StreamPart
from polemap.drivelog.logs.table import Values
from polemap.drivelog.logs.times import leap_seconds_on
from polemap.drivelog.problems import Gathered
from polemap.vehicle.pose import rotate, wrap_angle

Floats = NDArray[np.float64]

# rows of several senders may come a little out of order; a clock that is set back is another thing
_BACK_MOST_S = 1.0
_POSITIONS = (("latitude_deg", "longitude_deg"), ("east_m", "north_m"))


@dataclass(slots=True)
class Rows:
    """Rows of a stream, and what became of the rest.

    Attributes:
        columns: by our names, `(n,)` each; `stamp_s` among them.
        rows_read: in the logs.
        dropped: rows left out, by reason.
        notes: what a reader of the result must know.
    """

    columns: dict[str, Values]
    rows_read: int = 0
    dropped: Counter[str] = field(default_factory=Counter)
    notes: list[str] = field(default_factory=list)

    def numbers(self, name: str) -> Floats:
        """A column of numbers."""
        return np.asarray(self.columns[name], dtype=np.float64)

    def keep(self, rows: NDArray[np.bool_], reason: str) -> None:
        """Leave the other rows out, counted under a reason."""
        lost = int(np.count_nonzero(~rows))
        if lost:
            self.dropped[reason] += lost
            self.columns = {name: values[rows] for name, values in self.columns.items()}


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


def held_or_linear(
    at_s: Floats,
    stamps_s: Floats,
    values: Floats,
    how: str,
    most_s: float,
    *,
    is_angle: bool = False,
) -> Floats:
    """Values `(n,)` at stamps `(n,)` from samples `(m,)`; NaN where they are too far away.

    Args:
        at_s: where values are asked for.
        stamps_s, values: the samples, stamps rising.
        how: `linear` between two samples, or `previous`.
        most_s: the two samples may be apart by this; the previous one may be as old.
        is_angle: radians, the short way around.
    """
    if not len(stamps_s):
        return np.full(len(at_s), np.nan)
    after = np.searchsorted(stamps_s, at_s, side="left")
    exact = (after < len(stamps_s)) & (stamps_s[np.minimum(after, len(stamps_s) - 1)] == at_s)
    before = np.where(exact, after, after - 1)
    inside = before >= 0
    low = np.maximum(before, 0)
    if how == "previous":
        return np.where(inside & (at_s - stamps_s[low] <= most_s), values[low], np.nan)
    high = np.minimum(np.where(exact, low, low + 1), len(stamps_s) - 1)
    near = inside & (
        exact | ((before + 1 < len(stamps_s)) & (stamps_s[high] - stamps_s[low] <= most_s))
    )
    smooth = np.unwrap(values) if is_angle else values
    found = np.interp(at_s, stamps_s, smooth)
    return np.where(near, wrap_angle(found) if is_angle else found, np.nan)


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


def place_reference(part: StreamPart, rows: Rows, frame: EarthFrame) -> None:
    """Turn a reference's positions and headings into poses of the rear axle in the frame.

    Raises:
        InputError: degrees or geographic headings where the frame is local.
    """
    if "latitude_deg" in rows.columns:
        _require_utm(part, frame, "latitudes and longitudes")
        points = grid_from_geographic(
            frame, rows.numbers("latitude_deg"), rows.numbers("longitude_deg")
        )
        del rows.columns["latitude_deg"], rows.columns["longitude_deg"]
    else:
        points = np.stack([rows.numbers("east_m"), rows.numbers("north_m")], axis=1)
    yaw = headings(part, "yaw_rad", rows.numbers("yaw_rad"), frame, points)
    if part.measured_at is not None:
        lever = np.array([part.measured_at.x_m, part.measured_at.y_m])
        points = points - rotate(np.broadcast_to(lever, points.shape), yaw)
    rows.columns |= {"east_m": points[:, 0], "north_m": points[:, 1], "yaw_rad": yaw}


def headings(
    part: StreamPart,
    name: str,
    angles_rad: Floats,
    frame: EarthFrame | None,
    points_m: Floats | None,
) -> Floats:
    """Yaws counter-clockwise from grid east of headings `(n,)` as the mapping says they count.

    Raises:
        InputError: geographic north where the frame is local.
    """
    value = part.values.get(name)
    if value is None or value.zero is None:
        return np.asarray(wrap_angle(angles_rad))
    sign = -1.0 if value.turn == "clockwise" else 1.0
    yaw = sign * angles_rad + (np.pi / 2.0 if value.zero.endswith("north") else 0.0)
    if value.zero.startswith("true") and frame is not None and points_m is not None:
        _require_utm(part, frame, "headings from geographic north or east")
        yaw = grid_yaw(frame, yaw, points_m)
    return np.asarray(wrap_angle(yaw))


def _require_utm(part: StreamPart, frame: EarthFrame, what: str) -> None:
    if not frame.is_utm:
        raise InputError(
            f"{part.name}: {what} need a UTM frame, and this is {frame}; give `frame: {{kind: utm, "
            "epsg: ...}` in `drive`, or grid_north and metres"
        )
