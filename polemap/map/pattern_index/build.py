"""Building the index tile by tile; of an older index what belongs to unchanged tiles is kept.

A triangle belongs to the tile of its first corner. A tile sees the poles of a margin around it that
is wide enough for its triangles to be those of the whole map, so tiles may be worked on by any
number of workers, and a tile whose poles and margin are as before keeps its triangles.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.errors import InputError
from polemap.drivelog.frames import EarthFrame
from polemap.drivelog.landmark_kind import LandmarkKind
from polemap.map.pattern_index.cells import (
    MOST_M,
    TILE_M,
    cell_numbers,
    cell_places,
    tile_corner_m,
    tile_of,
)
from polemap.map.pattern_index.index import DIRECTIONS, PatternIndex
from polemap.map.pattern_index.triples import (
    BITS,
    REACH_M,
    keys,
    neighbour_triples,
    quantised,
    triangles,
)
from polemap.map.pole_map import PoleMap

Floats = NDArray[np.float64]
Whole = NDArray[np.int64]
Run = Callable[[Callable[[Any], Any], Sequence[Any]], list[Any]]

NEIGHBOURS = 5
"""Nearest neighbours of a pole, of which pairs are taken."""
_EXISTENCE_LEAST = 0.3  # what hardly stands there any more is no pattern
# triangles are put in order so many shapes at a time, so that little is held twice
_SHAPES_AT_ONCE = 2**15
# triangles of a tile's poles have bases up to REACH_M away, and these neighbours as far again
_MARGIN_M = 2.0 * REACH_M + 1.0


class MapTile(Protocol):
    """Some poles of a map."""

    @property
    def poles(self) -> PoleMap:
        """Of this tile alone."""


class TiledMap(Protocol):
    """A map that is read tile by tile; `polemap.map.city.city_map.CityMap` is one."""

    @property
    def frame(self) -> EarthFrame:
        """Of the coordinates."""

    def tiles(self) -> Iterator[MapTile]:
        """All poles, each in one tile."""


@dataclass(frozen=True, slots=True)
class TileTask:
    """What a worker needs for one tile: its poles and those of the margin, in the map's order."""

    points_m: Floats
    mine: NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class TileTriangles:
    """A tile's triangles, ordered by shape.

    Attributes:
        shape: `(t,)` keys.
        corner: `(t,)` first corner, counted among the tile's own poles.
        direction: `(t,)`.
    """

    shape: NDArray[np.uint32]
    corner: NDArray[np.uint32]
    direction: NDArray[np.uint16]


def here(function: Callable[[Any], Any], tasks: Sequence[Any]) -> list[Any]:
    """Run tasks one after the other in this process."""
    return [function(task) for task in tasks]


def find_triangles(task: TileTask) -> TileTriangles:
    """The triangles that a tile owns."""
    points = task.points_m
    own = points[task.mine]
    if not len(own):
        return TileTriangles(np.empty(0, np.uint32), np.empty(0, np.uint32), np.empty(0, np.uint16))
    low, high = own.min(axis=0) - REACH_M, own.max(axis=0) + REACH_M
    bases = np.flatnonzero(((points >= low) & (points <= high)).all(axis=1))
    found = triangles(points, neighbour_triples(points, NEIGHBOURS, bases))
    found = found.take(task.mine[found.corners[:, 0]])
    shape = keys(quantised(found.sides_m))
    place = np.cumsum(task.mine) - 1
    corner = place[found.corners[:, 0]]
    turn = np.round(found.direction_rad * (DIRECTIONS / (2.0 * np.pi))).astype(np.int64)
    direction = turn % DIRECTIONS
    order = np.lexsort((direction, corner, shape))
    return TileTriangles(
        shape[order], corner[order].astype(np.uint32), direction[order].astype(np.uint16)
    )


def build_index(
    pole_map: PoleMap | TiledMap,
    *,
    run: Run = here,
    old: Mapping[str, TileTriangles] | None = None,
) -> tuple[PatternIndex, dict[int, str]]:
    """The index of a map, and the digest of every tile.

    Args:
        pole_map: landmarks that are no poles, and what hardly exists any more, are left out.
        run: applies a function of this module to tasks, in the order of the tasks.
        old: what an older index has, by the digest of its tiles.

    Raises:
        InputError: a pole that stands nowhere on the earth, or a tile that cannot be read.
    """
    parts = [pole_map] if isinstance(pole_map, PoleMap) else (t.poles for t in pole_map.tiles())
    points, sd, width = _gathered(pole_map.frame, parts)
    number = cell_numbers(cell_places(points))
    order = np.lexsort((points[:, 0], points[:, 1], number))
    points, number = points[order], number[order]
    cells, cell_first = _starts(number)
    digests, found = _tiles(points, number, run, old or {})
    del number
    shapes, shape_first, pole, direction = _joined(found)
    index = PatternIndex(
        pole_map.frame, points, sd[order], width[order],
        cells, cell_first, shapes, shape_first, pole, direction,
    )  # fmt: skip
    return index, digests


def _gathered(
    frame: EarthFrame, parts: Iterable[PoleMap]
) -> tuple[Floats, NDArray[np.float32], NDArray[np.float32]]:
    """Places, deviations of a coordinate and widths of the poles that make patterns."""
    points, sds, widths = [np.empty((0, 2))], [np.empty(0, np.float32)], [np.empty(0, np.float32)]
    for part in parts:
        kept = (part.kind == LandmarkKind.POLE) & (part.existence >= _EXISTENCE_LEAST)
        here_m = np.asarray(part.points_m, dtype=np.float64)[kept]
        if len(here_m) and np.abs(here_m).max() > MOST_M:
            row = int(np.abs(here_m).max(axis=1).argmax())
            raise InputError(
                f"index of patterns: pole {part.ids[kept][row]} lies "
                f"{np.abs(here_m[row]).max():.0f} m from the origin of {frame}, {MOST_M:.0f} at "
                "most; correct it or remove it from the map"
            )
        variance = np.asarray(part.covariance_m2, dtype=np.float64)[kept]
        points.append(here_m)
        sds.append(np.sqrt(0.5 * np.trace(variance, axis1=1, axis2=2)).astype(np.float32))
        widths.append(np.asarray(part.width_m)[kept].astype(np.float32))
    return np.concatenate(points), np.concatenate(sds), np.concatenate(widths)


def _starts(ordered: NDArray[Any]) -> tuple[NDArray[Any], Whole]:
    """The different values of an ordered array, and where each begins, the end added."""
    change = np.ones(len(ordered), dtype=bool)
    change[1:] = ordered[1:] != ordered[:-1]
    first = np.flatnonzero(change)
    return ordered[first], np.append(first, len(ordered)).astype(np.int64)


def _tiles(
    points: Floats, number: Whole, run: Run, old: Mapping[str, TileTriangles]
) -> tuple[dict[int, str], list[tuple[int, TileTriangles]]]:
    """Digest, first pole and triangles of every tile."""
    tiles, tile_first = _starts(tile_of(number))
    digests: dict[int, str] = {}
    done: dict[int, TileTriangles] = {}
    tasks, open_tiles = [], []
    by_north = np.argsort(points[:, 1], kind="stable")
    north = points[by_north, 1]
    for place, tile in enumerate(tiles.tolist()):
        task = _task(points, by_north, north, tile, slice(*tile_first[place : place + 2]))
        digests[tile] = _digest(task)
        kept = old.get(digests[tile])
        if kept is not None:
            done[place] = kept
        else:
            tasks.append(task)
            open_tiles.append(place)
    done |= dict(zip(open_tiles, run(find_triangles, tasks), strict=True))
    return digests, [(int(tile_first[place]), done[place]) for place in range(len(tiles))]


def _task(points: Floats, by_north: Whole, north: Floats, tile: int, own: slice) -> TileTask:
    east_m, north_m = tile_corner_m(tile)
    low, high = np.searchsorted(north, [north_m - _MARGIN_M, north_m + TILE_M + _MARGIN_M])
    rows = by_north[low:high]
    east = points[rows, 0]
    rows = np.sort(rows[(east >= east_m - _MARGIN_M) & (east < east_m + TILE_M + _MARGIN_M)])
    return TileTask(points[rows], (rows >= own.start) & (rows < own.stop))


def _digest(task: TileTask) -> str:
    """Names what a tile's triangles follow from."""
    text = hashlib.sha256(np.ascontiguousarray(task.points_m).tobytes())
    text.update(np.packbits(task.mine).tobytes())
    return text.hexdigest()[:32]


def _joined(
    parts: list[tuple[int, TileTriangles]],
) -> tuple[NDArray[np.uint32], Whole, NDArray[np.uint32], NDArray[np.uint16]]:
    """All triangles ordered by shape: shapes, their first triangles, corners, directions."""
    total = sum(len(part.shape) for _, part in parts)
    pole, direction = np.empty(total, np.uint32), np.empty(total, np.uint16)
    shapes, counts = [np.empty(0, np.uint32)], [np.empty(0, np.int64)]
    at = 0
    for low in range(0, 2 ** (3 * BITS), _SHAPES_AT_ONCE):
        bounds = np.array([low, low + _SHAPES_AT_ONCE], np.uint32)
        rows = [slice(*np.searchsorted(part.shape, bounds)) for _, part in parts]
        shape = _chained((part.shape[r] for (_, part), r in zip(parts, rows, strict=True)), pole)
        if not len(shape):
            continue
        # the parts are in order already: a stable sort merges them
        order = np.argsort(shape, kind="stable")
        there = slice(at, at + len(order))
        corners = (p.corner[r] + np.uint32(f) for (f, p), r in zip(parts, rows, strict=True))
        turns = (p.direction[r] for (_, p), r in zip(parts, rows, strict=True))
        pole[there] = _chained(corners, pole)[order]
        direction[there] = _chained(turns, direction)[order]
        found, first = _starts(shape[order])
        shapes.append(found)
        counts.append(np.diff(first))
        at += len(order)
    starts = np.concatenate([[0], np.cumsum(np.concatenate(counts))]).astype(np.int64)
    return np.concatenate(shapes), starts, pole, direction


def _chained(parts: Iterable[NDArray[Any]], like: NDArray[Any]) -> NDArray[Any]:
    """Arrays one behind the other, of the type of `like` even where there are none."""
    return np.concatenate([like[:0], *parts])


def kept_tiles(index: PatternIndex, digests: Mapping[str, str]) -> dict[str, TileTriangles]:
    """The triangles of an index by the digest of their tile.

    Args:
        digests: of its tiles, by their number.
    """
    first_pole = index.cell_first[:-1]
    tiles, starts = _starts(tile_of(np.asarray(index.cells)))
    begins = np.append(first_pole[starts[:-1]], len(index.points_m))
    tile = np.searchsorted(begins, index.pole, side="right") - 1
    shape = np.repeat(index.shapes, np.diff(index.shape_first))
    # stable: the order by shape and corner stays within each tile
    order = np.argsort(tile.astype(np.uint32), kind="stable")
    ends = np.searchsorted(tile[order], np.arange(len(tiles) + 1))
    kept: dict[str, TileTriangles] = {}
    for place, number in enumerate(tiles.tolist()):
        rows = order[ends[place] : ends[place + 1]]
        corner = index.pole[rows] - np.uint32(begins[place])
        digest = digests.get(str(number))
        if digest is not None:
            kept[digest] = TileTriangles(shape[rows], corner, index.direction[rows])
    return kept
