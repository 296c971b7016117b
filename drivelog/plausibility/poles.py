"""Poles stand still: how they move from scan to scan must be the motion that another stream tells.

A pair of scans a second apart is moved onto each other by the motion in between, as it is told and
as it would be with a mistake (a sign, a unit, a clock that is off). The mistake that brings the
poles together where the motion as told does not, is the finding.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.detections import Detections
from polemap.drivelog.drive import Drive
from polemap.drivelog.findings import Finding
from polemap.drivelog.plausibility.odometer import Odometer
from polemap.vehicle.motion import move_along_arc
from polemap.vehicle.pose import rotate_back, rotate_covariance

Floats = NDArray[np.float64]

_INTERVAL_S, _INTERVAL_MAX_S = 0.8, 1.6
_PAIRS_MAX = 200
_POLES_MAX = 16
_FLOOR_M2, _VARIANCE_MAX_M2 = 0.1**2, 4.0
# how much better than the motion as told a mistake must agree: standard deviations, and ratio
_BETTER_SDS, _BETTER_RATIO = 5.0, 1.25
_LAG_SDS, _LAG_RATIO = 5.0, 1.08
# finely where delays of a sensor lie, then to beyond the 18 leap seconds
_SIZES_S = (0.1, 0.2, 0.3, 0.4, 0.5, 0.7, 1.0, 1.5, *map(float, range(2, 21)))
LAGS_S = (*(-size for size in _SIZES_S), *_SIZES_S)
_LAG_DOUBT_S, _LAG_WRONG_S = 0.15, 0.6
_FEW = 12
_MEET_M = 2.0
_OFFSET_STEP_RADPS, _OFFSET_MAX_RADPS, _OFFSET_DOUBT_RADPS = 0.005, 0.25, 0.02
_LOOSE_M2 = 0.3**2
# scans that repeat the one before to the last digit while the car moves
_REPEATED, _REPEATED_SHARE = 10, 0.5


@dataclass(frozen=True, slots=True)
class Mistake:
    """A motion as it would be if something were wrong: factors on way and turn; other axes.

    `axes` has the rows of the matrix that brings points as given to x ahead, y left; `oriented`
    are points that do not turn with the car, but lie by the axes of a map, in which the heading of
    the motion begins at this angle; `polar` are ranges and bearings, these in the given unit (rad);
    `loose` are points of which the covariance says nothing; `offset_radps` is added to the yaw
    rate.
    """

    kind: str
    text: str
    way: float = 1.0
    turn: float = 1.0
    axes: tuple[tuple[float, float], tuple[float, float]] | None = None
    oriented: float | None = None
    polar: float | None = None
    offset_radps: float = 0.0
    loose: bool = False


def _turned_by(angle: float) -> tuple[tuple[float, float], tuple[float, float]]:
    c, s = float(np.cos(angle)), float(np.sin(angle))
    return (c, -s), (s, c)


AS_TOLD, LOOSELY = Mistake("", ""), Mistake("", "", loose=True)
MISTAKES = (
    Mistake("pole_turn", "turn to the other side", turn=-1.0),
    Mistake("pole_direction", "move the other way", way=-1.0),
    Mistake("pole_direction", "move the other way and turn to the other side", way=-1.0, turn=-1.0),
    Mistake("pole_axes", "fit with x and y exchanged", axes=((0, 1), (1, 0))),
    Mistake("pole_axes", "fit with x to the right and y ahead", axes=((0, 1), (-1, 0))),
    Mistake("pole_axes", "fit with x to the left and y backward", axes=((0, -1), (1, 0))),
    *(
        Mistake(
            "pole_axes",
            "fit with x and y along fixed directions, such as east and north",
            oriented=float(heading),
            loose=True,
        )
        for heading in np.linspace(0.0, 2.0 * np.pi, 18, endpoint=False)
    ),
    Mistake("pole_polar", "fit with ranges and bearings (rad) for x and y", polar=1.0, loose=True),
    Mistake(
        "pole_polar",
        "fit with ranges and bearings (degrees) for x and y",
        polar=np.pi / 180,
        loose=True,
    ),
    Mistake("pole_speed", "fit a speed 2 times larger (they are twice as far)", way=2.0),
    Mistake("pole_speed", "fit a speed 2 times smaller (they are half as far)", way=0.5),
    Mistake("pole_scale", "fit a speed 1.3 times larger", way=1.3),
    Mistake("pole_scale", "fit a speed 1.3 times smaller", way=1 / 1.3),
    Mistake("pole_speed", "fit a speed 3.6 times smaller (km/h)", way=1 / 3.6),
    Mistake("pole_speed", "fit a speed 3.6 times larger", way=3.6),
    Mistake("pole_speed", "fit a speed 2.24 times smaller (mph)", way=0.44704),
    Mistake("pole_speed", "fit a speed 2.24 times larger", way=1 / 0.44704),
    Mistake("pole_speed", "fit a speed 1.61 times smaller", way=0.621371),
    Mistake("pole_speed", "fit a speed 1.61 times larger", way=1.609344),
    Mistake("pole_speed", "fit a speed 100 times smaller (cm/s)", way=0.01),
    Mistake("pole_speed", "fit a speed 1000 times smaller (mm/s)", way=0.001),
    Mistake("pole_speed", "fit a speed 3.28 times larger (poles in feet)", way=1 / 0.3048),
    Mistake("pole_speed", "fit a speed 3.28 times smaller (ft/s)", way=0.3048),
    Mistake("pole_turn_unit", "fit a yaw rate in degrees", turn=np.pi / 180.0),
    Mistake("pole_turn_unit", "fit a yaw rate 57.3 times larger", turn=180.0 / np.pi),
    *(
        Mistake("pole_turn_offset", "fit a yaw rate with an offset", offset_radps=sign * rate)
        for rate in (0.025, 0.05, 0.1, 0.2)
        for sign in (-1.0, 1.0)
    ),
    *(
        Mistake("pole_mounting", "fit turned axes", axes=_turned_by(sign * np.radians(degrees)))
        for degrees in (4.0, 8.0, 15.0, 25.0)
        for sign in (-1.0, 1.0)
    ),
    *(
        Mistake("pole_turn_scale", f"fit a yaw rate {factor:g} times as large", turn=factor)
        for factor in (0.5, 2.0, 3.0, 4.0, 5.0, 6.5, 8.0, 10.0)
    ),
)


@dataclass(frozen=True, slots=True)
class Scans:
    """The `p` nearest poles of `n` scans as arrays; places beyond a scan's poles are not `there`.

    Attributes:
        stamp_s: `(n,)`.
        points_m: `(n, p, 2)` vehicle frame.
        covariance_m2: `(n, p, 2, 2)`.
        there: `(n, p)`.
    """

    stamp_s: Floats
    points_m: Floats
    covariance_m2: Floats
    there: NDArray[np.bool_]

    def in_axes(self, axes: tuple[tuple[float, float], tuple[float, float]]) -> Scans:
        """As they are when the points as given are multiplied by a matrix."""
        turn = np.array(axes, dtype=np.float64)
        return Scans(
            self.stamp_s, self.points_m @ turn.T, turn @ self.covariance_m2 @ turn.T, self.there
        )

    def from_polar(self, unit_rad: float) -> Scans:
        """As they are when the points as given are ranges and bearings in a unit."""
        reach, bearing = self.points_m[..., 0], self.points_m[..., 1] * unit_rad
        points = reach[..., None] * np.stack([np.cos(bearing), np.sin(bearing)], axis=-1)
        return Scans(self.stamp_s, points, self.covariance_m2, self.there)

    def loosely(self) -> Scans:
        """With covariances of a common detector instead of the ones stated."""
        spread = np.broadcast_to(_LOOSE_M2 * np.eye(2), self.covariance_m2.shape)
        return Scans(self.stamp_s, self.points_m, spread, self.there)

    def turned(self, motion: Odometer, start_rad: float) -> Scans:
        """As they are when the points as given lie by axes in which the heading begins so."""
        heading = np.interp(self.stamp_s, motion.stamp_s, motion.heading_rad)
        heading = (heading + start_rad)[:, None]
        return Scans(
            self.stamp_s,
            rotate_back(self.points_m, heading),
            rotate_covariance(self.covariance_m2, -heading),
            self.there,
        )


@dataclass(frozen=True, slots=True)
class ScanPairs:
    """Pairs of scans about a second apart, thinned to a handful over the drive."""

    first: Scans
    second: Scans

    def __len__(self) -> int:
        return len(self.first.stamp_s)


def find_pairs(drive: Drive, motion: Odometer) -> ScanPairs:
    """Pairs of scans with poles, the ones in which the car turns first."""
    scans = [scan for scan in drive.scans if len(scan) > 0]
    if len(scans) < 2:
        return ScanPairs(_arrays([]), _arrays([]))
    stamps = np.array([scan.stamp_s for scan in scans])
    later = np.searchsorted(stamps, stamps + _INTERVAL_S)
    usable = later < len(scans)
    first = np.flatnonzero(usable)
    later = later[usable]
    elapsed_s = stamps[later] - stamps[first]
    _, turn, known = motion.spans(stamps[first], stamps[later])
    keep = known & (elapsed_s <= _INTERVAL_MAX_S)
    first, later, turn = first[keep], later[keep], turn[keep]
    if len(first) > _PAIRS_MAX:
        # half of them where the car turns most, half spread evenly over the drive
        half = _PAIRS_MAX // 2
        large = np.argsort(-np.abs(turn), kind="stable")[: len(first) // 2]
        evenly = np.linspace(0, len(first) - 1, half).astype(np.int64)
        chosen = np.unique(np.concatenate([large[:: max(1, len(large) // half)][:half], evenly]))
        first, later = first[chosen], later[chosen]
    return ScanPairs(_arrays([scans[i] for i in first]), _arrays([scans[i] for i in later]))


def _arrays(scans: Sequence[Detections]) -> Scans:
    width = min(_POLES_MAX, max((len(scan) for scan in scans), default=0))
    points = np.zeros((len(scans), width, 2))
    covariance = np.tile(np.eye(2), (len(scans), width, 1, 1))
    there = np.zeros((len(scans), width), dtype=np.bool_)
    for row, scan in enumerate(scans):
        near = np.argsort(np.hypot(*scan.points_vehicle_m.T), kind="stable")[:width]
        points[row, : len(near)] = scan.points_vehicle_m[near]
        given = scan.covariance_m2[near]
        # a pole that says nothing of its place would meet every other
        largest = np.maximum(given[:, 0, 0], given[:, 1, 1])
        shrink = np.minimum(1.0, _VARIANCE_MAX_M2 / np.maximum(largest, 1e-12))
        covariance[row, : len(near)] = given * shrink[:, None, None]
        there[row, : len(near)] = True
    return Scans(np.array([scan.stamp_s for scan in scans]), points, covariance, there)


def agreement(pairs: ScanPairs, motion: Odometer, mistake: Mistake, lag_s: float = 0.0) -> Floats:
    """How well the moved poles of each pair meet poles of the later scan: `(pairs,)`.

    The sum over the poles of exp(-d^2 / 2), with d the distance to the nearest pole in standard
    deviations of both: clutter and poles that leave the view add nothing, whatever the motion.
    NaN where the motion is not known.
    """
    way, turn, known = motion.spans(pairs.first.stamp_s + lag_s, pairs.second.stamp_s + lag_s)
    elapsed = pairs.second.stamp_s - pairs.first.stamp_s
    way, turn = way * mistake.way, turn * mistake.turn + mistake.offset_radps * elapsed
    moves = move_along_arc(np.zeros(3), way, turn)[:, None]
    first, second = pairs.first, pairs.second
    if mistake.axes is not None:
        first, second = first.in_axes(mistake.axes), second.in_axes(mistake.axes)
    if mistake.polar is not None:
        first, second = first.from_polar(mistake.polar), second.from_polar(mistake.polar)
    if mistake.loose:
        first, second = first.loosely(), second.loosely()
    if mistake.oriented is not None:
        first, second = (scans.turned(motion, mistake.oriented) for scans in (first, second))
    moved = rotate_back(first.points_m - moves[..., :2], moves[..., 2])
    spread = rotate_covariance(first.covariance_m2, -turn[:, None])
    total = spread[:, :, None] + second.covariance_m2[:, None] + _FLOOR_M2 * np.eye(2)
    offset = moved[:, :, None] - second.points_m[:, None]
    xx, yy, xy = total[..., 0, 0], total[..., 1, 1], total[..., 0, 1]
    x, y = offset[..., 0], offset[..., 1]
    square = (yy * x * x - 2.0 * xy * x * y + xx * y * y) / (xx * yy - xy * xy)
    square = np.where(second.there[:, None, :], square, np.inf)
    nearest = np.exp(-0.5 * square.min(axis=2, initial=np.inf))
    return np.where(known, np.where(first.there, nearest, 0.0).sum(axis=1), np.nan)


def meetings(pairs: ScanPairs, motion: Odometer) -> tuple[Floats, Floats]:
    """Poles that one later pole alone can be: by how much they miss it, and what is stated of that.

    Returns:
        Offsets `(n, 2)` in the later vehicle frame and the sums of both covariances `(n, 2, 2)`.
    """
    first, second = pairs.first, pairs.second
    way, turn, known = motion.spans(first.stamp_s, second.stamp_s)
    moves = move_along_arc(np.zeros(3), way, turn)[:, None]
    moved = rotate_back(first.points_m - moves[..., :2], moves[..., 2])
    spread = rotate_covariance(first.covariance_m2, -turn[:, None])
    offset = second.points_m[:, None] - moved[:, :, None]
    distance = np.hypot(offset[..., 0], offset[..., 1])
    distance = np.where(second.there[:, None], distance, np.inf)
    nearest = distance.argmin(axis=2)
    ordered = np.sort(distance, axis=2)
    alone = ordered[..., 1] > 2.0 * ordered[..., 0] if ordered.shape[2] > 1 else True
    met = first.there & known[:, None] & (ordered[..., 0] < _MEET_M) & alone
    pair, row = np.nonzero(met)
    other = nearest[pair, row]
    return offset[pair, row, other], spread[pair, row] + second.covariance_m2[pair, other]


def advantage(other: Floats, told: Floats) -> tuple[float, float]:
    """By how many standard deviations `other` agrees better than `told`, and the ratio of sums.

    Paired over the scans `(pairs,)`: what differs from scan to scan does not count.
    """
    both = np.isfinite(other) & np.isfinite(told)
    if both.sum() < _FEW:
        return 0.0, 1.0
    gain = other[both] - told[both]
    sd = float(gain.std()) / np.sqrt(len(gain))
    ratio = float(other[both].sum() / max(told[both].sum(), 1e-9))
    return float(gain.mean() / sd) if sd > 0.0 else 0.0, ratio


def motion_findings(drive: Drive, motion: Odometer, *, confirmed: bool) -> list[Finding]:
    """Signs, units and clock of the poles against a motion.

    Args:
        confirmed: another stream agrees with the motion, so that the poles are at fault.
    """
    pairs = find_pairs(drive, motion)
    if len(pairs) < _FEW:
        return []
    told = agreement(pairs, motion, AS_TOLD)
    loosely = agreement(pairs, motion, LOOSELY)
    ranked = [
        advantage(agreement(pairs, motion, mistake), loosely if mistake.loose else told)
        for mistake in MISTAKES
    ]
    best = int(np.argmax([sds for sds, _ in ranked]))
    if np.abs(pairs.first.points_m[..., 1]).max() <= np.pi:
        # so narrow a view fits a car that does not turn as well as bearings
        polar = next(row for row, mistake in enumerate(MISTAKES) if mistake.polar == 1.0)
        best = polar if _better(*ranked[polar]) else best
    if _better(*ranked[best]):
        mistake, ratio = MISTAKES[best], ranked[best][1]
        if mistake.kind == "pole_turn_offset":
            return _offset_finding(drive, pairs, motion, told)
        return [_mistaken(mistake, drive.names.poles, motion.name, ratio, len(pairs), confirmed)]
    lags = [advantage(agreement(pairs, motion, AS_TOLD, lag), told) for lag in LAGS_S]
    best = int(np.argmax([sds for sds, _ in lags]))
    lag, (sds, ratio) = LAGS_S[best], lags[best]
    if sds < _LAG_SDS or ratio < _LAG_RATIO or abs(lag) < _LAG_DOUBT_S:
        return []
    late = lag < 0.0
    return [
        Finding(
            "clock_offset", "error" if abs(lag) > _LAG_WRONG_S else "warning", drive.names.poles,
            f"it tells the motion of {motion.name} about {abs(lag):.1f} s "
            f"{'late' if late else 'early'} ({ratio:.2f} times as many poles meet)",
            "the same clock",
            f"{'subtract' if late else 'add'} {abs(lag):.1f} s {'from' if late else 'to'} its "
            "stamps"
            + ("" if confirmed else f", or the other way round with those of {motion.name}"),
        )
    ]  # fmt: skip


def _better(sds: float, ratio: float) -> bool:
    return sds > _BETTER_SDS and ratio > _BETTER_RATIO


def _offset_finding(
    drive: Drive, pairs: ScanPairs, motion: Odometer, told: Floats
) -> list[Finding]:
    """A constant in the yaw rate, by the value that fits best; a gyro's common one is none."""
    rates = np.arange(-_OFFSET_MAX_RADPS, _OFFSET_MAX_RADPS + 1e-9, _OFFSET_STEP_RADPS)
    sums = [
        float(np.nansum(agreement(pairs, motion, Mistake("", "", offset_radps=float(rate)))))
        for rate in rates
    ]
    best = int(np.argmax(sums))
    if abs(rates[best]) < _OFFSET_DOUBT_RADPS:
        return []
    ratio = sums[best] / max(float(np.nansum(told)), 1e-9)
    return [
        Finding(
            "yaw_rate_offset", "warning", motion.name,
            f"it turns by {-rates[best]:.3f} rad/s more than {drive.names.poles} "
            f"({ratio:.2g} times as many meet in {len(pairs)} pairs of scans)",
            f"within {_OFFSET_DOUBT_RADPS:g} rad/s",
            "subtract what the sensor shows standing still, or check x and y of the poles",
        )
    ]  # fmt: skip


def repeated_findings(drive: Drive, motion: Odometer) -> list[Finding]:
    """Scans that are the one before once more while the car goes on."""
    scans = [scan for scan in drive.scans if len(scan)]
    if len(scans) <= _REPEATED:
        return []
    stamps = np.array([scan.stamp_s for scan in scans])
    way, _, known = motion.spans(stamps[:-1], stamps[1:])
    moved = known & (np.abs(way) > 0.01)
    same = np.array(
        [np.array_equal(a.points_vehicle_m, b.points_vehicle_m) for a, b in pairwise(scans)]
    )
    count, total = int((same & moved).sum()), int(moved.sum())
    if count < max(_REPEATED, _REPEATED_SHARE * total):
        return []
    return [
        Finding(
            "pole_repeated", "error", drive.names.poles,
            f"{count} of {total} scans repeat the poles of the scan before while {motion.name} "
            "goes on", "poles that were measured anew",
            "write the poles of each scan, by what the detector saw then",
        )
    ]  # fmt: skip


def contradicted(drive: Drive, first: Odometer, second: Odometer) -> Odometer:
    """Which of two motions the poles contradict; the second where they do not tell."""
    pairs = find_pairs(drive, first)
    sds, _ = advantage(agreement(pairs, second, AS_TOLD), agreement(pairs, first, AS_TOLD))
    return first if sds > 2.0 else second


def _mistaken(
    mistake: Mistake, poles: str, name: str, ratio: float, pairs: int, confirmed: bool
) -> Finding:
    at_fault = poles if confirmed else name
    remedies = {
        "pole_turn": "write y to the left" if confirmed
        else f"change the sign of the yaw rate of {name}, or of y of {poles}",
        "pole_direction": "write x ahead and y to the left" if confirmed
        else f"change the sign of the speed of {name}, or of x and y of {poles}",
        "pole_axes": "write x ahead and y to the left",
        "pole_scale": "check the distances of the poles" if confirmed
        else f"check the speed of {name} and the distances of {poles}",
        "pole_speed": "check the unit of x and y" if confirmed
        else f"check the unit of the speed of {name} and of x, y of {poles}",
        "pole_polar": "write x = range cos(bearing) and y = range sin(bearing)",
        "pole_turn_unit": "check x and y" if confirmed
        else f"write the yaw rate of {name} in rad/s",
        "pole_mounting": "correct the detector's mounting",
        "pole_turn_scale": "check x and y" if confirmed
        else f"check the unit and scale of the yaw rate of {name} (rad/s, not a curvature)",
    }  # fmt: skip
    return Finding(
        mistake.kind,
        "error",
        poles if mistake.kind in ("pole_axes", "pole_polar") else at_fault,
        f"the poles {mistake.text} against the motion of {name} ({ratio:.2g} times as many meet in "
        f"{pairs} pairs of scans)",
        "poles that stand still",
        remedies[mistake.kind],
    )
