"""A GeoParquet file read by row groups, of which its metadata know the boxes."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from pathlib import Path
from threading import Lock
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.errors import InputError
from polemap.drivelog.frames import EarthFrame
from polemap.extras import need
from polemap.map.city.packing import TILE_POLES, boxes_of, packed_order
from polemap.map.city.statistics import MapStatistics
from polemap.map.city.stored import METADATA_KEY, StoredCity
from polemap.map.city.tiles import Key, Tile
from polemap.map.formats.columns import KNOWN
from polemap.map.line_map import LineMap
from polemap.map.pole_map import KIND_COLUMN, PoleMap
from polemap.parsing.errors import short

Floats = NDArray[np.float64]

GEOMETRY = "geometry"


_TILES_AT_ONCE = 64


def write_tiles(pole_map: PoleMap, path: Path, tile_poles: int = TILE_POLES) -> None:
    """Write a map with a row group a tile; rows of a tile are neighbours."""
    parquet = need("pyarrow.parquet")
    from polemap.map.formats import geoparquet, geoparquet_points  # need pyarrow, too

    order = packed_order(pole_map.points_m, tile_poles)
    boxes = boxes_of(pole_map.points_m[order], tile_poles)
    city = StoredCity(
        pole_map.frame,
        MapStatistics.of(pole_map),
        {"tile_poles": tile_poles, "boxes": boxes.tolist()},
    )
    about = geoparquet.metadata_of(pole_map) | {METADATA_KEY: city.to_text()}
    first = _table(pole_map, order[:tile_poles])
    # dictionaries of numbers that are all different only cost time, as does a strong compression;
    # the checksums find a tile that a disk has damaged; nobody asks for statistics of columns
    with parquet.ParquetWriter(
        path, first.schema.with_metadata(about), compression="snappy",
        use_dictionary=geoparquet_points.text_columns(first),
        write_page_checksum=True, write_statistics=False,
    ) as writer:  # fmt: skip
        # some tiles at a time: beside the map itself writing takes hardly any memory
        for start in range(0, max(len(order), 1), _TILES_AT_ONCE * tile_poles):
            rows = order[start : start + _TILES_AT_ONCE * tile_poles]
            writer.write_table(_table(pole_map, rows), row_group_size=tile_poles)


def _table(pole_map: PoleMap, rows: NDArray[np.int64]) -> Any:
    from polemap.map.formats import geoparquet

    return geoparquet.to_table(pole_map.rows(rows)).replace_schema_metadata(None)


class ParquetTiles:
    """The row groups of a map that `write_tiles` has written.

    Attributes:
        frame, statistics: as `CityMap` needs them.
    """

    def __init__(self, path: Path, city: StoredCity, file: Any, boxes: Floats) -> None:
        self.frame: EarthFrame = city.frame
        self.statistics: MapStatistics = city.statistics
        self._path, self._file, self._boxes = path, file, boxes
        self._tile_poles = int(city.details["tile_poles"])
        self._columns = set(file.schema_arrow.names)
        self._opened = path.open("rb")
        self._state = self._now()
        self._lock = Lock()

    @classmethod
    def open(cls, path: Path) -> ParquetTiles | None:
        """The tiles of a map of ours; None of one that does not describe itself, or not any more.

        Raises:
            InputError: a Parquet file that cannot be read.
        """
        pa, parquet = need("pyarrow"), need("pyarrow.parquet")
        from polemap.map.formats import geoparquet_points  # needs pyarrow, too

        try:
            file = parquet.ParquetFile(path, page_checksum_verification=True)
        except (pa.ArrowException, OSError) as error:
            raise InputError(f"{path}: not a Parquet file ({short(error)})") from error
        text = (file.schema_arrow.metadata or {}).get(METADATA_KEY.encode())
        try:
            city = None if text is None else StoredCity.from_text(text.decode())
            if city is None:
                return None
            boxes = np.array(city.details["boxes"], dtype=np.float64).reshape(-1, 4)
            tile_poles = int(city.details["tile_poles"])
        except (InputError, KeyError, TypeError, ValueError) as error:
            raise InputError(f"{path}: {error}") from error
        groups = file.metadata.num_row_groups
        most = [tile_poles] * (groups - 1) if groups else []
        rows = [file.metadata.row_group(group).num_rows for group in range(groups)]
        if (
            len(boxes) != groups
            or rows[:-1] != most
            or sum(rows) != city.statistics.poles
            or not geoparquet_points.is_plain(file.schema_arrow, city.frame)
        ):
            return None
        return cls(path, city, file, boxes)

    def __reduce__(self) -> tuple[Any, ...]:
        return ParquetTiles.open, (self._path,)

    def overlapping(self, low_m: Floats, high_m: Floats) -> list[Key]:
        """Row groups whose box meets another."""
        boxes = self._boxes
        meet = (boxes[:, :2] <= high_m).all(axis=1) & (boxes[:, 2:] >= low_m).all(axis=1)
        return [(int(group),) for group in np.flatnonzero(meet)]

    def all_keys(self) -> Iterator[Key]:
        """All row groups."""
        return ((group,) for group in range(len(self._boxes)))

    def box(self, key: Key) -> Floats:
        """What the poles of a row group span."""
        return np.asarray(self._boxes[key[0]])

    def lines_in(self, boxes: Floats) -> LineMap | None:
        """None: the format has no lines."""
        return None

    def read(self, key: Key, columns: Sequence[str] = ()) -> Tile:
        """The poles of a row group.

        Raises:
            InputError: damaged, or another file than was opened.
        """
        pa = need("pyarrow")
        from polemap.map.formats import geoparquet_points  # needs pyarrow, too

        group = key[0]
        names = [
            name for name in (*KNOWN, KIND_COLUMN, *columns, GEOMETRY) if name in self._columns
        ]
        try:
            with self._lock:
                if self._now() != self._state:
                    raise InputError("the file has changed since it was opened")
                table = self._file.read_row_group(group, columns=names, use_threads=False)
            poles = geoparquet_points.plain_map(table, GEOMETRY, self.frame)
            if poles is None:
                raise InputError("its geometries are no points in the plane")
            low, high = self._boxes[group, :2], self._boxes[group, 2:]
            if not ((poles.points_m >= low) & (poles.points_m <= high)).all():
                raise InputError("poles stand beyond its box")
        except (InputError, pa.ArrowException, OSError, TypeError, ValueError) as error:
            raise InputError(
                f"{self._path}: row group {group} is damaged ({short(error)}); restore it"
            ) from error
        first = group * self._tile_poles
        return Tile(poles, np.arange(first, first + len(poles), dtype=np.int64))

    def _now(self) -> tuple[int, int]:
        """Tells a file that is written in place from one that was exchanged whole."""
        found = os.fstat(self._opened.fileno())
        return found.st_size, found.st_mtime_ns
