"""Fixes of a GPS receiver that logged by itself, joined to a signal log.

A receiver counts UTC and a car's log often something else: where the stamps do not overlap, the
offset is the one at which the speed of the fixes is the wheels' but for a scale.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.errors import InputError
from polemap.electric.signals import SignalLog

Floats = NDArray[np.float64]

# of receivers with few satellites in view course and speed are not worth their noise
HDOP_MOST = 5.0
# positions nearer than this have no direction above their noise (some centimetres from fix to fix)
LEAST_WAY_M = 1.0
_EARTH_M = 6_371_000.0
_SHARE_INSIDE = 0.8
_LEAST_FIXES = 3
_OVERLAP_S, _GRID_S, _FINE_S = 20.0, 0.5, 0.01
_LIVELY_MPS, _ALIKE_MPS = 1.0, 0.7


@dataclass(frozen=True, slots=True)
class Joined:
    """A log with GPS columns.

    Attributes:
        offset_s: what was added to the receiver's stamps.
        from_positions: how many courses are directions between positions.
        left_out: fixes beyond `HDOP_MOST`.
    """

    log: SignalLog
    fixes: int
    offset_s: float
    from_positions: int
    left_out: int


def join_receiver(log: SignalLog, fixes: Mapping[str, Floats]) -> Joined:
    """Put fixes into a log: `stamp_s`, `latitude_deg`, `longitude_deg`, and where they are there
    `speed_mps`, `course_deg` (from north, clockwise), `hdop` and `satellites`, each `(n,)`.

    A course that a receiver does not give is the direction between two positions: it belongs to
    the middle between them and is there with the later one; how far they stand apart is the
    column `course_baseline_m` of the log, from which `fix_noise` makes its deviation.

    Raises:
        InputError: the log has GPS already, too few fixes, or clocks that cannot be brought
            together.
    """
    if log.has("course_rad") or log.has("speed_mps"):
        raise InputError("the log has course_rad or speed_mps of its own; leave --gps out")
    # in order of their stamps and each once: logs are joined twice, or written backwards
    _, order = np.unique(fixes["stamp_s"], return_index=True)
    fixes = {name: np.asarray(values, dtype=np.float64)[order] for name, values in fixes.items()}
    count = len(order)
    hdop = fixes.get("hdop", np.full(count, np.nan))
    good = ~(hdop > HDOP_MOST)
    if good.sum() < _LEAST_FIXES:
        raise InputError(
            f"{int(good.sum())} fixes with HDOP up to {HDOP_MOST:g}, {_LEAST_FIXES} are needed"
        )
    taken, course, speed, arrival, way, used = _motion(fixes, good)
    made = np.isfinite(way)
    offset_s = _offset(log, taken, speed)
    taken, arrival = taken + offset_s, arrival + offset_s
    rows = np.rint(np.interp(taken, log.stamp_s, np.arange(len(log)))).astype(np.int64)
    inside = (taken >= log.stamp_s[0]) & (taken <= log.stamp_s[-1])
    inside &= np.diff(rows, prepend=-1) > 0
    columns = dict(log.columns)
    for name, values in (
        ("course_rad", course),
        ("speed_mps", speed),
        ("gnss_arrival_s", arrival),
        ("hdop", hdop[used]),
        ("satellites", fixes.get("satellites", np.full(count, np.nan))[used]),
        ("course_baseline_m", way),
    ):
        if not np.isfinite(values).any():
            continue
        columns[name] = np.full(len(log), np.nan)
        columns[name][rows[inside]] = values[inside]
    if inside.sum() < _LEAST_FIXES:
        raise InputError(
            f"{int(inside.sum())} fixes lie within the log ({log.stamp_s[0]:.1f} to "
            f"{log.stamp_s[-1]:.1f} s), {_LEAST_FIXES} are needed"
        )
    joined = SignalLog(log.stamp_s, columns)
    return Joined(joined, int(inside.sum()), offset_s, int(made[inside].sum()), int((~good).sum()))


def _motion(
    fixes: Mapping[str, Floats], good: NDArray[np.bool_]
) -> tuple[Floats, Floats, Floats, Floats, Floats, NDArray[np.int64]]:
    """Stamps, courses (from east, counter-clockwise), speeds, arrivals, distances of positions.

    The latter are NaN where the receiver gave the course. Last the numbers of the fixes used.
    """
    stamps = np.asarray(fixes["stamp_s"], dtype=np.float64)[good]
    n = len(stamps)
    empty = np.full(len(good), np.nan)
    course = np.radians(90.0 - np.asarray(fixes.get("course_deg", empty))[good])
    speed = np.asarray(fixes.get("speed_mps", empty))[good].astype(np.float64)
    latitude = np.radians(fixes["latitude_deg"][good])
    longitude = np.radians(fixes["longitude_deg"][good])
    north = _EARTH_M * np.diff(latitude)
    east = _EARTH_M * np.diff(longitude) * np.cos(latitude[:-1])
    way, elapsed = np.hypot(north, east), np.diff(stamps)
    usable = (way > LEAST_WAY_M) & (elapsed > 0.0) & (elapsed < 2.5 * np.median(elapsed))
    missing = np.isnan(course[1:]) & usable
    baseline = np.concatenate([[np.nan], np.where(missing, way, np.nan)])
    taken = stamps.copy()
    taken[1:][missing] -= 0.5 * elapsed[missing]
    course[1:][missing] = np.arctan2(north, east)[missing]
    slow = np.isnan(speed[1:]) & usable
    speed[1:][slow] = (way / np.where(elapsed > 0.0, elapsed, 1.0))[slow]
    keep = np.isfinite(course) & np.isfinite(speed)
    if keep.sum() < _LEAST_FIXES:
        raise InputError(
            f"{int(keep.sum())} of {n} fixes have or give a course, {_LEAST_FIXES} are needed"
        )
    return (
        taken[keep],
        np.unwrap(course[keep]),
        speed[keep],
        stamps[keep],
        baseline[keep],
        np.flatnonzero(good)[keep],
    )


def _offset(log: SignalLog, taken: Floats, speed: Floats) -> float:
    """Seconds to add to a receiver's stamps."""
    start, end = float(log.stamp_s[0]), float(log.stamp_s[-1])
    inside = (taken >= start) & (taken <= end)
    if inside.mean() >= _SHARE_INSIDE:
        return 0.0
    if not log.has("vx_mps"):
        raise InputError(
            f"the fixes' stamps ({taken[0]:.1f} to {taken[-1]:.1f} s) are not those of the log "
            f"({start:.1f} to {end:.1f} s), and without vx_mps no offset can be found"
        )
    wheel = log.held("vx_mps")

    def off(offset_s: float) -> float:
        then = taken + offset_s
        both = (then >= start) & (then <= end)
        if np.ptp(then[both]) < _OVERLAP_S if both.any() else True:
            return float("inf")
        wheels, fixes = np.interp(then[both], log.stamp_s, wheel), speed[both]
        if np.std(wheels) < _LIVELY_MPS:
            return float("inf")
        scale = float(wheels @ fixes) / float(wheels @ wheels)
        return float(np.sqrt(np.mean((fixes - scale * wheels) ** 2)))

    coarse = np.arange(start - taken[-1], end - taken[0], _GRID_S)
    errors = np.array([off(offset) for offset in coarse.tolist()])
    best = float(coarse[int(np.argmin(errors))])
    fine = np.arange(best - _GRID_S, best + _GRID_S, _FINE_S)
    found = np.array([off(offset) for offset in fine.tolist()])
    if not found.min() < _ALIKE_MPS:
        raise InputError(
            "the fixes' stamps are not those of the log, and their speed fits the wheels nowhere "
            f"within {_ALIKE_MPS:g} m/s over {_OVERLAP_S:g} s of changing speed; give both on one "
            "clock"
        )
    return float(fine[int(np.argmin(found))])
