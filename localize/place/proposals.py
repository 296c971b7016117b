"""Where the map has patterns like those of the local map: triangles looked up, poses voted for."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from polemap.localize.place.local_map import LocalMap
from polemap.map.pattern_index.index import PatternIndex
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
_REACHED_SD = 2.0  # sides are asked for within so many standard deviations
_HITS_MOST = 60_000
_BIN_M = 3.0
_YAWS = 64  # bins of a full turn


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
    asked, sd = _asked(local, float(np.median(index.sd_m[:1000])) if len(index) else 0.0)
    if not len(asked) or not index.triangles:
        return none
    tolerance = _REACHED_SD * sd
    low = quantised(asked.sides_m - tolerance)
    high = quantised(asked.sides_m + tolerance)
    first, stop, query = index.ranges(low, high)
    count = np.bincount(query, stop - first, minlength=len(asked)).astype(np.int64)
    order = np.argsort(count, kind="stable")
    order = order[count[order] > 0]
    order = order[np.cumsum(count[order]) <= _HITS_MOST]
    chosen = np.zeros(len(asked), dtype=bool)
    chosen[order] = True
    if not chosen.any():
        return none
    hits = index.hits(first[chosen[query]], stop[chosen[query]], query[chosen[query]])
    centre = local.points_m.mean(axis=0)
    yaw = hits.direction_rad - asked.direction_rad[hits.query]
    corner = local.points_m[asked.corners[hits.query, 0]]
    place = index.points_m[hits.pole] + rotate(centre - corner, yaw)
    rarity = np.log(max(index.triangles, 2) / np.maximum(count, 1))
    poses, votes = _counted(place, wrap_angle(yaw), np.maximum(rarity[hits.query], 0.1), most)
    poses[:, :2] += rotate(-centre, poses[:, 2])
    return Proposals(poses, votes)


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
    along = along / np.maximum(np.hypot(along[..., 0], along[..., 1]), 1e-9)[..., np.newaxis]
    spread = local.covariance_m2[begin] + local.covariance_m2[end]
    own = np.einsum("nsi,nsij,nsj->ns", along, spread, along)
    moved = np.einsum("nsi,nsia->nsa", along, local.drift[end] - local.drift[begin])
    lasting = np.einsum("nsa,ab,nsb->ns", moved, local.drift_covariance, moved)
    return np.asarray(np.sqrt(own + lasting + 2.0 * map_sd_m**2 + QUANTUM_M**2 / 12.0))


def _counted(place: Floats, yaw: Floats, weight: Floats, most: int) -> tuple[Floats, Floats]:
    """Mean poses `(m, 3)` of the bins with the most votes, and these."""
    origin = place.min(axis=0) - _BIN_M
    values = np.column_stack([place - origin, np.ones(len(place))]) * weight[:, np.newaxis]
    poses, votes = [], []
    # what a border cuts in one grid lies whole in a grid that is shifted by half a bin
    for shift in (0.0, 0.5):
        column = np.floor((place - origin) / _BIN_M + shift).astype(np.int64)
        turn = (yaw + np.pi) * (_YAWS / (2.0 * np.pi)) + shift
        bin_yaw = np.floor(turn).astype(np.int64)
        row = column[:, 0] * (column[:, 1].max() + 1) + column[:, 1]
        key = row * _YAWS + bin_yaw % _YAWS
        order = np.argsort(key)
        key = key[order]
        first = np.flatnonzero(np.concatenate([[True], key[1:] != key[:-1]]))
        east, north, total = np.add.reduceat(values[order], first, axis=0).T
        rest = np.add.reduceat((weight * (turn - bin_yaw))[order], first)
        best = np.argsort(-total, kind="stable")[:most]
        mean = (key[first[best]] % _YAWS + rest[best] / total[best] - shift) / _YAWS
        poses.append(
            np.column_stack(
                [
                    origin[0] + east[best] / total[best],
                    origin[1] + north[best] / total[best],
                    wrap_angle(2.0 * np.pi * mean - np.pi),
                ]
            )
        )
        votes.append(total[best])
    return np.concatenate(poses), np.concatenate(votes)
