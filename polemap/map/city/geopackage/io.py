"""A GeoPackage read by squares of its layer's R-tree, with nothing but SQLite."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator, Sequence
from contextlib import closing
from pathlib import Path
from threading import Lock
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.errors import InputError
from polemap.drivelog.frames import EarthFrame
from polemap.map.city.geopackage.lines import LineLayer
from polemap.map.city.statistics import MapStatistics
from polemap.map.city.stored import METADATA_KEY, StoredCity
from polemap.map.city.tiles import Key, Tile
from polemap.map.formats.columns import KNOWN, from_columns
from polemap.map.line_map import LineMap
from polemap.map.pole_map import KIND_COLUMN
from polemap.parsing.errors import ParsingError, short

Floats = NDArray[np.float64]

LAYER = "poles"
# side of a tile: some hundred poles of a street grid, a few dozen tiles around a car
TILE_M = 500.0
_URI = f"urn:polemap:{METADATA_KEY}"
_POINT = np.dtype(
    [("magic", "S2"), ("version", "u1"), ("flags", "u1"), ("srs", "<i4"), ("order", "u1"),
     ("type", "<u4"), ("x", "<f8"), ("y", "<f8")]
)  # fmt: skip
_LITTLE_ENDIAN_WITHOUT_BOX, _WKB_POINT = 1, 1


def describe_city(path: Path, city: StoredCity) -> None:
    """Store in a written GeoPackage what opening it by tiles needs."""
    with closing(sqlite3.connect(path)) as database, database:
        (last,) = database.execute("SELECT coalesce(max(id), 0) FROM gpkg_metadata").fetchone()
        database.execute(
            "INSERT INTO gpkg_metadata (id, md_scope, md_standard_uri, mime_type, metadata) "
            "VALUES (?, 'dataset', ?, 'application/json', ?)",
            (last + 1, _URI, city.to_text()),
        )
        database.execute(
            "INSERT INTO gpkg_metadata_reference (reference_scope, table_name, md_file_id) "
            "VALUES ('table', ?, ?)",
            (LAYER, last + 1),
        )


class GeoPackageTiles:
    """The layer of poles by squares of `TILE_M`; poles on a border belong to the square beyond.

    Attributes:
        frame, statistics: as `CityMap` needs them.
        lines: its layer of lines.
    """

    def __init__(self, path: Path, city: StoredCity) -> None:
        self._path = path
        self.frame: EarthFrame = city.frame
        self.statistics: MapStatistics = city.statistics
        self._database = _connect(path)
        self._lock = Lock()
        with self._lock:
            about = self._database.execute(f"PRAGMA table_info({LAYER})").fetchall()
            self._geometry, system = self._database.execute(
                "SELECT column_name, srs_id FROM gpkg_geometry_columns WHERE table_name = ?",
                (LAYER,),
            ).fetchone()
            self.lines = LineLayer(self._database, self.frame, system)
        self._columns = [str(row[1]) for row in about]
        self._key = next(str(row[1]) for row in about if row[5])

    @classmethod
    def open(cls, path: Path) -> GeoPackageTiles | None:
        """The tiles of a map of ours; None of one that does not describe itself, or not any more.

        Raises:
            InputError: a GeoPackage that cannot be read.
        """
        try:
            with closing(_connect(path)) as database:
                city = _described(database)
            tiles = None if city is None else cls(path, city)
            # a GIS has put the lines elsewhere: they are transformed where the map is read whole
            return tiles if tiles is not None and tiles.lines.placed else None
        except (sqlite3.Error, StopIteration, TypeError) as error:
            raise InputError(f"{path}: not a GeoPackage of poles ({short(error)})") from error

    def __reduce__(self) -> tuple[Any, ...]:
        return GeoPackageTiles.open, (self._path,)

    def overlapping(self, low_m: Floats, high_m: Floats) -> list[Key]:
        """Squares that a box meets, from south to north and west to east."""
        first, last = np.floor(low_m / TILE_M), np.floor(high_m / TILE_M)
        return [
            (east, north)
            for north in range(int(first[1]), int(last[1]) + 1)
            for east in range(int(first[0]), int(last[0]) + 1)
        ]

    def all_keys(self) -> Iterator[Key]:
        """All squares of the extent."""
        if self.statistics.extent_m:
            extent = np.array(self.statistics.extent_m)
            yield from self.overlapping(extent[:2], extent[2:])

    def box(self, key: Key) -> Floats:
        """The square itself."""
        low = np.array(key, dtype=np.float64) * TILE_M
        return np.concatenate([low, low + TILE_M])

    def read(self, key: Key, columns: Sequence[str] = ()) -> Tile:
        """The poles of a square.

        Raises:
            InputError: damaged, or a value that no map has.
        """
        names = [name for name in (*KNOWN, KIND_COLUMN, *columns) if name in self._columns]
        west, south, east, north = self.box(key).tolist()
        chosen = ", ".join(f'p."{name}"' for name in (self._key, self._geometry, *names))
        try:
            with self._lock:
                # the tree's numbers have four bytes, rounded outwards: what lies beyond goes below
                rows = self._database.execute(
                    f'SELECT {chosen} FROM "rtree_{LAYER}_{self._geometry}" r JOIN "{LAYER}" p '
                    f'ON p."{self._key}" = r.id WHERE r.minx <= ? AND r.maxx >= ? '
                    "AND r.miny <= ? AND r.maxy >= ? ORDER BY r.id",
                    (east, west, north, south),
                ).fetchall()
        except sqlite3.Error as error:
            raise InputError(
                f"{self._path}: the tile at {west:.0f}, {south:.0f} m cannot be read "
                f"({short(error)}); restore it"
            ) from error
        try:
            return self._tile(rows, names, np.array([west, south]), np.array([east, north]))
        except (InputError, ParsingError, TypeError, ValueError, OverflowError) as error:
            raise InputError(
                f"{self._path}: the tile at {west:.0f}, {south:.0f} m is damaged ({short(error)}); "
                "restore it"
            ) from error

    def lines_in(self, boxes: Floats) -> LineMap | None:
        """The lines that meet boxes `(k, 4)`, whole; None where the map has none.

        Raises:
            InputError: damaged, or a value that no line has.
        """
        try:
            with self._lock:
                return self.lines.inside(self._database, boxes)
        except (InputError, sqlite3.Error) as error:
            raise InputError(f"{self._path}: {short(error)}; restore it") from error

    def _tile(
        self, rows: list[tuple[Any, ...]], names: list[str], low_m: Floats, high_m: Floats
    ) -> Tile:
        values = list(zip(*rows, strict=True)) if rows else [()] * (len(names) + 2)
        number = np.array(values[0], dtype=np.int64)
        points = _places(values[1])
        mine = ((points >= low_m) & (points < high_m)).all(axis=1)
        columns = {
            name: np.array([np.nan if v is None else v for v in column])
            if name in KNOWN or name == KIND_COLUMN
            else np.array(["" if v is None else str(v) for v in column], dtype=np.str_)
            for name, column in zip(names, values[2:], strict=True)
        }
        if "id" in columns and columns["id"].dtype.kind == "f":
            # added in a GIS, without an id: no other tile may give the same
            own = np.where(np.isnan(columns["id"]), -1.0 - number, columns["id"])
            columns["id"] = own.astype(np.int64)
        kept = {name: column[mine] for name, column in columns.items()}
        poles = from_columns(
            self.frame,
            points[mine],
            {name: column for name, column in kept.items() if name in KNOWN},
            extra={name: column for name, column in kept.items() if name not in KNOWN},
        )
        return Tile(poles, number[mine])


def _connect(path: Path) -> sqlite3.Connection:
    # reading only: no lock is taken that a GIS would wait for
    return sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro", uri=True, check_same_thread=False)


def _described(database: sqlite3.Connection) -> StoredCity | None:
    """What the file says of itself, None where a GIS has changed it since."""
    tables = {row[0] for row in database.execute("SELECT name FROM sqlite_master")}
    needed = {LAYER, "gpkg_metadata", "gpkg_ogr_contents", "gpkg_geometry_columns"}
    if not needed <= tables:
        return None
    found = database.execute(
        "SELECT metadata FROM gpkg_metadata WHERE md_standard_uri = ? ORDER BY id DESC", (_URI,)
    ).fetchone()
    city = None if found is None else StoredCity.from_text(str(found[0]))
    if city is None:
        return None
    layer = database.execute(
        "SELECT g.column_name, g.geometry_type_name, s.organization, s.organization_coordsys_id "
        "FROM gpkg_geometry_columns g JOIN gpkg_spatial_ref_sys s ON s.srs_id = g.srs_id "
        "WHERE g.table_name = ?",
        (LAYER,),
    ).fetchone()
    count = database.execute(
        "SELECT feature_count FROM gpkg_ogr_contents WHERE table_name = ?", (LAYER,)
    ).fetchone()
    same_frame = layer is not None and (
        not city.frame.is_utm or (layer[2].upper(), layer[3]) == ("EPSG", city.frame.epsg)
    )
    if (
        not same_frame
        or layer[1] != "POINT"
        or f"rtree_{LAYER}_{layer[0]}" not in tables
        or count is None
        or count[0] != city.statistics.poles
    ):
        return None
    return city


def _places(blobs: Sequence[bytes]) -> Floats:
    """Places `(n, 2)` of GeoPackage geometries.

    Raises:
        ValueError: something else than a point in the plane.
    """
    if any(not isinstance(blob, bytes) or len(blob) != _POINT.itemsize for blob in blobs):
        raise ValueError("a geometry that is no point in the plane")
    packed = np.frombuffer(b"".join(blobs), dtype=_POINT)
    head = (packed["magic"] == b"GP") & (packed["flags"] == _LITTLE_ENDIAN_WITHOUT_BOX)
    if not (head & (packed["order"] == 1) & (packed["type"] == _WKB_POINT)).all():
        raise ValueError("a geometry that is no point in the plane")
    return np.stack([packed["x"], packed["y"]], axis=1)
