"""Landmarks and scans cut into square tiles of the map's grid, with margins."""

from __future__ import annotations

from itertools import product

import numpy as np
from numpy.typing import NDArray

from polemap.build.drive_observations import DriveObservations
from polemap.build.existence import sensing_range_m
from polemap.build.georeference import MapDetections, take_scans
from polemap.build.traversals import TraversalLandmarks

Floats = NDArray[np.float64]
Whole = NDArray[np.int64]
Key = tuple[int, int] | None  # None is one tile for everything
Bounds = tuple[Floats, Floats]


class Buckets:
    """Points by their tile, to find those of a rectangle without looking at all."""

    def __init__(self, points_m: Floats, tile_m: float) -> None:
        self._points, self._tile_m = points_m, tile_m
        self.tile: Whole = np.floor(points_m / tile_m).astype(np.int64).reshape(-1, 2)
        keys, inverse = np.unique(self.tile, axis=0, return_inverse=True)
        self.keys: list[tuple[int, int]] = [(int(a), int(b)) for a, b in keys]
        order = np.argsort(inverse.reshape(-1), kind="stable")
        ends = np.cumsum(np.bincount(inverse.reshape(-1), minlength=len(keys)))
        parts = np.split(order, ends[:-1]) if len(keys) else []
        self._rows = dict(zip(self.keys, parts, strict=True))

    def within(self, low_m: Floats, high_m: Floats) -> Whole:
        """Rows of the points in a rectangle, sorted."""
        first, last = np.floor(low_m / self._tile_m), np.floor(high_m / self._tile_m)
        # a rectangle may span more tiles than there are
        if float(np.prod(last - first + 1.0)) > len(self.keys):
            rows = np.arange(len(self._points))
        else:
            east, north = (range(int(a), int(b) + 1) for a, b in zip(first, last, strict=True))
            near = [self._rows[key] for key in product(east, north) if key in self._rows]
            rows = np.sort(np.concatenate(near)) if near else np.empty(0, dtype=np.int64)
        points = self._points[rows]
        return np.asarray(rows[((points >= low_m) & (points <= high_m)).all(axis=1)])


class LandmarkCut:
    """The landmarks of all drives, to be had a tile at a time."""

    def __init__(
        self, landmarks: TraversalLandmarks, cannot_link: Whole, tile_m: float | None
    ) -> None:
        self.landmarks, self._tile_m = landmarks, tile_m
        self._cannot_link = cannot_link[np.lexsort((cannot_link[:, 1], cannot_link[:, 0]))]
        self._buckets = Buckets(landmarks.points_m, tile_m) if tile_m is not None else None
        self.keys: list[Key] = [*self._buckets.keys] if self._buckets is not None else [None]

    def bounds(self, key: Key, margin_m: float) -> Bounds | None:
        """South-west and north-east corner of a tile with its margin."""
        if key is None or self._tile_m is None:
            return None
        low = np.array(key, dtype=np.float64) * self._tile_m
        return low - margin_m, low + self._tile_m + margin_m

    def rows(self, key: Key, margin_m: float) -> Whole:
        """Landmarks of a tile and its margin, sorted."""
        bounds = self.bounds(key, margin_m)
        if bounds is None or self._buckets is None:
            return np.arange(len(self.landmarks))
        return self._buckets.within(*bounds)

    def core(self, key: Key, rows: Whole) -> NDArray[np.bool_]:
        """Which of the rows lie in the tile itself."""
        if key is None or self._buckets is None:
            return np.ones(len(rows), dtype=bool)
        return np.asarray((self._buckets.tile[rows] == np.array(key)).all(axis=1))

    def inside(self, key: Key, rows: Whole, margin_m: float) -> NDArray[np.bool_]:
        """Which of the rows lie in the tile or in this margin."""
        bounds = self.bounds(key, margin_m)
        if bounds is None:
            return np.ones(len(rows), dtype=bool)
        points = self.landmarks.points_m[rows]
        return np.asarray(((points > bounds[0]) & (points < bounds[1])).all(axis=1))

    def cannot_link(self, rows: Whole) -> Whole:
        """Cannot-link pairs of which both are among the (sorted) rows, as places in it."""
        start = np.searchsorted(self._cannot_link[:, 0], rows, side="left")
        end = np.searchsorted(self._cannot_link[:, 0], rows, side="right")
        count = end - start
        pair = (
            np.repeat(start, count)
            + np.arange(count.sum())
            - np.repeat(np.cumsum(count) - count, count)
        )
        pairs = np.stack([places(rows, self._cannot_link[pair, side]) for side in (0, 1)], axis=1)
        return np.asarray(pairs[(pairs >= 0).all(axis=1)])


class ScanCut:
    """The scans of one drive, to be had a tile at a time; its landmarks begin at row `start`."""

    def __init__(self, part: DriveObservations, start: int, tile_m: float | None) -> None:
        self._part, self._start = part, start
        self._reach_m = sensing_range_m(part.detections.views)
        poses = part.detections.views.poses[:, :2]
        self._buckets = Buckets(poses, tile_m) if tile_m is not None else None
        self._order = np.argsort(part.rows, kind="stable")
        self._sorted_rows = part.rows[self._order]

    def view(self, bounds: Bounds | None, rows: Whole) -> tuple[MapDetections, Whole, float]:
        """Scans that see into the bounds or saw one of the landmarks `rows` (global, sorted).

        Returns:
            Their detections, the place in `rows` of each one's landmark (-1: not among them), and
            how far the drive sees.
        """
        part = self._part
        if bounds is None or self._buckets is None:
            return part.detections, places(rows, part.rows + self._start), self._reach_m
        chosen = np.zeros(len(part.detections.views), dtype=bool)
        low, high = bounds
        chosen[self._buckets.within(low - self._reach_m, high + self._reach_m)] = True
        start = np.searchsorted(self._sorted_rows, rows - self._start, side="left")
        end = np.searchsorted(self._sorted_rows, rows - self._start, side="right")
        for first, last in zip(start[end > start], end[end > start], strict=True):
            chosen[part.detections.scan[self._order[first:last]]] = True
        kept, taken = take_scans(part.detections, chosen)
        return kept, places(rows, part.rows[taken] + self._start), self._reach_m


def places(among: Whole, values: Whole) -> Whole:
    """Where each value stands in the sorted array `among`, -1 where it does not."""
    if not len(among):
        return np.full(len(values), -1, dtype=np.int64)
    place = np.minimum(np.searchsorted(among, values), len(among) - 1)
    return np.where(among[place] == values, place, -1).astype(np.int64)
