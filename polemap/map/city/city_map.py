"""A city's map: what it holds is known at once, its poles are read where they are asked for."""

from __future__ import annotations

import logging
from collections import OrderedDict
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from threading import Lock
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from polemap.drivelog.errors import FrameError, InputError
from polemap.drivelog.frames import EarthFrame
from polemap.map.city.statistics import MapStatistics
from polemap.map.city.tiles import Area, Key, Tile, TileStore, box_around, box_in, inside
from polemap.map.crowds import check_crowds
from polemap.map.line_map import LineMap
from polemap.map.pattern_index.index import PatternIndex
from polemap.map.pattern_index.io import open_index, read_index
from polemap.map.pole_map import PoleMap, join_maps

Floats = NDArray[np.float64]

_LOG = logging.getLogger("polemap")

# poles that are kept in memory, some 150 bytes each: a car's surroundings ten times over
CACHED_POLES = 200_000


class CityMap:
    """A pole map that is read by tiles. May be used from several threads.

    Poles are returned as a `PoleMap` of those that were asked for, in the order of the whole map.

    Args:
        store: the file.
        frame: to be transformed into, the file's own where not given.
        name: for messages.
        cached_poles: how many poles are kept in memory.

    Raises:
        FrameError: no transformation leads to that frame.

    Attributes:
        frame: of all poles that it returns.
        notes: what a user of the map must know.
        damaged: what was wrong with the tiles that could not be read.
    """

    def __init__(
        self,
        store: TileStore,
        frame: EarthFrame | None = None,
        name: str = "map",
        cached_poles: int = CACHED_POLES,
    ) -> None:
        own = store.frame
        self.frame = frame or own
        self.notes: tuple[str, ...] = ()
        if self.frame != own:
            if not (self.frame.is_utm and own.is_utm):
                raise FrameError(
                    f"{name}: the map is in {own}, the drive in {self.frame}; no transformation "
                    "leads from one to the other: use a map built in the drive's own frame"
                )
            self.notes = (f"transformed from {own} to {self.frame}",)
        self.name = name
        self.damaged: dict[Key, str] = {}
        self._store = store
        self._most = cached_poles
        self._cache: OrderedDict[Key, Tile] = OrderedDict()
        self._cached = 0
        self._lock = Lock()
        self._lines_damaged = False
        self._patterns: PatternIndex | None = None
        self._patterns_asked = False

    def __len__(self) -> int:
        return self._store.statistics.poles

    def __reduce__(self) -> tuple[Any, ...]:
        # for another process, where the store opens its file once more
        return CityMap, (self._store, self.frame, self.name, self._most)

    @property
    def statistics(self) -> MapStatistics:
        """Figures over all poles, as stored with them; the extent in `frame`."""
        stored = self._store.statistics
        if self.frame == self._store.frame or not stored.extent_m:
            return stored
        turned = box_in(np.array(stored.extent_m), self._store.frame, self.frame)
        return replace(stored, extent_m=tuple(turned.tolist()))

    @property
    def kinds(self) -> tuple[int, ...]:
        """Every `LandmarkKind` that stands in the map."""
        return self._store.statistics.kinds

    def uncached(self) -> CityMap:
        """The same map, of which no pole is kept in memory."""
        return CityMap(self._store, self.frame, self.name, cached_poles=0)

    @property
    def patterns(self) -> PatternIndex | None:
        """The index of its pole patterns, in the map's own frame, where one stands beside it."""
        if not self._patterns_asked:
            self._patterns_asked = True
            try:
                self._patterns = read_index(Path(self.name))
            except InputError as error:
                _LOG.warning("%s", error)
        return self._patterns

    def built_patterns(self) -> PatternIndex:
        """The index of its pole patterns, built where there is none, which is told of.

        It is kept beside the map where that can be written.

        Raises:
            InputError: the map cannot be read.
        """
        if self.patterns is None:
            own = CityMap(self._store, name=self.name)
            self._patterns = open_index(
                Path(self.name), own.uncached, say=lambda text: _LOG.warning("%s", text)
            )
        assert self._patterns is not None
        return self._patterns

    def area(self, boxes: ArrayLike) -> Area:
        """The poles in boxes `(k, 4)` and the lines that meet them; what cannot be read is told of
        and left out."""
        wanted = np.asarray(boxes, dtype=np.float64).reshape(-1, 4)
        tiles, unread = [], []
        for key in self._keys(wanted):
            if key not in self.damaged:
                try:
                    tiles.append(self._tile(key))
                    continue
                except InputError as error:
                    self.damaged[key] = str(error)
                    _LOG.warning("%s; its poles are left out", error)
            unread.append(self._box(key))
        poles = replace(self._joined(tiles, wanted), lines=self._lines(wanted))
        return Area(wanted, poles, np.array(unread).reshape(-1, 4))

    def _lines(self, boxes: Floats) -> LineMap | None:
        own = [box_in(box, self.frame, self._store.frame) for box in boxes]
        try:
            lines = self._store.lines_in(np.array(own).reshape(-1, 4))
        except InputError as error:
            if not self._lines_damaged:
                self._lines_damaged = True
                _LOG.warning("%s; its lines are left out", error)
            return None
        return None if lines is None else lines.to_frame(self.frame)

    def poles_in(self, box: ArrayLike, columns: Sequence[str] = ()) -> PoleMap:
        """The poles in a box `(4,)`: west, south, east, north.

        Args:
            columns: further ones to read, not kept in memory.

        Raises:
            InputError: a tile is damaged.
        """
        wanted = np.asarray(box, dtype=np.float64).reshape(1, 4)
        read = [
            self._read(key, columns) if columns else self._tile(key) for key in self._keys(wanted)
        ]
        return self._joined(read, wanted)

    def poles_within(self, centre_m: ArrayLike, radius_m: float) -> PoleMap:
        """The poles within a circle.

        Raises:
            InputError: a tile is damaged.
        """
        square = self.poles_in(box_around(centre_m, radius_m))
        offset = square.points_m - np.asarray(centre_m, dtype=np.float64).reshape(2)
        return square.rows(np.hypot(offset[:, 0], offset[:, 1]) <= radius_m)

    def nearest_m(self, points_m: ArrayLike, limit_m: float) -> Floats:
        """Distance `(n,)` to the nearest pole that can be read, infinite beyond the limit."""
        points = np.asarray(points_m, dtype=np.float64).reshape(-1, 2)
        found = np.array([np.inf] * len(points))
        for row, point in enumerate(points):
            offset = self.area(box_around(point, limit_m)).poles.points_m - point
            nearest = np.hypot(*offset.T).min(initial=np.inf)
            found[row] = nearest if nearest <= limit_m else np.inf
        return found

    def poles_along(
        self, path_m: ArrayLike, radius_m: float, columns: Sequence[str] = ()
    ) -> PoleMap:
        """The poles around a path `(n, 2)`: all within `radius_m` of its points, and some beyond.

        Args:
            columns: further ones to read.

        Raises:
            InputError: a tile is damaged.
        """
        path = np.asarray(path_m, dtype=np.float64).reshape(-1, 2)
        cells = np.unique(np.floor(path / radius_m), axis=0) * radius_m
        boxes = np.hstack([cells - radius_m, cells + 2.0 * radius_m])
        tiles = [
            self._read(key, columns) if columns else self._tile(key) for key in self._keys(boxes)
        ]
        return self._joined(tiles, boxes)

    def tiles(self, columns: Sequence[str] = ()) -> Iterator[Tile]:
        """All poles, a tile after the other; none of them is kept in memory.

        Raises:
            InputError: a tile is damaged.
        """
        for key in self._store.all_keys():
            tile = self._read(key, columns)
            if len(tile.rows):
                yield tile

    def _keys(self, boxes: Floats) -> list[Key]:
        keys: dict[Key, None] = {}
        for box in boxes:
            own = box_in(box, self.frame, self._store.frame)
            keys |= dict.fromkeys(self._store.overlapping(own[:2], own[2:]))
        return list(keys)

    def _box(self, key: Key) -> Floats:
        return box_in(self._store.box(key), self._store.frame, self.frame)

    def _tile(self, key: Key) -> Tile:
        """A tile of the cache, or of the file; what was not used for longest makes way."""
        with self._lock:
            tile = self._cache.get(key)
            if tile is not None:
                self._cache.move_to_end(key)
                return tile
        tile = self._read(key)
        with self._lock:
            if key not in self._cache:
                self._cache[key] = tile
                self._cached += len(tile.rows)
            while self._cached > self._most and len(self._cache) > 1:
                _, oldest = self._cache.popitem(last=False)
                self._cached -= len(oldest.rows)
        return tile

    def _read(self, key: Key, columns: Sequence[str] = ()) -> Tile:
        tile = self._store.read(key, columns)
        try:
            check_crowds(tile.poles)
        except InputError as error:
            raise InputError(f"{self.name}: {error}") from error
        if self.frame == self._store.frame:
            return tile
        return Tile(replace(tile.poles.to_frame(self.frame), notes=()), tile.rows)

    def _joined(self, tiles: Sequence[Tile], boxes: Floats) -> PoleMap:
        """The poles of the tiles that stand in one of the boxes, in the order of the whole map."""
        parts, rows = [], []
        for tile in tiles:
            chosen = inside(boxes, tile.poles.points_m)
            if chosen.any():
                parts.append(tile.poles.rows(chosen))
                rows.append(tile.rows[chosen])
        if not parts:
            return PoleMap.empty(self.frame)
        joined = replace(join_maps(*parts), notes=())
        return joined.rows(np.argsort(np.concatenate(rows), kind="stable"))


def statistics_of(pole_map: PoleMap | CityMap) -> MapStatistics:
    """Figures over all poles: as stored with a city, or counted."""
    return pole_map.statistics if isinstance(pole_map, CityMap) else MapStatistics.of(pole_map)


def along(
    pole_map: PoleMap | CityMap, path_m: ArrayLike, radius_m: float, columns: Sequence[str] = ()
) -> PoleMap:
    """A map in memory as it is; of a city what `CityMap.poles_along` gives."""
    if isinstance(pole_map, CityMap):
        return pole_map.poles_along(path_m, radius_m, columns)
    return pole_map
