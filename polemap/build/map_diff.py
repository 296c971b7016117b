"""Two maps compared: which landmarks were added, removed and moved."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from polemap.build.registration import NO_SHIFT, Shift, register
from polemap.drivelog.frames import require_same_frame
from polemap.map.line_map import LineMap
from polemap.map.pole_map import KIND_COLUMN, PoleMap, join_maps

Floats = NDArray[np.float64]
Whole = NDArray[np.int64]

SAME_M = 0.75
MOVED_M = 3.0
LINE_SAME_M = 0.5
CHANGE, DISTANCE = "change", "moved_m"


@dataclass(frozen=True, slots=True)
class MapDiff:
    """Rows of two maps: `same` and `moved` `(k, 2)` in both, `added` and `removed` in one.

    `lines_added` and `lines_removed` are rows of lines, `lines_same` how many are as before.
    `shift` is what lays the second map onto the first where they disagree as a whole.
    """

    same: Whole
    moved: Whole
    added: Whole
    removed: Whole
    shift: Shift
    lines_added: Whole
    lines_removed: Whole
    lines_same: int


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

    Points of a kind within 0.75 m of each other are the same; of the rest, one that is gone and one
    that is new within 3 m are one that moved. A line is as before where half of its length lies
    within 0.5 m of lines of its kind. With `align` a common shift is taken away first.

    Raises:
        FrameError: the maps are in different frames.
    """
    require_same_frame(before.frame, after.frame, "the first map", "the second map")
    shift = register(after.points_m, before.points_m, MOVED_M)
    shift = shift if shift.significant else NO_SHIFT
    points = shift.points(after.points_m) if align else after.points_m
    kinds = before.kind, after.kind
    same = _matched(before.points_m, points, SAME_M, *kinds)
    gone = np.setdiff1d(np.arange(len(before)), same[:, 0])
    new = np.setdiff1d(np.arange(len(after)), same[:, 1])
    moved = _matched(before.points_m[gone], points[new], MOVED_M, kinds[0][gone], kinds[1][new])
    moved = np.stack([gone[moved[:, 0]], new[moved[:, 1]]], axis=1)
    old, now = (one.lines or LineMap.empty(one.frame) for one in (before, after))
    if align:
        now = now.with_columns(vertices_m=shift.points(now.vertices_m))
    stay = _followed(old, now)
    return MapDiff(
        same,
        moved,
        np.setdiff1d(new, moved[:, 1]),
        np.setdiff1d(gone, moved[:, 0]),
        shift,
        np.flatnonzero(~_followed(now, old)),
        np.flatnonzero(~stay),
        int(np.count_nonzero(stay)),
    )


def _matched(
    first_m: Floats,
    second_m: Floats,
    most_m: float,
    kinds: NDArray[np.int8],
    others: NDArray[np.int8],
) -> Whole:
    """`match_points` within each kind."""
    pairs = [np.empty((0, 2), dtype=np.int64)]
    for kind in np.intersect1d(kinds, others):
        a, b = np.flatnonzero(kinds == kind), np.flatnonzero(others == kind)
        found = match_points(first_m[a], second_m[b], most_m)
        pairs.append(np.stack([a[found[:, 0]], b[found[:, 1]]], axis=1))
    return np.concatenate(pairs)


def _followed(lines: LineMap, others: LineMap) -> NDArray[np.bool_]:
    """Which lines `(n,)` have others of their kind beside half of their length."""
    import shapely  # not at the top, where --help would wait for it

    shapes = _shapes(lines)
    followed = np.zeros(len(lines), dtype=bool)
    for kind in np.unique(lines.kind):
        mine, rows = lines.kind == kind, others.kind == kind
        near = shapely.union_all(shapely.buffer(_shapes(others)[rows], LINE_SAME_M))
        inside = shapely.length(shapely.intersection(shapes[mine], near))
        followed[mine] = inside >= 0.5 * shapely.length(shapes[mine])
    return followed


def _shapes(lines: LineMap) -> NDArray[Any]:
    import shapely

    rows = [lines.polyline_m(row) for row in range(len(lines))]
    return np.array([shapely.linestrings(points) for points in rows], dtype=object)


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
    if KIND_COLUMN in part.extra:
        extra[KIND_COLUMN] = part.extra[KIND_COLUMN]
    return replace(part, extra=extra, doubtful=None, lines=None)
