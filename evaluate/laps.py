"""Which parts of a drive are passes over the same road: from laps.csv, or found in its track.

Walking along the track, two metres at a time, a place is new or it was passed before in the same
direction. The new places are stretches of road; every coherent run over a stretch is a pass. A
closed course driven six times is one stretch with six passes; a tour through a town is many
stretches, those with at least two passes count.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import scipy
from numpy.typing import NDArray

from polemap.evaluation.meanpath import MeanPath, mean_path
from polemap.vehicle.pose import wrap_angle
from polemap.vehicle.trajectory import Trajectory

Floats = NDArray[np.float64]

STEP_M = 2.0
SAME_ROAD_M = 8.0
SAME_DIRECTION_RAD = np.radians(40.0)
RETURN_M = 40.0
MIN_LENGTH_M = 30.0
BRIDGED_M = 60.0
COMPLETE_SHARE = 0.9
_HEADING_BASE = 2


@dataclass(frozen=True, slots=True)
class Span:
    """A stretch of time in one recording; `source` counts the recordings of a route."""

    source: int
    start_s: float
    end_s: float
    name: str = ""


@dataclass(frozen=True, slots=True)
class Stretch:
    """A road and the passes over it, in the order in which they were driven.

    Attributes:
        path: mean path of the passes.
        passes: at least two.
        starts_m: `(n,)` station at which each pass enters.
        whole_laps: the passes are whole laps (closed course, or named in laps.csv).
    """

    path: MeanPath
    passes: tuple[Span, ...]
    starts_m: Floats
    whole_laps: bool


@dataclass(frozen=True, slots=True)
class _Track:
    """The tracks of all sources behind one another, one point every `STEP_M`."""

    source: NDArray[np.int64]
    stamp_s: Floats
    points_m: Floats
    heading_rad: Floats
    travelled_m: Floats


def find_stretches(tracks: Sequence[Trajectory], named: Sequence[Span] = ()) -> list[Stretch]:
    """Stretches of road with at least two passes, longest first.

    Args:
        tracks: one trajectory a recording, all in one frame.
        named: laps of laps.csv. They are used if at least two of them cover the same course;
            otherwise the passes are found in the tracks.
    """
    if len(named) >= 2:
        stretch = _from_named(tracks, named)
        if stretch is not None:
            return [stretch]
    return _from_tracks(tracks)


def road_length_m(tracks: Sequence[Trajectory]) -> float:
    """Length of the road under the tracks, however often and in whichever direction driven."""
    track = _resampled(tracks)
    if len(track.stamp_s) == 0:
        return 0.0
    tree = scipy.spatial.KDTree(track.points_m)
    fresh = 0
    for i, near in enumerate(tree.query_ball_point(track.points_m, SAME_ROAD_M)):
        earlier = np.asarray(near, dtype=np.int64)
        earlier = earlier[earlier < i]
        gap = track.travelled_m[i] - track.travelled_m[earlier]
        fresh += not np.any((gap > RETURN_M) | (track.source[earlier] != track.source[i]))
    return fresh * STEP_M


def _from_named(tracks: Sequence[Trajectory], named: Sequence[Span]) -> Stretch | None:
    """The named laps as one stretch, or None where they are not laps of one course."""
    parts = [tracks[lap.source].between(lap.start_s, lap.end_s) for lap in named]
    keep = [i for i, part in enumerate(parts) if _length(part) >= MIN_LENGTH_M]
    if len(keep) < 2:
        return None
    lengths = [_length(parts[i]) for i in keep]
    middle = keep[int(np.argsort(lengths)[len(lengths) // 2])]
    course = scipy.spatial.KDTree(_resampled([parts[middle]]).points_m)
    alike = []
    for i in keep:
        points = _resampled([parts[i]]).points_m
        there = course.query(points, distance_upper_bound=SAME_ROAD_M)[0]
        back = scipy.spatial.KDTree(points).query(course.data, distance_upper_bound=SAME_ROAD_M)[0]
        if min(np.isfinite(there).mean(), np.isfinite(back).mean()) >= 0.8:
            alike.append(i)
    if len(alike) < 2:
        return None
    path = mean_path([parts[i] for i in alike])
    return Stretch(path, tuple(named[i] for i in alike), np.zeros(len(alike)), True)


def _from_tracks(tracks: Sequence[Trajectory]) -> list[Stretch]:
    track = _resampled(tracks)
    if len(track.stamp_s) < 2 * MIN_LENGTH_M / STEP_M:
        return []
    home = _homes(track)
    new = home == np.arange(len(home))
    stretches: list[Stretch] = []
    for first, last in _runs(new, track.source, 1):
        if (last - first) * STEP_M < MIN_LENGTH_M:
            continue
        passes = _passes_over(track, home, first, last)
        stretches.extend(_cut(tracks, track, first, passes))
    return sorted(stretches, key=lambda stretch: -stretch.path.length_m)


def _homes(track: _Track) -> NDArray[np.int64]:
    """For every point the first-driven point of the same place and direction, `(n,)`."""
    tree = scipy.spatial.KDTree(track.points_m)
    home = np.arange(len(track.points_m))
    is_new = np.ones(len(home), dtype=bool)
    for i, near in enumerate(tree.query_ball_point(track.points_m, SAME_ROAD_M)):
        candidates = np.asarray(near, dtype=np.int64)
        candidates = candidates[candidates < i]
        candidates = candidates[is_new[candidates]]
        gap = track.travelled_m[i] - track.travelled_m[candidates]
        turned = wrap_angle(track.heading_rad[i] - track.heading_rad[candidates])
        elsewhere = (gap > RETURN_M) | (track.source[candidates] != track.source[i])
        candidates = candidates[elsewhere & (np.abs(turned) < SAME_DIRECTION_RAD)]
        if len(candidates):
            away = np.sum((track.points_m[candidates] - track.points_m[i]) ** 2, axis=1)
            home[i] = candidates[int(np.argmin(away))]
            is_new[i] = False
    return home


def _passes_over(
    track: _Track, home: NDArray[np.int64], first: int, last: int
) -> list[tuple[int, int, int, int]]:
    """Passes as (first point, last point, first station, last station), all inclusive."""
    found: list[tuple[int, int, int, int]] = [(first, last, 0, last - first)]
    rows = np.flatnonzero((home >= first) & (home <= last) & (home != np.arange(len(home))))
    if len(rows) == 0:
        return found
    station = home[rows] - first
    step = np.diff(rows)
    moved = np.diff(station)
    # A run ends where the car leaves for long, changes recording, or starts the course anew.
    broken = (step * STEP_M > BRIDGED_M) | (np.diff(track.source[rows]) != 0)
    broken |= (moved < -RETURN_M / 2 / STEP_M) | (moved > step + BRIDGED_M / STEP_M)
    for part in np.split(np.arange(len(rows)), np.flatnonzero(broken) + 1):
        low, high = int(station[part].min()), int(station[part].max())
        if (high - low) * STEP_M >= MIN_LENGTH_M:
            found.append((int(rows[part[0]]), int(rows[part[-1]]), low, high))
    return sorted(found)


def _cut(
    tracks: Sequence[Trajectory],
    track: _Track,
    first: int,
    passes: list[tuple[int, int, int, int]],
) -> list[Stretch]:
    """Cut a road where passes join or leave, so that every piece has the same passes throughout.

    Ends closer to one another than `BRIDGED_M / 2` (on short roads a quarter of the road, on long
    ones a tenth) are one place.
    """
    if len(passes) < 2:
        return []
    length = passes[[p[0] for p in passes].index(first)][3]
    tolerance = max(min(BRIDGED_M / 2 / STEP_M, length / 4), (1.0 - COMPLETE_SHARE) * length)
    ends = sorted({0, length} | {p[2] for p in passes} | {p[3] for p in passes})
    cuts = [ends[0]]
    for end in ends[1:]:
        if end - cuts[-1] > tolerance:
            cuts.append(end)
    cuts[-1] = max(cuts[-1], length) if length - cuts[-1] <= tolerance else cuts[-1]
    pieces = []
    for low, high in pairwise(cuts):
        members = [p for p in passes if p[2] <= low + tolerance and p[3] >= high - tolerance]
        if len(members) < 2 or (high - low) * STEP_M < MIN_LENGTH_M:
            continue
        pieces.append(_stretch(tracks, track, members, low, high, len(cuts) == 2))
    return pieces


def _stretch(
    tracks: Sequence[Trajectory],
    track: _Track,
    members: list[tuple[int, int, int, int]],
    low: int,
    high: int,
    whole: bool,
) -> Stretch:
    spans, parts, starts = [], [], []
    for number, (begin, end, start, stop) in enumerate(members, start=1):
        # The pass between the two cuts, by the share of its points: refined by the projection.
        rows = np.arange(begin, end + 1)
        share = (rows - begin) / max(end - begin, 1)
        place = start + share * (stop - start)
        inside = rows[(place >= low - 2) & (place <= high + 2)]
        source = int(track.source[begin])
        name = f"{'lap' if whole else 'pass'} {number}"
        begin_s, end_s = float(track.stamp_s[inside[0]]), float(track.stamp_s[inside[-1]])
        spans.append(Span(source, begin_s, end_s, name))
        starts.append(max(float(place[inside[0] - begin]) - low, 0.0) * STEP_M)
        parts.append(tracks[source].between(begin_s, end_s))
    return Stretch(mean_path(parts), tuple(spans), np.array(starts), whole)


def _resampled(tracks: Sequence[Trajectory]) -> _Track:
    sources, stamps, points, headings, travelled = [], [], [], [], []
    for number, one in enumerate(tracks):
        if len(one) < 2:
            continue
        length = one.travelled_m()
        moving = np.concatenate([[True], np.diff(length) > 1e-9])
        even = np.arange(0.0, length[-1], STEP_M)
        stamp = np.interp(even, length[moving], one.stamp_s[moving])
        line = np.column_stack(
            [np.interp(even, length[moving], one.poses[moving, axis]) for axis in (0, 1)]
        )
        ahead = line[np.minimum(np.arange(len(line)) + _HEADING_BASE, len(line) - 1)]
        behind = line[np.maximum(np.arange(len(line)) - _HEADING_BASE, 0)]
        sources.append(np.full(len(even), number))
        stamps.append(stamp)
        points.append(line)
        headings.append(np.arctan2(*(ahead - behind).T[::-1]))
        travelled.append(even)
    if not sources:
        empty = np.empty(0)
        return _Track(np.empty(0, dtype=np.int64), empty, np.empty((0, 2)), empty, empty)
    return _Track(
        np.concatenate(sources),
        np.concatenate(stamps),
        np.concatenate(points),
        np.concatenate(headings),
        np.concatenate(travelled),
    )


def _runs(mask: NDArray[np.bool_], source: NDArray[np.int64], bridge: int) -> list[tuple[int, int]]:
    """First and last row (inclusive) of every run of true rows within one source."""
    rows = np.flatnonzero(mask)
    if len(rows) == 0:
        return []
    broken = (np.diff(rows) > bridge) | (np.diff(source[rows]) != 0)
    parts = np.split(rows, np.flatnonzero(broken) + 1)
    return [(int(part[0]), int(part[-1])) for part in parts]


def _length(track: Trajectory) -> float:
    return float(track.travelled_m()[-1]) if len(track) > 1 else 0.0
