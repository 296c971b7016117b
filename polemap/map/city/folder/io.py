"""A folder of map files that are opened together: a district each, say, or a sheet of a survey.

Files are exchanged one by one, as districts are mapped anew; a localizer that runs keeps those it
has opened. Poles that stand in two files stand twice.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.errors import FrameError, InputError
from polemap.drivelog.frames import EarthFrame
from polemap.map.city.geopackage.io import GeoPackageTiles
from polemap.map.city.parquet.io import ParquetTiles
from polemap.map.city.statistics import MapStatistics, together
from polemap.map.city.tiles import Key, Tile, TileStore
from polemap.map.files.io import map_files
from polemap.map.line_map import LineMap, join_lines

Floats = NDArray[np.float64]

STORES = {".gpkg": GeoPackageTiles.open, ".parquet": ParquetTiles.open}
# files that are held open, each with one or two descriptors of the thousand that a process may have
_OPEN = 32
# more rows than a file has: the rows of the next file come after them
_ROWS = 1 << 40
_WHOLE_FILE = -1
# lines go on beyond the poles of their file
_BEYOND_M = 500.0


class FolderTiles:
    """The tiles of all files of a folder.

    Attributes:
        frame, statistics: as `CityMap` needs them.
    """

    def __init__(
        self, path: Path, files: list[Path], frame: EarthFrame, statistics: list[MapStatistics]
    ) -> None:
        self._path, self._files = path, files
        self.frame = frame
        self.statistics = together(statistics)
        self._extents = np.array(
            [one.extent_m or (np.nan,) * 4 for one in statistics], dtype=np.float64
        ).reshape(-1, 4)
        self._open: OrderedDict[int, TileStore] = OrderedDict()

    @classmethod
    def open(cls, path: Path) -> FolderTiles | None:
        """The tiles of a folder of map files; None of any other folder.

        Raises:
            InputError: a file that cannot be read, or is no map that is opened by tiles.
            FrameError: the files are in different frames.
        """
        files = map_files(path)
        statistics, frame = [], None
        for file in files:
            store = _store(file)
            if frame is not None and store.frame != frame:
                raise FrameError(
                    f"{path}: {files[0].name} is in {frame}, {file.name} in {store.frame}; a "
                    "folder of maps needs one frame for all"
                )
            frame = store.frame
            statistics.append(store.statistics)
        return None if frame is None else cls(path, files, frame, statistics)

    def __reduce__(self) -> tuple[Any, ...]:
        return FolderTiles.open, (self._path,)

    def overlapping(self, low_m: Floats, high_m: Floats) -> list[Key]:
        """Tiles of the files whose extent meets a box, file by file."""
        extents = self._extents
        meet = (extents[:, :2] <= high_m).all(axis=1) & (extents[:, 2:] >= low_m).all(axis=1)
        return [
            key for file in np.flatnonzero(meet) for key in self._keys(int(file), low_m, high_m)
        ]

    def _keys(self, file: int, low_m: Floats, high_m: Floats) -> list[Key]:
        try:
            return [(file, *key) for key in self._of(file).overlapping(low_m, high_m)]
        except InputError:
            # reading it says what is wrong
            return [(file, _WHOLE_FILE)]

    def all_keys(self) -> Iterator[Key]:
        """All tiles, file by file."""
        for file in range(len(self._files)):
            for key in self._of(file).all_keys():
                yield (file, *key)

    def box(self, key: Key) -> Floats:
        """Of a tile, or of a file that cannot be opened any more."""
        if key[1:] == (_WHOLE_FILE,):
            return np.asarray(self._extents[key[0]])
        return self._of(key[0]).box(key[1:])

    def read(self, key: Key, columns: Sequence[str] = ()) -> Tile:
        """The poles of a tile.

        Raises:
            InputError: damaged, or its file is gone.
        """
        tile = self._of(key[0]).read(key[1:], columns)
        return Tile(tile.poles, tile.rows + key[0] * _ROWS)

    def lines_in(self, boxes: Floats) -> LineMap | None:
        """The lines of all files that meet boxes `(k, 4)`; ids of other files follow.

        Raises:
            InputError: the lines of a file are damaged.
        """
        low, high = self._extents[:, :2] - _BEYOND_M, self._extents[:, 2:] + _BEYOND_M
        meet = (low[:, None] <= boxes[:, 2:]) & (high[:, None] >= boxes[:, :2])
        parts = []
        for file in np.flatnonzero(np.all(meet, axis=2).max(axis=1)).tolist():
            try:
                store = self._of(file)
            except InputError:
                continue  # reading its tiles says what is wrong
            lines = store.lines_in(boxes)
            if lines is not None and len(lines):
                parts.append(lines.with_columns(ids=lines.ids + file * _ROWS))
        return join_lines(parts) if parts else None

    def _of(self, file: int) -> TileStore:
        store = self._open.pop(file, None) or _store(self._files[file])
        self._open[file] = store
        while len(self._open) > _OPEN:
            self._open.popitem(last=False)
        return store


def _store(path: Path) -> TileStore:
    if not path.is_file():
        raise InputError(f"{path}: no such map; restore it")
    store: TileStore | None = STORES[path.suffix.lower()](path)
    if store is None:
        raise InputError(
            f"{path}: cannot be opened by tiles; write it anew, polemap map --convert "
            f"{path.name} --out NEW{path.suffix}"
        )
    return store
