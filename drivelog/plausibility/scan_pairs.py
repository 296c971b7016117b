"""Pairs of scans about a second apart, and how well a motion brings their poles together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.detections import Detections
from polemap.drivelog.drive import Drive
from polemap.drivelog.plausibility.odometer import Odometer
from polemap.drivelog.plausibility.pole_mistakes import Mistake
from polemap.vehicle.motion import move_along_arc
from polemap.vehicle.pose import rotate_back, rotate_covariance

Floats = NDArray[np.float64]

FEW = 12
"""Pairs that tell anything."""
_INTERVAL_S, _INTERVAL_MAX_S = 0.8, 1.6
_PAIRS_MAX = 200
_POLES_MAX = 16
_FLOOR_M2, _VARIANCE_MAX_M2 = 0.1**2, 4.0
_MEET_M = 2.0
_LOOSE_M2 = 0.3**2


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
    if both.sum() < FEW:
        return 0.0, 1.0
    gain = other[both] - told[both]
    sd = float(gain.std()) / np.sqrt(len(gain))
    ratio = float(other[both].sum() / max(told[both].sum(), 1e-9))
    return float(gain.mean() / sd) if sd > 0.0 else 0.0, ratio
