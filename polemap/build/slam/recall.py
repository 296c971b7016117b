"""Places seen again where the graph does not know where to look: by the index of pole patterns.

Local maps are laid side by side, too far apart for their poles to form patterns together, and
indexed as any map is (`polemap.map.pattern_index`). The triangles of each are looked up among all
others; every hit is a pose of one local map in another, and poses vote. So the cost grows with
what looks alike, not with the pairs that there are.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from polemap.build.slam.submaps import Submap
from polemap.drivelog.frames import EarthFrame
from polemap.drivelog.landmark_kind import LandmarkKind
from polemap.map.pattern_index.build import build_index
from polemap.map.pattern_index.index import DIRECTIONS, PatternIndex
from polemap.map.pattern_index.triples import (
    neighbour_triples,
    oriented,
    quantised,
    side_lengths,
    triangles,
)
from polemap.map.pole_map import PoleMap
from polemap.vehicle.pose import rotate, wrap_angle

Floats = NDArray[np.float64]
Whole = NDArray[np.int64]

_APART_M = 500.0  # local maps span 60 m and what is seen beside
_NEIGHBOURS = 7  # more than the index takes, since some poles are seen once only
_SIDE_M = 0.3  # of a triangle's side against the same in another local map
_BIN_M, _BIN_RAD = 2.0, 0.1
_VOTES_LEAST = 3
_PLACES = 12  # of one local map that are returned


@dataclass(frozen=True, slots=True)
class Recalled:
    """Where a local map may lie on others, the likeliest first.

    Attributes:
        other: `(m,)` the numbers of these.
        poses: `(m, 3)` of the local map in each.
        votes: `(m,)` triangles that say so.
    """

    other: Whole
    poses: Floats
    votes: Whole

    def __len__(self) -> int:
        return len(self.other)


class Recall:
    """Looks local maps up among all local maps."""

    def __init__(self, submaps: Sequence[Submap]) -> None:
        self._index = _indexed(submaps)

    def find(self, submap: Submap) -> Recalled:
        """Where a local map may lie on others, or on itself."""
        points = submap.points_m[submap.kind == LandmarkKind.POLE]
        found = triangles(points, neighbour_triples(points, _NEIGHBOURS))
        corners = [found.corners]
        for turn in (1, 2):  # errors may make another side the longest
            near = found.sides_m[:, turn] > found.sides_m[:, 0] - 2.0 * _SIDE_M
            corners.append(np.roll(found.corners[near], -turn, axis=1))
        turned = np.concatenate(corners)
        asked = oriented(points, turned, side_lengths(points, turned))
        first, stop, query = self._index.ranges(
            quantised(asked.sides_m - _SIDE_M), quantised(asked.sides_m + _SIDE_M)
        )
        hits = self._index.hits(first, stop, query)
        turn_rad = 2.0 * np.pi / DIRECTIONS * hits.direction - asked.direction_rad[hits.query]
        there = np.take(self._index.points_m, hits.pole, axis=0)
        other = np.rint(there[:, 0] / _APART_M).astype(np.int64)
        corner = points[asked.corners[hits.query, 0]]
        place = there - rotate(corner, turn_rad)
        place[:, 0] -= other * _APART_M
        return _voted(other, np.column_stack([place, wrap_angle(turn_rad)]))


def mirrored(submap: Submap) -> Submap:
    """A local map that is as regular, and stands nowhere: what it reaches is chance."""
    flip = np.array([1.0, -1.0])
    return replace(submap, points_m=submap.points_m * flip, way_m=submap.way_m * flip)


def _indexed(submaps: Sequence[Submap]) -> PatternIndex:
    parts = [
        submap.points_m[submap.kind == LandmarkKind.POLE] + np.array([_APART_M * number, 0.0])
        for number, submap in enumerate(submaps)
    ]
    points = np.concatenate([np.empty((0, 2)), *parts])
    n = len(points)
    laid = PoleMap(
        frame=EarthFrame("local", name="local maps side by side"),
        ids=np.arange(n),
        points_m=points,
        covariance_m2=np.zeros((n, 2, 2)),
        width_m=np.full(n, np.nan),
        height_m=np.full(n, np.nan),
        observations=np.ones(n, dtype=np.int64),
        drives=np.ones(n, dtype=np.int64),
        existence=np.ones(n),
    )
    return build_index(laid)[0]


def _voted(other: Whole, poses: Floats) -> Recalled:
    """Means of the poses that agree, of every local map that they lie in."""
    none = Recalled(np.empty(0, dtype=np.int64), np.empty((0, 3)), np.empty(0, dtype=np.int64))
    if not len(other):
        return none
    others, means, votes = [], [], []
    # what a border cuts in one grid lies whole in a grid that is shifted by half a bin
    for shift in (0.0, 0.5):
        bins = np.floor(poses / (_BIN_M, _BIN_M, _BIN_RAD) + shift).astype(np.int64)
        _, owner, count = np.unique(
            np.column_stack([other, bins]), axis=0, return_inverse=True, return_counts=True
        )
        owner = owner.reshape(-1)
        for number in np.flatnonzero(count >= _VOTES_LEAST):
            rows = np.flatnonzero(owner == number)
            others.append(int(other[rows[0]]))
            means.append(poses[rows].mean(axis=0))
            votes.append(int(count[number]))
    if not others:
        return none
    order = np.argsort(-np.array(votes), kind="stable")
    chosen: list[int] = []
    for row in order.tolist():
        same = [
            k for k in chosen
            if others[k] == others[row]
            and np.hypot(*(means[k] - means[row])[:2]) < _BIN_M
            and abs(wrap_angle(means[k][2] - means[row][2])) < _BIN_RAD
        ]  # fmt: skip
        if not same:
            chosen.append(row)
        if len(chosen) == _PLACES:
            break
    return Recalled(
        np.array([others[k] for k in chosen]), np.array([means[k] for k in chosen]),
        np.array([votes[k] for k in chosen]),
    )  # fmt: skip
