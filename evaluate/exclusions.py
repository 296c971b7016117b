"""What does not count as an attempt to drive the same line: rules, and the user's intervals.

Rules (docs/repeatability.md):
- U-turn: the mean path turns by at least 150 degrees within 25 m; it is left out with 10 m on
  either side, for every pass.
- Evasive manoeuvre: a pass leaves the median of the passes by more than four robust standard
  deviations, and at least 0.6 m, for at least 3 m of road, and *its heading shows it*: the
  deviation that follows from the heading alone reaches half of it. A localizer that jumps does
  not turn the car, so that its errors are never excluded. The stretch is widened to where the
  pass is back within a quarter of the limit, by at most 40 m on either side.
- Another lane: a pass lies more than 1.75 m, half a lane, from the middle one of the passes, and
  the reference (or truth) and the output filter agree on that. Without a reference the rule does
  not apply, since it would then excuse the localizer.
- Start-up: the first 5 s after the particle filter's first pose, in which it still converges.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from polemap.drivelog.errors import ConfigError
from polemap.evaluation.laps import Stretch
from polemap.evaluation.meanpath import STATION_STEP_M, MeanPath
from polemap.evaluation.repeatability import Crossing

Floats = NDArray[np.float64]

U_TURN_RAD = np.radians(150.0)
U_TURN_WITHIN_M = 25.0
U_TURN_MARGIN_M = 10.0
EVASIVE_SDS = 4.0
EVASIVE_FLOOR_M = 0.6
EVASIVE_MIN_LENGTH_M = 3.0
EVASIVE_MARGIN_M = 40.0
EVASIVE_STEERED_SHARE = 0.5
DRIFT_WINDOW_M = 120.0
START_UP_S = 5.0
HALF_LANE_M = 1.75
BRIDGED_M = 5.0


@dataclass(frozen=True, slots=True)
class Exclusion:
    """Stations `start_m` to `end_m` of a stretch, for one pass or (`pass_row` None) for all."""

    stretch: int
    pass_row: int | None
    start_m: float
    end_m: float
    reason: str


@dataclass(frozen=True, slots=True)
class UserInterval:
    """An interval that the user excludes: seconds of the drive's clock or metres of station."""

    route: str | None
    unit: str
    start: float
    end: float


def parse_interval(text: str) -> UserInterval:
    """`[ROUTE/]A:B` in seconds of the recording, or `[ROUTE/]Am:Bm` in metres along the path.

    Raises:
        ConfigError: not of that form, or the end does not lie behind the start.
    """
    number = r"(-?\d+(?:\.\d*)?(?:[eE][-+]?\d+)?)"
    match = re.fullmatch(rf"(?:(.+)/)?{number}(m?):{number}(m?)", text.strip())
    if match is None or match.group(3) != match.group(5):
        raise ConfigError(
            f"--exclude {text}: expected A:B in seconds of the recording or Am:Bm in metres along "
            "the mean path, such as 410:450 or avenue/120m:180m"
        )
    start, end = float(match.group(2)), float(match.group(4))
    if not start < end:
        raise ConfigError(f"--exclude {text}: the end must lie behind the start")
    return UserInterval(match.group(1), match.group(3) or "s", start, end)


def u_turns(path: MeanPath) -> list[tuple[float, float]]:
    """Stations between which the path turns around, margins included."""
    heading = np.unwrap(path.heading_rad(path.station_m))
    window = round(U_TURN_WITHIN_M / STATION_STEP_M)
    if len(heading) <= window:
        return []
    turning = np.abs(heading[window:] - heading[:-window]) >= U_TURN_RAD
    inside = np.zeros(len(heading), dtype=bool)
    for first in np.flatnonzero(turning):
        inside[first : first + window + 1] = True
    margin = U_TURN_MARGIN_M
    return [
        (
            max(float(path.station_m[a]) - margin, 0.0),
            min(float(path.station_m[b]) + margin, path.length_m),
        )
        for a, b in _runs(inside)
    ]


def other_lanes(
    stretch: Stretch, judged: Sequence[Crossing], localized: Sequence[Crossing]
) -> list[Exclusion]:
    """Parts of passes on another lane, as the reference and the output filter both see it."""
    agreed = _off_the_middle(stretch, localized)
    for row, one in enumerate(localized):
        # Where the output filter has no pose near the path it cannot object.
        agreed[row, np.setdiff1d(np.arange(agreed.shape[1]), one.stations)] = True
    away = _off_the_middle(stretch, judged) & agreed
    found = []
    for row, mask in enumerate(away):
        runs: list[tuple[int, int]] = []
        for first, last in _runs(mask):
            if runs and (first - runs[-1][1]) * STATION_STEP_M <= BRIDGED_M:
                first = runs.pop()[0]
            runs.append((first, last))
        for first, last in runs:
            start, end = stretch.path.station_m[[first, last]]
            found.append(Exclusion(0, row, float(start), float(end), "another lane"))
    return found


def _off_the_middle(stretch: Stretch, crossed: Sequence[Crossing]) -> NDArray[np.bool_]:
    """Entries `(passes, stations)` more than half a lane from the middle pass of the station."""
    lateral = np.full((len(stretch.passes), len(stretch.path.station_m)), np.inf)
    for row, one in enumerate(crossed):
        lateral[row, one.stations] = one.lateral_m
    count = np.isfinite(lateral).sum(axis=0)
    middle_row = np.maximum((count - 1) // 2, 0)
    middle = np.sort(lateral, axis=0)[middle_row, np.arange(len(count))]
    with np.errstate(invalid="ignore"):
        return np.asarray(np.isfinite(lateral) & (np.abs(lateral - middle) > HALF_LANE_M))


def without(crossed: Sequence[Crossing], mask: NDArray[np.bool_]) -> list[Crossing]:
    """The crossings that `mask` `(passes, stations)` does not leave out."""
    kept = []
    for row, one in enumerate(crossed):
        keep = ~mask[row, one.stations]
        kept.append(
            Crossing(one.stations[keep], one.lateral_m[keep], one.turn_rad[keep], one.stamp_s[keep])
        )
    return kept


def evasive_manoeuvres(stretch: Stretch, judged: Sequence[Crossing]) -> list[Exclusion]:
    """Evasive manoeuvres of single passes; needs at least three passes to tell who swerved.

    Args:
        judged: the passes by the most trusted system (truth, reference, else the output filter).
    """
    count, size = len(stretch.passes), len(stretch.path.station_m)
    if count < 3:
        return []
    lateral, slope = np.full((count, size), np.nan), np.full((count, size), np.nan)
    for row, one in enumerate(judged):
        lateral[row, one.stations] = one.lateral_m
        slope[row, one.stations] = np.tan(np.clip(one.turn_rad, -1.2, 1.2))
    usable = np.isfinite(lateral).sum(axis=0) >= 3
    if not usable.any():
        return []
    swerve, steered = np.full_like(lateral, np.nan), np.full_like(slope, np.nan)
    swerve[:, usable] = lateral[:, usable] - np.nanmedian(lateral[:, usable], axis=0)
    steered[:, usable] = slope[:, usable] - np.nanmedian(slope[:, usable], axis=0)
    # A drifting reference moves a whole pass slowly: that is no manoeuvre.
    window = 2 * int(DRIFT_WINDOW_M / 2 / STATION_STEP_M) + 1
    drift = scipy.ndimage.median_filter(np.nan_to_num(swerve), size=(1, window), mode="nearest")
    swerve -= drift
    spread = 1.4826 * float(np.nanmedian(np.abs(swerve)))
    limit = max(EVASIVE_FLOOR_M, EVASIVE_SDS * spread)
    found = []
    for row in range(count):
        size_m = np.nan_to_num(np.abs(swerve[row]))
        for first, last in _runs(size_m > limit):
            if (last - first) * STATION_STEP_M < EVASIVE_MIN_LENGTH_M:
                continue
            first, last = _widened(size_m, first, last, limit / 4.0)
            if _was_steered(swerve[row], steered[row], first, last):
                start, end = stretch.path.station_m[[first, last]]
                largest = float(np.nanmax(size_m[first : last + 1]))
                reason = f"evasive manoeuvre of {largest:.1f} m (limit {limit:.2f} m)"
                found.append(Exclusion(0, row, float(start), float(end), reason))
    return found


def _widened(size_m: Floats, first: int, last: int, calm_m: float) -> tuple[int, int]:
    reach = int(EVASIVE_MARGIN_M / STATION_STEP_M)
    low = first
    while low > max(first - reach, 0) and size_m[low] > calm_m:
        low -= 1
    high = last
    while high < min(last + reach, len(size_m) - 1) and size_m[high] > calm_m:
        high += 1
    return low, high


def _was_steered(swerve: Floats, slope: Floats, first: int, last: int) -> bool:
    """Whether the heading alone, integrated, explains at least half of the deviation."""
    part = np.nan_to_num(swerve[first : last + 1])
    walked = np.cumsum(np.nan_to_num(slope[first : last + 1])) * STATION_STEP_M
    peak = int(np.argmax(np.abs(part)))
    moved = part[peak] - part[0]
    return bool(np.sign(moved) * walked[peak] >= EVASIVE_STEERED_SHARE * abs(moved))


def start_up_exclusions(
    stretches: Sequence[Stretch],
    crossed: Sequence[Sequence[Crossing]],
    settled_s: Sequence[float],
) -> list[Exclusion]:
    """Stations that a pass drove before its recording's filter had settled.

    Args:
        settled_s: for every recording the time from which its poses count.
    """
    found = []
    for number, stretch in enumerate(stretches):
        for row, (span, one) in enumerate(zip(stretch.passes, crossed[number], strict=True)):
            early = one.stamp_s < settled_s[span.source]
            if early.any():
                at = stretch.path.station_m[one.stations[early]]
                reason = f"start-up, {START_UP_S:.0f} s"
                found.append(Exclusion(number, row, float(at.min()), float(at.max()), reason))
    return found


def user_exclusions(
    stretches: Sequence[Stretch],
    crossed: Sequence[Sequence[Crossing]],
    intervals: Sequence[UserInterval],
    route: str,
) -> list[Exclusion]:
    """The user's intervals that fall on this route."""
    found = []
    for interval in intervals:
        if interval.route not in (None, route):
            continue
        for number, stretch in enumerate(stretches):
            if interval.unit == "m":
                if number == 0 and interval.start < stretch.path.length_m:
                    end = min(interval.end, stretch.path.length_m)
                    found.append(Exclusion(0, None, interval.start, end, "by the user"))
                continue
            for row, one in enumerate(crossed[number]):
                inside = (one.stamp_s >= interval.start) & (one.stamp_s <= interval.end)
                if inside.any():
                    at = stretch.path.station_m[one.stations[inside]]
                    found.append(
                        Exclusion(number, row, float(at.min()), float(at.max()), "by the user")
                    )
    return found


def excluded_mask(
    stretch: Stretch, number: int, exclusions: Sequence[Exclusion]
) -> NDArray[np.bool_]:
    """Entries `(passes, stations)` of stretch `number` that do not count."""
    mask = np.zeros((len(stretch.passes), len(stretch.path.station_m)), dtype=bool)
    station = stretch.path.station_m
    for one in exclusions:
        if one.stretch == number:
            inside = (station >= one.start_m) & (station <= one.end_m)
            rows = slice(None) if one.pass_row is None else one.pass_row
            mask[rows, inside] = True
    return mask


def _runs(mask: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """First and last index of every run of true values."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(np.int8)))
    return [(int(a), int(b) - 1) for a, b in edges.reshape(-1, 2)]
