"""Every stream that says how the car moves, as an odometer: path and heading summed up over time.

Differences of an odometer over the same spans of time can be compared, whatever the stream's own
rate. Everything here is linear in the number of samples and knows no grid over time: a gap of a
day costs nothing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.streams import GnssStream, OdometryStream, ReferenceStream
from polemap.vehicle.pose import rotate_back, wrap_angle

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class Odometer:
    """Summed motion `(n,)` at stamps `(n,)`; spans across a gap of `gap_s` are not known.

    Attributes:
        path_m: signed way along the heading; the sum of chords where no heading is measured.
        heading_rad: unwrapped.
        smooth_s: span below which differences are noise.
    """

    name: str
    stamp_s: Floats
    path_m: Floats
    heading_rad: Floats
    gap_s: float
    smooth_s: float

    def __len__(self) -> int:
        return len(self.stamp_s)

    def spans(self, from_s: Floats, to_s: Floats) -> tuple[Floats, Floats, Bools]:
        """Way and turn `(m,)` over the spans, and whether they are known."""
        gaps = np.concatenate([[0], np.cumsum(np.diff(self.stamp_s) > self.gap_s)])
        first = np.searchsorted(self.stamp_s, from_s, side="right") - 1
        last = np.searchsorted(self.stamp_s, to_s, side="left")
        known = (first >= 0) & (last < len(self.stamp_s))
        first, last = np.clip(first, 0, len(self) - 1), np.clip(last, 0, len(self) - 1)
        known &= gaps[first] == gaps[last]
        way = np.interp(to_s, self.stamp_s, self.path_m) - np.interp(
            from_s, self.stamp_s, self.path_m
        )
        turn = np.interp(to_s, self.stamp_s, self.heading_rad) - np.interp(
            from_s, self.stamp_s, self.heading_rad
        )
        return way, turn, known


def of_odometry(odometry: OdometryStream, name: str = "odometry") -> Odometer:
    """Wheel odometry, by the trapezoid rule."""
    return Odometer(
        name,
        odometry.stamp_s,
        _summed(odometry.stamp_s, odometry.speed_mps),
        _summed(odometry.stamp_s, odometry.yaw_rate_radps),
        gap_s=1.0,
        smooth_s=0.5,
    )


def of_reference(reference: ReferenceStream, name: str = "reference") -> Odometer:
    """Reference poses: the way is what of each step lies along the yaw."""
    yaw = np.unwrap(reference.poses[:, 2])
    step = np.diff(reference.poses[:, :2], axis=0)
    middle = 0.5 * (yaw[1:] + yaw[:-1])
    along = rotate_back(step, middle)[:, 0]
    path = np.concatenate([[0.0], np.cumsum(along)])
    return Odometer(name, reference.stamp_s, path, yaw, gap_s=1.0, smooth_s=0.5)


def of_places(name: str, stamps_s: Floats, points_m: Floats, chord_s: float) -> Odometer | None:
    """Places without a heading: chords over `chord_s` give way and course; None if too few.

    The course is held while the car is too slow for its chords to stand out of the noise.
    """
    if not len(stamps_s):
        return None
    # the first place of each span: a stream of places at a high rate is thinned
    keep = np.unique(np.floor((stamps_s - stamps_s[0]) / chord_s), return_index=True)[1]
    stamps, points = stamps_s[keep], points_m[keep]
    usable = np.isfinite(points).all(axis=1)
    stamps, points = stamps[usable], points[usable]
    if len(stamps) < 4:
        return None
    step = np.diff(points, axis=0)
    length = np.hypot(step[:, 0], step[:, 1])
    course = np.arctan2(step[:, 1], step[:, 0])
    turn = wrap_angle(np.diff(course))
    # the turn between two chords lies around the place between them
    heading = np.concatenate([[0.0, 0.0], np.cumsum(turn)])
    middle = np.concatenate([[stamps[0]], 0.5 * (stamps[1:] + stamps[:-1])])
    path = np.concatenate([[0.0], np.cumsum(length)])
    return Odometer(
        name,
        stamps,
        path,
        np.interp(stamps, middle, heading),
        gap_s=3.0 * chord_s + 1.0,
        smooth_s=2.0 * chord_s,
    )


def of_gnss(gnss: GnssStream, name: str = "fixes") -> Odometer | None:
    """GNSS fixes, by chords of two seconds: over less than that their noise outweighs the way."""
    points = np.stack([gnss.east_m, gnss.north_m], axis=1)
    return of_places(name, gnss.stamp_s, points, 2.0)


def common_spans(first: Odometer, second: Odometer, span_s: float) -> tuple[Floats, ...]:
    """Ways and turns of both over the spans that both know: four arrays `(m,)`."""
    start = max(first.stamp_s[0], second.stamp_s[0])
    from_s = span_starts(first if len(first) <= len(second) else second, span_s, start)
    way_a, turn_a, known_a = first.spans(from_s, from_s + span_s)
    way_b, turn_b, known_b = second.spans(from_s, from_s + span_s)
    both = known_a & known_b
    return way_a[both], turn_a[both], way_b[both], turn_b[both]


def span_starts(track: Odometer, span_s: float, start_s: float | None = None) -> Floats:
    """Starts `(m,)` of the spans in which the track has a stamp: a gap of a day has none."""
    start = track.stamp_s[0] if start_s is None else start_s
    number = np.unique(np.floor((track.stamp_s - start) / span_s))
    return np.asarray(start + span_s * number[number >= 0])


def _summed(stamps: Floats, rates: Floats) -> Floats:
    step = 0.5 * (rates[1:] + rates[:-1]) * np.diff(stamps)
    return np.concatenate([[0.0], np.cumsum(step)])
