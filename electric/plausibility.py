"""A signal log held against itself: units and signs, by what the signals say of one motion.

On a level road ay = v r, the path of the wheels gives r = v delta / (L + K v^2), and the wheel
speed changes with ax. The slope of one against the other is 1 for what the contract asks, and
names the unit or the sign otherwise.
"""

from __future__ import annotations

from math import log as ln

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.findings import Finding
from polemap.drivelog.plausibility.units import ANGLE_UNITS, SPEED_UNITS, named_unit
from polemap.electric.clock_rate import stretched_clock
from polemap.electric.gaps import find_gaps
from polemap.electric.signals import LATE, SignalLog
from polemap.vehicle.parameters import Car

Floats = NDArray[np.float64]

_GRAVITY = 9.80665
_SPEED_MPS = 3.0
_ROWS_MIN = 20
_CORRELATION_MIN = 0.7
# arrivals that are earlier than what arrives, and later than any camera or receiver is
_EARLY_SHARE, _LATE_MAX_S = 0.02, 2.0
_SPEED_MAX_MPS, _YAW_RATE_MAX_RADPS, _ANGLE_MAX_RAD = 100.0, 3.0, 1.0


def check_log(log: SignalLog, car: Car) -> list[Finding]:
    """What in a signal log cannot be right."""
    found = _gaps(log) + _clock_rate(log) + _arrivals(log) + _ranges(log)
    ranged = {finding.stream for finding in found if finding.severity == "error"}
    for check in (_lateral, _steering, _longitudinal, _speeds, _course, _sideslip):
        found += [finding for finding in check(log, car) if finding.stream not in ranged]
    return _one_sign(found)


def _one_sign(found: list[Finding]) -> list[Finding]:
    """Steering and ay that both turn against the yaw rate: the yaw rate is at fault."""
    signs = [finding for finding in found if finding.kind == "signal_sign"]
    if not {"ay_mps2", "road_wheel_angle_rad"} <= {finding.stream for finding in signs}:
        return found
    yaw = _sign("yaw_rate_radps", "ay_mps2 and road_wheel_angle_rad", "counter-clockwise positive")
    rest = [finding for finding in found if finding not in signs]
    others = [f for f in signs if f.stream not in ("ay_mps2", "road_wheel_angle_rad", "course_rad")]
    return [yaw, *rest, *others]


def _gaps(log: SignalLog) -> list[Finding]:
    gaps = find_gaps(log)
    if not gaps:
        return []
    longest = max(gaps, key=lambda gap: gap.length_s)
    return [
        Finding(
            "gap", "warning", "stamp_s",
            f"{len(gaps)} gaps, the longest {longest.length_s:.2f} s from {longest.from_s:.3f} s",
            "rows without gaps", "the estimator begins anew after each; cut the log there",
        )
    ]  # fmt: skip


def _clock_rate(log: SignalLog) -> list[Finding]:
    clock = stretched_clock(log)
    if clock is None:
        return []
    return [
        Finding(
            "clock_rate", "warning", "stamp_s",
            f"every value stands in {clock.times} rows, and vx_mps changes by {clock.ratio:.2g} of "
            "what ax_mps2 says", "a ratio of 1",
            f"time was taken to run {clock.times} times as fast; mend the stamps of the log",
        )
    ]  # fmt: skip


def _arrivals(log: SignalLog) -> list[Finding]:
    """Arrivals against the stamps of what arrives."""
    found = []
    for first, _, name in LATE.values():
        if not (log.has(first) and log.has(name)):
            continue
        delay = (log.columns[name] - log.stamp_s)[np.isfinite(log.columns[first])]
        delay = delay[np.isfinite(delay)]
        if not len(delay):
            continue
        early, median = int(np.sum(delay < -1e-3)), float(np.median(delay))
        seen = ""
        if early > _EARLY_SHARE * len(delay):
            seen = (
                f"{early} of {len(delay)} arrive before their stamps, {median:.4g} s in the median"
            )
            told = "such values were heard at their stamps"
        elif median > _LATE_MAX_S:
            seen, told = (
                f"values arrive {median:.4g} s after their stamps",
                "they were heard so late",
            )
        if seen:
            found.append(
                Finding("arrival", "warning", name, seen, f"0 to {_LATE_MAX_S:g} s",
                        f"{told}; write {name} in the clock of stamp_s")
            )  # fmt: skip
    return found


def _ranges(log: SignalLog) -> list[Finding]:
    found = []
    step = float(np.median(np.diff(log.stamp_s)))
    if step > 1.0:
        found.append(
            Finding("stamp_unit", "error", "stamp_s", f"a row every {step:.4g} s", "0.001 to 1 s",
                    "write the stamps in seconds")
        )  # fmt: skip
    for name, limit, unit in (
        ("vx_mps", _SPEED_MAX_MPS, "m/s"),
        ("speed_mps", _SPEED_MAX_MPS, "m/s"),
        ("yaw_rate_radps", _YAW_RATE_MAX_RADPS, "rad/s"),
        ("road_wheel_angle_rad", _ANGLE_MAX_RAD, "rad"),
        ("ay_mps2", 25.0, "m/s2"),
        ("ax_mps2", 25.0, "m/s2"),
        ("sideslip_rad", 1.6, "rad"),
    ):
        if not log.has(name):
            continue
        values = log.columns[name]
        size = float(np.percentile(np.abs(values[np.isfinite(values)]), 98))
        if size > limit:
            found.append(
                Finding("signal_range", "error", name, f"values to {size:.4g}",
                        f"below {limit:g} {unit}", f"write {name} in {unit}")
            )  # fmt: skip
    return found


def _lateral(log: SignalLog, _car: Car) -> list[Finding]:
    """ay against v r."""
    if not (log.has("ay_mps2") and log.has("yaw_rate_radps") and log.has("vx_mps")):
        return []
    speed, rate = log.held("vx_mps"), log.held("yaw_rate_radps")
    slope = _slope(speed * rate, log.held("ay_mps2"), np.abs(speed) > _SPEED_MPS, 0.5)
    if slope is None:
        return []
    if slope < 0.0:
        return [_sign("ay_mps2", "vx_mps times yaw_rate_radps", "ay left, yaw rate counter-"
                      "clockwise positive")]  # fmt: skip
    if 0.7 < slope < 1.4:
        return []
    units = {1.0 / _GRAVITY: "ay in g", 180.0 / np.pi: "ay or yaw rate in another angle's unit",
             np.pi / 180.0: "a yaw rate in degrees", 1.0 / 3.6: "a speed in km/h"}  # fmt: skip
    unit = named_unit(slope, units, 0.12)
    stream = {"a yaw rate in degrees": "yaw_rate_radps", "a speed in km/h": "vx_mps"}.get(
        unit or "", "ay_mps2"
    )
    return [_scale(stream, slope, "ay_mps2", "vx_mps times yaw_rate_radps", unit)]


def _steering(log: SignalLog, car: Car) -> list[Finding]:
    """Road-wheel angle against the curvature of the path."""
    names = ("road_wheel_angle_rad", "yaw_rate_radps", "vx_mps")
    if not all(log.has(name) for name in names):
        return []
    angle, rate, speed = (log.held(name) for name in names)
    # gently driven, so that neither understeer nor the tyres' limit hides the geometry
    gentle = (np.abs(speed) > _SPEED_MPS) & (np.abs(speed * rate) < 4.0)
    wanted = car.wheelbase_m * rate / np.where(np.abs(speed) > _SPEED_MPS, speed, np.inf)
    slope = _slope(wanted, angle - float(np.median(angle - wanted)), gentle, 0.005)
    if slope is None:
        return []
    if slope < 0.0:
        return [_sign("road_wheel_angle_rad", "yaw_rate_radps", "positive to the left")]
    if 0.5 < slope < 4.0:
        return []
    unit = "a steering-wheel angle" if 8.0 < slope < 30.0 else named_unit(slope, ANGLE_UNITS, 0.5)
    return [_scale("road_wheel_angle_rad", slope, "road_wheel_angle_rad",
                   "wheelbase times curvature", unit)]  # fmt: skip


def _longitudinal(log: SignalLog, _car: Car) -> list[Finding]:
    """ax against the change of the wheel speed, over a second."""
    if not (log.has("ax_mps2") and log.has("vx_mps")):
        return []
    path = np.concatenate([[0.0], np.cumsum(log.held("ax_mps2")[:-1] * np.diff(log.stamp_s))])
    later = np.searchsorted(log.stamp_s, log.stamp_s + 1.0)
    rows = np.flatnonzero(later < len(log))
    rows = rows[log.stamp_s[later[rows]] - log.stamp_s[rows] < 1.5]
    if len(rows) < _ROWS_MIN:
        return []
    gained = path[later[rows]] - path[rows]
    speed = log.held("vx_mps")
    change = speed[later[rows]] - speed[rows]
    slope = _slope(change, gained - float(np.median(gained)), np.ones(len(rows), dtype=bool), 0.3)
    if slope is None or 0.5 < slope < 2.0:
        return []
    if slope < 0.0:
        return [_sign("ax_mps2", "the change of vx_mps", "forward positive")]
    # slopes, drifts and vy r stand in ax too: only a factor with a name is certain
    unit = named_unit(slope, {1.0 / _GRAVITY: "ax in g", 1.0 / 3.6: "a speed in km/h"}, 0.2)
    if unit is None:
        return []
    stream = "vx_mps" if unit == "a speed in km/h" else "ax_mps2"
    return [_scale(stream, slope, "ax_mps2", "the change of vx_mps", unit)]


def _speeds(log: SignalLog, _car: Car) -> list[Finding]:
    """Wheel speed against GPS speed."""
    if not (log.has("vx_mps") and log.has("speed_mps")):
        return []
    rows = np.isfinite(log.columns["speed_mps"])
    gps, wheels = log.columns["speed_mps"][rows], log.held("vx_mps")[rows]
    moving = gps > _SPEED_MPS
    if moving.sum() < 5:
        return []
    ratio = float(np.median(wheels[moving] / gps[moving]))
    if ratio > 0.0 and abs(ln(ratio)) < ln(1.2):
        return []
    return [_scale("vx_mps", ratio, "vx_mps", "speed_mps", named_unit(ratio, SPEED_UNITS))]


def _course(log: SignalLog, _car: Car) -> list[Finding]:
    """Course and camera heading against the integral of the yaw rate."""
    if not log.has("yaw_rate_radps") or not log.has("course_rad"):
        return []
    turned = np.concatenate(
        [[0.0], np.cumsum(log.held("yaw_rate_radps")[:-1] * np.diff(log.stamp_s))]
    )
    fast = log.held("speed_mps" if log.has("speed_mps") else "vx_mps", 10.0) > _SPEED_MPS
    rows = np.flatnonzero(np.isfinite(log.columns["course_rad"]) & fast)
    if len(rows) < 10:
        return []
    # over half a second and more, so that a turn stands out of the noise of a course
    half = np.unique(np.floor(2.0 * log.stamp_s[rows]), return_index=True)[1]
    rows = rows[half]
    change, turn = np.diff(log.columns["course_rad"][rows]), np.diff(turned[rows])
    use = np.diff(log.stamp_s[rows]) < 2.0
    around = np.abs(change) > np.pi
    # a course that goes once around jumps now and then; one in degrees is large all the time
    if around.mean() < 0.1:
        use &= ~around
    slope = _slope(turn[use], change[use], np.ones(int(use.sum()), dtype=bool), 0.01)
    if slope is None or 0.5 < slope < 2.0:
        return []
    if slope < 0.0:
        return [_sign("course_rad", "the integral of yaw_rate_radps", "counter-clockwise from "
                      "east, as the yaw rate")]  # fmt: skip
    return [_scale("course_rad", slope, "course_rad", "the integral of yaw_rate_radps",
                   named_unit(slope, ANGLE_UNITS, 0.3))]  # fmt: skip


def _sideslip(log: SignalLog, _car: Car) -> list[Finding]:
    """The side-slip reference against lateral over longitudinal speed."""
    if not all(log.has(name) for name in ("sideslip_rad", "vy_mps", "vx_mps")):
        return []
    speed = log.held("vx_mps")
    moving = np.abs(speed) > _SPEED_MPS
    told = log.held("vy_mps") / np.where(moving, speed, np.inf)
    slope = _slope(told, log.held("sideslip_rad"), moving, 0.005)
    if slope is None or 0.5 < slope < 2.0:
        return []
    if slope < 0.0:
        return [_sign("sideslip_rad", "vy_mps over vx_mps", "positive to the left")]
    return [_scale("sideslip_rad", slope, "sideslip_rad", "vy_mps over vx_mps",
                   named_unit(slope, ANGLE_UNITS, 0.2))]  # fmt: skip


def _slope(x: Floats, y: Floats, rows: NDArray[np.bool_], least: float) -> float | None:
    """Slope of y over x through the origin where x is at least `least`; None if unrelated."""
    use = rows & np.isfinite(x) & np.isfinite(y) & (np.abs(x) >= least)
    if use.sum() < _ROWS_MIN or not np.ptp(y[use]) > 0.0:
        return None
    a, b = x[use], y[use]
    weight = np.abs(a)
    order = np.argsort(b / a)
    share = np.cumsum(weight[order]) / weight.sum()
    slope = float((b / a)[order][np.searchsorted(share, 0.5)])
    related = float(np.sum(a * b) / np.sqrt(np.sum(a * a) * np.sum(b * b)))
    return slope if abs(related) > _CORRELATION_MIN and slope != 0.0 else None


def _sign(stream: str, against: str, expected: str) -> Finding:
    return Finding("signal_sign", "error", stream, f"its sign is against {against}", expected,
                   f"change the sign of {stream}")  # fmt: skip


def _scale(stream: str, ratio: float, name: str, against: str, unit: str | None) -> Finding:
    named = f", the factor of {unit}" if unit else ""
    return Finding("signal_unit" if unit else "signal_scale", "error", stream,
                   f"{name} is {ratio:.3g} times {against}{named}", "a ratio of 1",
                   f"write {stream} in the unit of its name")  # fmt: skip
