"""A signal log in memory, and how it is played to an estimator."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from polemap.electric.estimators.base import (
    CAMERA,
    GPS,
    LATERAL_ACCELERATION,
    WHEEL_SPEED,
    YAW_RATE,
    Estimator,
    Inputs,
)
from polemap.vehicle.errors import VehicleError

Floats = NDArray[np.float64]

INPUT_COLUMNS = (
    "road_wheel_angle_rad",
    "yaw_rate_radps",
    "ax_mps2",
    "ay_mps2",
    "vx_mps",
    "yaw_moment_nm",
    "heading_rad",
    "lateral_offset_m",
    "road_curvature_per_m",
    "course_rad",
    "speed_mps",
    "camera_arrival_s",
    "gnss_arrival_s",
    "course_sd_rad",
    "speed_sd_mps",
    "hdop",
    "satellites",
    "course_baseline_m",
)
CAMERA_SPREAD_COLUMNS = (
    "heading_sd_rad",
    "lateral_offset_sd_m",
    "road_curvature_sd_per_m",
    "corr_heading_offset",
    "corr_heading_curvature",
    "corr_offset_curvature",
    "lane_width_m",
)
"""What `polemap lanes` states beside its values: no estimator's input, and no reference."""
GPS_SPREAD_COLUMNS = ("course_sd_rad", "speed_sd_mps")
"""Deviations of single fixes; with them a GPS value has four numbers."""
REFERENCE_COLUMNS = ("sideslip_rad", "vy_mps", "vx_reference_mps")
LATE = {
    CAMERA: ("heading_rad", "lateral_offset_m", "camera_arrival_s"),
    GPS: ("course_rad", "speed_mps", "gnss_arrival_s"),
}


@dataclass(frozen=True, slots=True)
class SignalLog:
    """Columns of one row a stamp; NaN where a signal was not sampled at it.

    Attributes:
        stamp_s: `(n,)`, growing.
        columns: each `(n,)`, by the names of the contract.
    """

    stamp_s: Floats
    columns: Mapping[str, Floats]

    def __post_init__(self) -> None:
        if len(self.stamp_s) < 2:
            raise VehicleError(f"a signal log needs two rows at least, not {len(self.stamp_s)}")
        if not np.isfinite(self.stamp_s).all():
            row = int(np.flatnonzero(~np.isfinite(self.stamp_s))[0])
            raise VehicleError(f"signal log: stamp_s of row {row} is not a number")
        steps = np.diff(self.stamp_s)
        if not (steps > 0.0).all():
            row = int(np.flatnonzero(steps <= 0.0)[0]) + 1
            raise VehicleError(
                f"signal log: stamp_s of row {row} ({self.stamp_s[row]}) does not follow "
                f"{self.stamp_s[row - 1]}; sort the rows and drop doubles"
            )
        for name, values in self.columns.items():
            if len(values) != len(self.stamp_s):
                raise VehicleError(f"signal log: {name} has {len(values)} rows")

    def __len__(self) -> int:
        return len(self.stamp_s)

    def has(self, name: str) -> bool:
        """Whether a column is there and holds a value."""
        return name in self.columns and bool(np.isfinite(self.columns[name]).any())

    def held(self, name: str, default: float = 0.0) -> Floats:
        """A column `(n,)` with gaps filled by the value before; `default` before the first."""
        if name not in self.columns:
            return np.full(len(self), default)
        values = self.columns[name]
        index = np.where(np.isfinite(values), np.arange(len(values)), -1)
        np.maximum.accumulate(index, out=index)
        return np.where(index >= 0, values[np.maximum(index, 0)], default)

    def between(self, start_s: float, end_s: float) -> SignalLog:
        """The rows from `start_s` up to, not including, `end_s`."""
        keep = (self.stamp_s >= start_s) & (self.stamp_s < end_s)
        return SignalLog(self.stamp_s[keep], {k: v[keep] for k, v in self.columns.items()})

    def kinds(self) -> set[str]:
        """Kinds of measurement that the log has."""
        found = {kind for kind, names in LATE.items() if all(self.has(n) for n in names[:2])}
        for kind, name in (
            (YAW_RATE, "yaw_rate_radps"),
            (LATERAL_ACCELERATION, "ay_mps2"),
            (WHEEL_SPEED, "vx_mps"),
        ):
            if self.has(name):
                found.add(kind)
        return found


@dataclass(frozen=True, slots=True)
class Played:
    """What an estimator said at the rows of a log: `mean`, `sd` `(n, k)` of its `fields`."""

    stamp_s: Floats
    fields: tuple[str, ...]
    mean: Floats
    sd: Floats

    def column(self, name: str) -> Floats:
        """One field `(n,)`."""
        return np.asarray(self.mean[:, self.fields.index(name)])

    def sd_of(self, name: str) -> Floats:
        """Its standard deviation `(n,)`."""
        return np.asarray(self.sd[:, self.fields.index(name)])


def play(
    estimator: Estimator,
    log: SignalLog,
    *,
    steering_offset_rad: float = 0.0,
    steering_scale: float = 1.0,
    steering_delay_s: float = 0.0,
    every: int = 1,
    observe: Callable[[int, Estimator], None] | None = None,
    progress: Callable[[int], None] | None = None,
) -> Played:
    """Drive an estimator through a log as time would: late values come when they arrive.

    Inputs of a row hold until the next. The speed is the wheels', or the GPS's where there are
    none. Of the output every `every`-th row is kept. `observe` is called at each row that is kept,
    `progress` with a number of further rows now and then.
    """
    n = len(log)
    stamps = log.stamp_s.tolist()
    # no wheel turns before its sensor shows it
    shown = shifted(log.stamp_s, log.held("road_wheel_angle_rad"), max(steering_delay_s, 0.0))
    steering = steering_scale * (shown - steering_offset_rad)
    speed_name = "vx_mps" if log.has("vx_mps") else "speed_mps"
    # _make builds a row's tuple without naming its fields: half the time on a long log
    inputs = list(
        map(
            Inputs._make,
            zip(
                steering.tolist(),
                log.held(speed_name).tolist(),
                log.held("yaw_moment_nm").tolist(),
                log.held("ax_mps2").tolist(),
                log.held("ay_mps2").tolist(),
                log.held("yaw_rate_radps").tolist(),
                arrived(log, "road_curvature_per_m", "camera_arrival_s").tolist(),
                strict=True,
            ),
        )
    )
    fast = [
        (kind, log.columns[name].tolist())
        for kind, name in (
            (YAW_RATE, "yaw_rate_radps"),
            (LATERAL_ACCELERATION, "ay_mps2"),
            (WHEEL_SPEED, "vx_mps"),
        )
        if log.has(name)
    ]
    captures, waiting = _late_events(log), deque[tuple[float, str, tuple[float, ...], float]]()
    kept, width = len(range(0, n, every)), len(estimator.fields)
    mean, sd = np.zeros((kept, width)), np.zeros((kept, width))
    step, measure = estimator.step, estimator.measure
    for row, stamp in enumerate(stamps):
        step(stamp, inputs[row - 1 if row else 0])
        for kind, values in fast:
            value = values[row]
            if value == value:
                measure(kind, value, stamp, stamp)
        while waiting and waiting[0][0] <= stamp + 1e-9:
            _, kind, pair, taken = waiting.popleft()
            measure(kind, pair, taken, stamp)
        for arrival, kind, pair in captures.get(row, ()):
            estimator.capture(kind, stamp)
            if arrival <= stamp + 1e-9:
                measure(kind, pair, stamp, stamp)
            else:
                waiting.append((arrival, kind, pair, stamp))
                waiting = deque(sorted(waiting))
        if row % every == 0:
            now = estimator.estimate()
            mean[row // every], sd[row // every] = now.mean, now.sd
            if observe is not None:
                observe(row, estimator)
        if progress is not None and row % 1000 == 999:
            progress(1000)
    return Played(log.stamp_s[::every], estimator.fields, mean, sd)


def shifted(stamp_s: Floats, values: Floats, later_s: float) -> Floats:
    """A signal `(n,)` as it was `later_s` before each stamp; itself where that is 0."""
    if not later_s:
        return values
    return np.asarray(np.interp(stamp_s - later_s, stamp_s, values))


def _late_events(log: SignalLog) -> dict[int, list[tuple[float, str, tuple[float, ...]]]]:
    """Row of capture to what was captured there: arrival, kind and the values."""
    events: dict[int, list[tuple[float, str, tuple[float, ...]]]] = {}
    for kind, (first, second, arrival_name) in LATE.items():
        if not (log.has(first) and log.has(second)):
            continue
        a, b = log.columns[first], log.columns[second]
        arrivals = log.columns.get(arrival_name, log.stamp_s)
        stated = kind == GPS and all(log.has(name) for name in GPS_SPREAD_COLUMNS)
        for row in np.flatnonzero(np.isfinite(a) & np.isfinite(b)).tolist():
            arrival = float(arrivals[row])
            stamp = float(log.stamp_s[row])
            values: tuple[float, ...] = (float(a[row]), float(b[row]))
            if stated:
                spread = tuple(float(log.columns[name][row]) for name in GPS_SPREAD_COLUMNS)
                values += spread if min(spread) > 0.0 else ()
            events.setdefault(row, []).append(
                (arrival if arrival >= stamp else stamp, kind, values)
            )
    return events


def arrived(log: SignalLog, name: str, arrival_name: str) -> Floats:
    """A late column `(n,)` held from when its values arrive; 0 before the first."""
    result = np.zeros(len(log))
    if not log.has(name):
        return result
    rows = np.flatnonzero(np.isfinite(log.columns[name]))
    stamps = log.stamp_s
    at = stamps[rows]
    if arrival_name in log.columns:
        arrivals = log.columns[arrival_name][rows]
        at = np.where(arrivals >= at, arrivals, at)
    order = np.argsort(at, kind="stable")
    there = np.searchsorted(at[order], stamps + 1e-9, side="right")
    values = np.concatenate([[0.0], log.columns[name][rows][order]])
    return np.asarray(values[there])
