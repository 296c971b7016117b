"""Where the map has patterns like those of the local map: triangles looked up, poses voted for."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from polemap.localize.place.local_map import WANDER, LocalMap
from polemap.map.pattern_index.index import DIRECTIONS, PatternIndex
from polemap.map.pattern_index.triples import (
    QUANTUM_M,
    Triangles,
    neighbour_triples,
    oriented,
    quantised,
    side_lengths,
    triangles,
)
from polemap.vehicle.pose import rotate, wrap_angle

Floats = NDArray[np.float64]
Whole = NDArray[np.int64]

NEIGHBOURS = 8
"""Of which pairs are taken: more than in the map, since some of them are false and some lacking."""
_SIDE_SD_MOST_M = 0.4
# sides are asked for within so many standard deviations; in maps of more triangles within fewer:
# one triangle's hits grow with the cube, and of many triangles more hits are true ones
_REACHED_SD, _REACHED_SD_LEAST, _WIDELY = 2.0, 1.0, 1_000_000
_HITS_MOST = 120_000
_BIN_M = 3.0
_YAW_BITS = 6
_YAWS = 2**_YAW_BITS  # bins of a full turn
_SLOTS = 2**18
_STEPS = 1000
_SCATTER = 0x9E3779B97F4A7C15 - 2**64  # the golden ratio, as 64 bits


@dataclass(frozen=True, slots=True)
class Proposals:
    """Poses `(m, 3)` of the vehicle in the map that triangles vote for, and how much they do."""

    poses: Floats
    votes: Floats


def propose(index: PatternIndex, local: LocalMap, most: int) -> Proposals:
    """The poses of the vehicle that most triangles of a local map speak for.

    Triangles that the map has seldom are looked up first and count most, by the logarithm of their
    rarity; those that regular rows repeat everywhere may not be looked up at all.
    """
    none = Proposals(np.empty((0, 3)), np.empty(0))
    asked, sd = _asked(local, index.sd_typical_m)
    if not len(asked) or not index.triangles:
        return none
    tolerance = _reached_sd(index.triangles) * sd
    low = quantised(asked.sides_m - tolerance)
    high = quantised(asked.sides_m + tolerance)
    first, stop, query = index.ranges(low, high)
    count = np.bincount(query, stop - first, minlength=len(asked)).astype(np.int64)
    chosen = _chosen(asked.corners, count)
    if not chosen.any():
        return none
    kept = chosen[query]
    hits = index.hits(first[kept], stop[kept], query[kept])
    centre = local.points_m.mean(axis=0)
    rarity = np.log(max(index.triangles, 2) / np.maximum(count, 1)).clip(0.1)
    # a hit lays the corner onto a pole of the map, and turns the arm from it to the centre along
    arm = rotate(centre - local.points_m[asked.corners[:, 0]], -asked.direction_rad)
    turned = 2.0 * np.pi / DIRECTIONS * hits.direction
    place = np.take(index.points_m, hits.pole, axis=0) + rotate(arm[hits.query], turned)
    yaw = wrap_angle(turned - asked.direction_rad[hits.query])
    poses, votes = _counted(place, yaw, rarity[hits.query], most)
    poses[:, :2] += rotate(-centre, poses[:, 2])
    return Proposals(poses, votes)


def _reached_sd(triangles_mapped: int) -> float:
    """So that the hits of a triangle are as many in every map that has more than `_WIDELY`."""
    fewer = float(np.cbrt(_WIDELY / max(triangles_mapped, _WIDELY)))
    return max(_REACHED_SD * fewer, _REACHED_SD_LEAST)


def _chosen(corners: Whole, count: Whole) -> NDArray[np.bool_]:
    """Which triangles `(n,)` are looked up: of every pole its rarest, in turn, up to a sum of hits.

    The rarest of all would be those of false poles, which fit nowhere.
    """
    pole = corners.reshape(-1)
    triangle = np.repeat(np.arange(len(corners)), 3)
    order = np.lexsort((triangle, count[triangle], pole))
    pole, triangle = pole[order], triangle[order]
    first = np.searchsorted(pole, pole)
    turn = np.arange(len(pole)) - first
    by_turn = np.lexsort((count[triangle], turn))
    triangle = triangle[by_turn]
    _, earliest = np.unique(triangle, return_index=True)
    asked = triangle[np.sort(earliest)]
    asked = asked[count[asked] > 0]
    asked = asked[np.cumsum(count[asked]) <= _HITS_MOST]
    chosen = np.zeros(len(corners), dtype=bool)
    chosen[asked] = True
    return chosen


def _asked(local: LocalMap, map_sd_m: float) -> tuple[Triangles, Floats]:
    """Triangles of a local map, in every form that errors may give them, and their sides' sd."""
    points = local.points_m
    found = triangles(points, neighbour_triples(points, NEIGHBOURS))
    sd = _side_sd(local, found.corners, map_sd_m)
    sure = np.asarray((sd < _SIDE_SD_MOST_M).all(axis=1))
    found, sd = found.take(sure), sd[sure]
    corners = [found.corners]
    for turn in (1, 2):
        slack = _REACHED_SD * np.hypot(sd[:, 0], sd[:, turn])
        rows = found.sides_m[:, turn] > found.sides_m[:, 0] - slack
        corners.append(np.roll(found.corners[rows], -turn, axis=1))
    turned = np.concatenate(corners)
    # of a flat triangle, errors may put the third corner on the other side
    base, tip = (
        points[turned[:, 1]] - points[turned[:, 0]],
        points[turned[:, 2]] - points[turned[:, 0]],
    )
    length = np.hypot(base[:, 0], base[:, 1])
    height = np.abs(base[:, 0] * tip[:, 1] - base[:, 1] * tip[:, 0]) / np.maximum(length, 1e-9)
    flat = height < _REACHED_SD * np.sqrt(2.0) * 0.5 * _SIDE_SD_MOST_M
    turned = np.concatenate([turned, turned[flat][:, [1, 0, 2]]])
    asked = oriented(points, turned, side_lengths(points, turned))
    return asked, _side_sd(local, turned, map_sd_m)


def _side_sd(local: LocalMap, corners: Whole, map_sd_m: float) -> Floats:
    """Standard deviation `(n, 3)` of the sides of triangles, against those of the map."""
    begin, end = corners, np.roll(corners, -1, axis=1)
    along = local.points_m[end] - local.points_m[begin]
    length = np.hypot(along[..., 0], along[..., 1])
    along = along / np.maximum(length, 1e-9)[..., np.newaxis]
    spread = local.covariance_m2[begin] + local.covariance_m2[end]
    own = np.einsum("nsi,nsij,nsj->ns", along, spread, along)
    moved = np.einsum("nsi,nsia->nsa", along, local.drift[end] - local.drift[begin])
    lasting = np.einsum("nsa,ab,nsb->ns", moved, local.drift_covariance, moved)
    known = 2.0 * map_sd_m**2 + QUANTUM_M**2 / 12.0
    return np.asarray(np.sqrt(own + lasting + (WANDER * length) ** 2 + known))


def _counted(place: Floats, yaw: Floats, weight: Floats, most: int) -> tuple[Floats, Floats]:
    """Mean poses `(m, 3)` of the bins with the most votes, and these."""
    origin = place.min(axis=0) - _BIN_M
    cell = (place - origin) / _BIN_M
    turned = (yaw + np.pi) * (_YAWS / (2.0 * np.pi))
    poses, votes = [], []
    # what a border cuts in one grid lies whole in a grid that is shifted by half a bin
    for shift in (0.0, 0.5):
        column = (cell + shift).astype(np.int64)
        turn = turned + shift
        bin_yaw = turn.astype(np.int64)
        key = (column[:, 0] << 32) | (column[:, 1] << _YAW_BITS) | (bin_yaw & (_YAWS - 1))
        rows = _crowded(key, weight, most)
        order = rows[np.argsort(key[rows], kind="stable")]
        key = key[order]
        first = np.flatnonzero(np.concatenate([[True], key[1:] != key[:-1]]))
        w = weight[order]
        part = turn[order] - bin_yaw[order]
        values = np.column_stack([place[order] - origin, part, np.ones(len(w))])
        east, north, rest, total = np.add.reduceat(values * w[:, np.newaxis], first, axis=0).T
        best = np.argsort(-total, kind="stable")[:most]
        total = total[best]
        mean = ((key[first[best]] & (_YAWS - 1)) + rest[best] / total - shift) / _YAWS
        middle = origin + np.column_stack([east[best], north[best]]) / total[:, np.newaxis]
        poses.append(np.column_stack([middle, wrap_angle(2.0 * np.pi * mean - np.pi)]))
        votes.append(total)
    return np.concatenate(poses), np.concatenate(votes)


def _crowded(key: Whole, weight: Floats, most: int) -> Whole:
    """Rows whose bins may be among the `most` with the most votes: all bins are counted in a table
    in which a few of them share a place, which is quicker than to order them."""
    slot = (key * _SCATTER >> 20) & (_SLOTS - 1)
    total = np.bincount(slot, weight, minlength=_SLOTS)
    step = max(float(total.max()), 1e-9) / _STEPS
    filled = np.bincount((total / step).astype(np.int64))
    enough = np.flatnonzero(np.cumsum(filled[::-1]) >= 4 * most)
    least = step * (len(filled) - 1 - enough[0]) if len(enough) else 0.0
    return np.flatnonzero(total[slot] >= max(least, 1e-9))
