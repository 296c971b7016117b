"""Two maps compared: which poles were added, removed and moved."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import scipy
from numpy.typing import NDArray

from polemap.build.registration import NO_SHIFT, Shift, register
from polemap.drivelog.frames import require_same_frame
from polemap.map.pole_map import PoleMap, join_maps

Floats = NDArray[np.float64]
Whole = NDArray[np.int64]

SAME_M = 0.75
MOVED_M = 3.0
CHANGE, DISTANCE = "change", "moved_m"


@dataclass(frozen=True, slots=True)
class MapDiff:
    """Rows of two maps: `same` and `moved` `(k, 2)` in both, `added` and `removed` in one.

    `shift` is what lays the second map onto the first where they disagree as a whole.
    """

    same: Whole
    moved: Whole
    added: Whole
    removed: Whole
    shift: Shift


def match_points(first_m: Floats, second_m: Floats, most_m: float) -> Whole:
    """One-to-one pairs `(k, 2)` of points no farther apart than `most_m`, of least total distance.

    Groups of points that are linked by possible pairs are solved one by one, so that whole cities
    can be matched.
    """
    none = np.empty((0, 2), dtype=np.int64)
    if not len(first_m) or not len(second_m):
        return none

    near = scipy.spatial.KDTree(first_m).sparse_distance_matrix(
        scipy.spatial.KDTree(second_m), most_m, output_type="ndarray"
    )
    if not len(near):
        return none
    a, b, distance = near["i"].astype(np.int64), near["j"].astype(np.int64), near["v"]
    n = len(first_m) + len(second_m)
    graph = scipy.sparse.coo_matrix((np.ones(len(a)), (a, b + len(first_m))), shape=(n, n))
    _, group = scipy.sparse.csgraph.connected_components(graph, directed=False)
    order = np.argsort(group[a], kind="stable")
    bounds = np.flatnonzero(np.diff(group[a][order], prepend=-1, append=n + 1))
    pairs = []
    for start, end in pairwise(bounds.tolist()):
        links = order[start:end]
        rows, row_of = np.unique(a[links], return_inverse=True)
        columns, column_of = np.unique(b[links], return_inverse=True)
        cost = np.full((len(rows), len(columns)), 1e6)
        cost[row_of, column_of] = distance[links]
        i, j = scipy.optimize.linear_sum_assignment(cost)
        good = cost[i, j] < 1e6
        pairs.append(np.stack([rows[i[good]], columns[j[good]]], axis=1))
    return np.concatenate(pairs)


def compare_maps(before: PoleMap, after: PoleMap, *, align: bool = False) -> MapDiff:
    """What changed from one map to the other.

    Poles within 0.75 m of each other are the same; of the rest, one that is gone and one that is
    new within 3 m are one that moved. With `align` a common shift is taken away first.

    Raises:
        FrameError: the maps are in different frames.
    """
    require_same_frame(before.frame, after.frame, "the first map", "the second map")
    shift = register(after.points_m, before.points_m, MOVED_M)
    shift = shift if shift.significant else NO_SHIFT
    points = shift.points(after.points_m) if align else after.points_m
    same = match_points(before.points_m, points, SAME_M)
    gone = np.setdiff1d(np.arange(len(before)), same[:, 0])
    new = np.setdiff1d(np.arange(len(after)), same[:, 1])
    moved = match_points(before.points_m[gone], points[new], MOVED_M)
    moved = np.stack([gone[moved[:, 0]], new[moved[:, 1]]], axis=1)
    return MapDiff(
        same,
        moved,
        np.setdiff1d(new, moved[:, 1]),
        np.setdiff1d(gone, moved[:, 0]),
        shift,
    )


def diff_map(before: PoleMap, after: PoleMap, diff: MapDiff) -> PoleMap:
    """The changes as a map: column `change` says which, `moved_m` how far."""
    parts = [
        _marked(before.rows(diff.removed), "removed", np.nan),
        _marked(after.rows(diff.added), "added", np.nan),
    ]
    offset = after.points_m[diff.moved[:, 1]] - before.points_m[diff.moved[:, 0]]
    parts.append(_marked(after.rows(diff.moved[:, 1]), "moved", np.hypot(*offset.T)))
    return join_maps(join_maps(parts[0], parts[1]), parts[2])


def _marked(part: PoleMap, change: str, distance_m: Floats | float) -> PoleMap:
    n = len(part)
    extra = {CHANGE: np.full(n, change), DISTANCE: np.broadcast_to(distance_m, n).astype(float)}
    return replace(part, extra=extra, doubtful=None)
