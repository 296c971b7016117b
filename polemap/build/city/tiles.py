"""Merging spread over square tiles of the map's grid, with the same rows whatever the tiles.

Which landmarks become one pole is decided within a *group*: landmarks that are linked by steps of
at most `merge_max_m`. No step of the merging reaches beyond its group, so a tile that holds a whole
group merges it exactly as a single process would: rows keep their order, so that even the sums
round alike. A tile gets the landmarks of its square and of a margin around it, and owns the groups
whose southernmost member (then the westernmost, then the first row) lies in its square: each group
has one owner. An owned group that comes near the margin's edge may go on beyond it; then the tile
says so, and is given twice the margin.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from polemap.build.city.cutting import Key, LandmarkCut, ScanCut, places
from polemap.build.config import MappingConfig
from polemap.build.drive_observations import DriveObservations
from polemap.build.existence import RANGE_BINS, Visibility, count_scans, scan_weight
from polemap.build.georeference import MapDetections
from polemap.build.merge import (
    Merged,
    ReferenceError,
    close_pairs,
    cluster,
    fuse,
    measure_reference,
    number_from_south,
    revisit_pairs,
)
from polemap.build.traversals import TraversalLandmarks

Floats = NDArray[np.float64]
Whole = NDArray[np.int64]
Run = Callable[[Callable[[Any], Any], Sequence[Any]], list[Any]]

# edge of the tiles that workers merge: the rows do not depend on it, and a city has enough of 2 km
# to keep workers busy
TILE_M = 2000.0
_MARGIN = (
    8.0  # of a tile at first, in greatest steps of a group; a revisit pair reaches four steps far
)


@dataclass(frozen=True, slots=True)
class TileTask:
    """What a worker needs to merge one tile.

    Attributes:
        landmarks, cannot_link: of the square and its margin, rows in their global order.
        mine: `(k,)` landmarks in the square itself.
        inner: `(k,)` landmarks that are too far from the margin's edge to be linked beyond it.
        error: as measured over all tiles.
        views: for each drive its scans near the tile, for each detection there its landmark (-1:
            none of these), and how far the drive sees at most.
    """

    landmarks: TraversalLandmarks
    cannot_link: Whole
    mine: NDArray[np.bool_]
    inner: NDArray[np.bool_]
    config: MappingConfig
    error: ReferenceError | None = None
    views: tuple[tuple[MapDetections, Whole, float], ...] = ()


@dataclass(frozen=True, slots=True)
class TileResult:
    """The poles that a tile owns.

    Attributes:
        closed: whether all of them lie wholly inside; if not, the rest means nothing.
        owner: `(k,)` pole of each landmark of the task, -1 where another tile owns it.
        points_m, covariance_m2: `(n, 2)`, `(n, 2, 2)`.
        detected, expected: counts `(n, bins)` of each drive.
    """

    closed: bool
    owner: Whole
    points_m: Floats
    covariance_m2: Floats
    detected: tuple[Whole, ...]
    expected: tuple[Whole, ...]


def here(function: Callable[[Any], Any], tasks: Sequence[Any]) -> list[Any]:
    """Run tasks one after the other in this process."""
    return [function(task) for task in tasks]


def merge_tiles(
    landmarks: TraversalLandmarks,
    cannot_link: Whole,
    ordered: Sequence[DriveObservations],
    config: MappingConfig,
    drive_floor_m: float = 0.0,
    *,
    run: Run = here,
    tile_m: float | None = None,
) -> tuple[Merged, list[Visibility]]:
    """Join landmarks that are one pole, fuse them, and count who should have seen them.

    Args:
        landmarks: of all drives: those of `ordered` one after the other, then of an old map.
        cannot_link: pairs `(k, 2)` of rows, smaller first, that were seen side by side.
        ordered: the new drives, whose scans are counted.
        config: settings.
        drive_floor_m: what drives are known to disagree by at least, an axis.
        run: applies a function of this module to tasks, in the order of the tasks.
        tile_m: edge of the tiles; one tile for everything where none is given.

    Returns:
        Poles from south to north, and for each drive the counts at them.
    """
    cut = LandmarkCut(landmarks, cannot_link, tile_m)
    margin = _MARGIN * config.merge_max_m
    tasks = [_task(cut, key, margin, config) for key in cut.keys]
    found = run(pair_tile, [task for task, _ in tasks])
    pairs = [rows[pair] for pair, (_, rows) in zip(found, tasks, strict=True)]
    met = np.concatenate([np.empty((0, 2), dtype=np.int64), *pairs])
    error = measure_reference(landmarks, config, met[np.lexsort((met[:, 1], met[:, 0]))])
    error = replace(error, drive_sd_m=max(error.drive_sd_m, drive_floor_m))
    starts = np.cumsum([0, *(len(part.landmarks) for part in ordered)]).tolist()
    scans = [ScanCut(part, start, tile_m) for part, start in zip(ordered, starts, strict=False)]
    parts = _merge_all(cut, scans, config, error, margin, run)
    merged, place = _gather(parts, landmarks, error)
    counts = [
        Visibility(
            _counts([result.detected[row] for _, result in parts])[place],
            _counts([result.expected[row] for _, result in parts])[place],
            scan_weight(part.detections.views.stamp_s),
        )
        for row, part in enumerate(ordered)
    ]
    return merged, counts


def _task(
    cut: LandmarkCut, key: Key, margin_m: float, config: MappingConfig
) -> tuple[TileTask, Whole]:
    """A tile's task without its scans, and the global rows of its landmarks."""
    rows = cut.rows(key, margin_m)
    task = TileTask(
        cut.landmarks.take(rows),
        cut.cannot_link(rows),
        cut.core(key, rows),
        cut.inside(key, rows, margin_m - 1.001 * config.merge_max_m),
        config,
    )
    return task, rows


def _merge_all(
    cut: LandmarkCut,
    scans: Sequence[ScanCut],
    config: MappingConfig,
    error: ReferenceError,
    margin_m: float,
    run: Run,
) -> list[tuple[Whole, TileResult]]:
    """Results of all tiles; those whose groups are not closed again, with twice the margin."""
    done: list[tuple[Whole, TileResult]] = []
    open_keys = list(cut.keys)
    while open_keys:
        tasks, rows = [], []
        for key in open_keys:
            task, mine = _task(cut, key, margin_m, config)
            bounds = cut.bounds(key, margin_m)
            views = tuple(cut_scans.view(bounds, mine) for cut_scans in scans)
            tasks.append(replace(task, error=error, views=views))
            rows.append(mine)
        results = run(merge_tile, tasks)
        done += [(r, result) for r, result in zip(rows, results, strict=True) if result.closed]
        open_keys = [k for k, result in zip(open_keys, results, strict=True) if not result.closed]
        margin_m *= 2.0
    return done


def pair_tile(task: TileTask) -> Whole:
    """Pairs `(k, 2)` of landmarks of a tile by which the reference's error is measured."""
    pairs = revisit_pairs(task.landmarks, task.config, task.cannot_link)
    first = _southern(task.landmarks.points_m, pairs)
    return pairs[task.mine[first]]


def _southern(points: Floats, pairs: Whole) -> Whole:
    """The member of each pair that stands south, then west, of the other."""
    a, b = points[pairs[:, 0]], points[pairs[:, 1]]
    second = (b[:, 1] < a[:, 1]) | ((b[:, 1] == a[:, 1]) & (b[:, 0] < a[:, 0]))
    return np.asarray(np.where(second, pairs[:, 1], pairs[:, 0]))


def merge_tile(task: TileTask) -> TileResult:
    """Merge the groups of landmarks that a tile owns."""
    error = task.error
    if error is None:
        raise ValueError("a tile is merged after the reference's error was measured")
    owned, closed = _owned(task)
    rows = np.flatnonzero(owned)
    owner = np.full(len(task.landmarks), -1, dtype=np.int64)
    if not closed or not len(rows):
        nothing = tuple(np.empty((0, RANGE_BINS), dtype=np.int64) for _ in task.views)
        return TileResult(closed, owner, np.empty((0, 2)), np.empty((0, 2, 2)), nothing, nothing)
    mine = task.landmarks.take(rows)
    cannot_link = places(rows, task.cannot_link.reshape(-1)).reshape(-1, 2)
    clusters = cluster(mine, task.config, cannot_link[(cannot_link >= 0).all(axis=1)], error)
    points, covariance = fuse(mine, clusters, task.config, error)
    owner[rows] = clusters
    counts = [
        count_scans(seen, np.where(to >= 0, owner[to], -1), points, reach_m)
        for seen, to, reach_m in task.views
    ]
    return TileResult(
        True,
        owner,
        points,
        covariance,
        tuple(seen for seen, _ in counts),
        tuple(expected for _, expected in counts),
    )


def _owned(task: TileTask) -> tuple[NDArray[np.bool_], bool]:
    """Which landmarks are in groups that the tile owns, and whether all of those are closed."""
    points = task.landmarks.points_m
    n = len(points)
    pairs = close_pairs(points, task.config.merge_max_m)
    graph = scipy.sparse.coo_matrix((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(n, n))
    groups, group = scipy.sparse.csgraph.connected_components(graph, directed=False)
    order = np.lexsort((points[:, 0], points[:, 1]))
    _, first = np.unique(group[order], return_index=True)
    mine = task.mine[order[first]]
    closed = np.ones(groups, dtype=bool)
    closed[group[~task.inner]] = False
    return mine[group], bool(closed[mine].all())


def _gather(
    parts: Sequence[tuple[Whole, TileResult]], landmarks: TraversalLandmarks, error: ReferenceError
) -> tuple[Merged, Whole]:
    """Poles of all tiles numbered from south to north, and where each stands in `parts`."""
    owner = np.full(len(landmarks), -1, dtype=np.int64)
    count = 0
    for rows, result in parts:
        mine = result.owner >= 0
        owner[rows[mine]] = count + result.owner[mine]
        count += len(result.points_m)
    number = number_from_south(owner, landmarks.points_m)
    place = np.empty(count, dtype=np.int64)
    place[number] = owner
    points = np.concatenate([np.empty((0, 2)), *(result.points_m for _, result in parts)])
    spread = np.concatenate([np.empty((0, 2, 2)), *(r.covariance_m2 for _, r in parts)])
    return Merged(points[place], spread[place], number, error), place


def _counts(parts: Sequence[Whole]) -> Whole:
    return np.concatenate([np.empty((0, RANGE_BINS), dtype=np.int64), *parts])
