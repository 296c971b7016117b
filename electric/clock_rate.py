"""Logs whose stamps run too slowly: values held for n rows that were written as n times the time.

A tool that resamples a log by repeating its rows, and counts the rows on, stretches time. The
kinematics tell: the speed changes by 1/n of what the accelerometer says. Nothing else in the log
looks wrong, and every model that is fitted to it is (yaw inertia times n, say).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from polemap.electric.signals import LATE, Played, SignalLog

Floats = NDArray[np.float64]

_HELD_MAX = 100
_ROWS_MIN = 50
# of the rows where values change, so many keep step; of the accelerometer's second-long gains, so
# alike is what the speed gained; the two counts of n agree within so much
_IN_STEP, _ALIKE, _AGREE = 0.98, 0.9, 0.2
_GAIN_MPS, _TURN_RAD = 0.3, 0.05


@dataclass(frozen=True, slots=True)
class StretchedClock:
    """Every value stands in `times` rows, and time runs as many times too slowly.

    Attributes:
        times: n.
        ratio: what the speed changes over what the accelerometer says, with the stamps as they are.
        group: `(rows,)` which set of held values a row belongs to.
    """

    times: int
    ratio: float
    group: NDArray[np.intp]

    def real_time(self, log: SignalLog) -> SignalLog:
        """One row for each set of values, stamps from the first on at their true pace."""
        rows = np.flatnonzero(np.diff(self.group, prepend=-1))
        stamps = log.stamp_s[0] + (log.stamp_s[rows] - log.stamp_s[0]) / self.times
        columns = {name: values[rows] for name, values in log.columns.items()}
        return SignalLog(np.asarray(stamps), columns)

    def at_rows(self, played: Played, log: SignalLog) -> Played:
        """What an estimator said in real time, at the rows and stamps of the log."""
        return Played(log.stamp_s, played.fields, played.mean[self.group], played.sd[self.group])


def stretched_clock(log: SignalLog) -> StretchedClock | None:
    """Whether the stamps of a log are stretched by repeated rows, with what the signals say of it.

    None where any of the three is missing: rows that repeat in step, a speed and an acceleration
    that agree but for that factor, and a course (where there is one) that does not deny it.
    """
    late = {name for names in LATE.values() for name in names}
    fast = [values for name, values in log.columns.items() if name not in late]
    if not (log.has("vx_mps") and log.has("ax_mps2")) or len(log) < _ROWS_MIN:
        return None
    changed = np.zeros(len(log), dtype=bool)
    for values in fast:
        changed[1:] |= (values[1:] != values[:-1]) & ~(np.isnan(values[1:]) & np.isnan(values[:-1]))
    rows = np.flatnonzero(changed)
    if len(rows) < _ROWS_MIN:
        return None
    times = int(np.median(np.diff(rows)))
    if not 2 <= times <= _HELD_MAX:
        return None
    if np.max(np.bincount(rows % times)) < _IN_STEP * len(rows):
        return None
    ratio = _speed_over_acceleration(log, times)
    if ratio is None or abs(ratio * times - 1.0) > _AGREE or _course_denies(log):
        return None
    group = np.asarray((np.arange(len(log)) - rows[0]) // times - (-rows[0] // times))
    return StretchedClock(times, ratio, group.astype(np.intp))


def _speed_over_acceleration(log: SignalLog, times: int) -> float | None:
    """Slope of the speed's change over the integral of ax, over about a real second."""
    stamps, speed = log.stamp_s, log.held("vx_mps")
    path = np.concatenate([[0.0], np.cumsum(log.held("ax_mps2")[:-1] * np.diff(stamps))])
    later = np.searchsorted(stamps, stamps + times)
    rows = np.flatnonzero(later < len(stamps))
    rows = rows[stamps[later[rows]] - stamps[rows] < 1.5 * times]
    gained, change = path[later[rows]] - path[rows], speed[later[rows]] - speed[rows]
    gained = gained - np.median(gained)
    change = change - np.median(change)
    use = np.abs(gained) > _GAIN_MPS
    if use.sum() < _ROWS_MIN:
        return None
    a, b = gained[use], change[use]
    power = float(np.sum(a * a) * np.sum(b * b))
    if not power > 0.0 or np.sum(a * b) / np.sqrt(power) < _ALIKE:
        return None
    return float(np.sum(a * b) / np.sum(a * a))


def _course_denies(log: SignalLog) -> bool:
    """A course that turns as the yaw rate does under the stamps as they are."""
    if not (log.has("course_rad") and log.has("yaw_rate_radps")):
        return False
    turned = np.concatenate(
        [[0.0], np.cumsum(log.held("yaw_rate_radps")[:-1] * np.diff(log.stamp_s))]
    )
    rows = np.flatnonzero(np.isfinite(log.columns["course_rad"]))
    course = np.diff(np.unwrap(log.columns["course_rad"][rows]))
    turn = np.diff(turned[rows])
    use = np.abs(turn) > _TURN_RAD
    if not use.any():
        return False
    return bool(np.median(course[use] / turn[use]) > 0.7)
