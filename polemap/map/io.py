"""Pole maps on the disk: GeoPackage, GeoJSON, GeoParquet; CSV and public inventories on reading.

The file's ending chooses the format. The frame is stored in every one of ours; `docs/maps.md` has
the columns.
"""

from __future__ import annotations

import json
import os
import sqlite3
import warnings
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import numpy as np

from polemap.drivelog.atomic import atomic_file
from polemap.drivelog.errors import FrameError, InputError, OutputError
from polemap.drivelog.frames import EarthFrame
from polemap.drivelog.landmark_kind import LandmarkKind, kind_counts
from polemap.drivelog.results.signature import check_signature
from polemap.drivelog.tables import read_table
from polemap.extras import check_installed, need
from polemap.map.city.packing import TILE_POLES
from polemap.map.city.parquet.io import write_tiles
from polemap.map.city.stored import CITY_POLES
from polemap.map.crowds import check_crowds
from polemap.map.formats import geojson, opendrive, osm
from polemap.map.formats.columns import KNOWN, from_columns
from polemap.map.formats.geopackage.layers import check_layers
from polemap.map.pole_map import PoleMap
from polemap.parsing.errors import ParsingError, named
from polemap.parsing.json_text import read_json
from polemap.parsing.text import MEGABYTE, read_bytes

# of a disk that is full or may not be written; those of pyogrio and osmium are RuntimeErrors
_LIBRARY_ERRORS = (OSError, RuntimeError, sqlite3.Error)


def check_writable(path: Path) -> None:
    """Refuse a name for a map that no format has, before the work begins.

    Raises:
        InputError: the ending is none of ours.
        OutputError: a GeoPackage that holds other layers, or another program's file stands there.
        MissingExtraError: the format needs a package that is not installed.
    """
    if Path(path).suffix.lower() not in _WRITERS:
        known = ", ".join(sorted(_WRITERS))
        raise InputError(f"{path}: a map is written as one of {known}; choose such an ending")
    if Path(path).suffix.lower() == ".parquet":
        check_installed("pyarrow")
    _check_replaceable(Path(path))


def _check_replaceable(path: Path) -> None:
    check_signature(path)
    if path.suffix.lower() == ".gpkg":
        check_layers(path)
    if path.suffix.lower() in (".geojson", ".json") and path.is_file():
        with suppress(InputError, ParsingError):  # what cannot be read was checked above
            others = geojson.foreign_features(read_json(path))
            if others:
                raise OutputError(
                    f"{path}: holds {others} features that are no landmarks, and would lose them; "
                    "name another file"
                )


def export_map(pole_map: PoleMap, path: Path) -> None:
    """Write a map in any format, those for other programs (.osm, .osm.pbf, .xodr) included.

    Raises:
        InputError: an ending that is not known, or a place that cannot be written to.
        FrameError: the format needs WGS84 and the map is in a local frame.
    """
    path = Path(path)
    writers = _WRITERS | _EXPORTERS
    if path.suffix.lower() not in writers:
        known = ", ".join(sorted(writers))
        raise InputError(f"{path}: a map is exported as one of {known}; choose such an ending")
    _check_replaceable(path)
    _warn_of_lost(pole_map, path)
    if path.suffix.lower() in _POLES_ALONE:
        # what other programs would take for a pole must be one
        pole_map = pole_map.rows(pole_map.kind == LandmarkKind.POLE)
    _write(pole_map, path, writers[path.suffix.lower()])


def write_map(pole_map: PoleMap, path: str | Path) -> None:
    """Write a map; the ending chooses the format, and a warning says what it has no place for.

    Raises:
        InputError: an ending that is not known, or a place that cannot be written to.
    """
    path = Path(path)
    check_writable(path)
    _warn_of_lost(pole_map, path)
    _write(pole_map, path, _WRITERS[path.suffix.lower()])


def _warn_of_lost(pole_map: PoleMap, path: Path) -> None:
    """Say what of a map has no place in a format."""
    suffix = path.suffix.lower()
    lost = [np.empty(0, dtype=np.int8)]
    if pole_map.lines is not None and suffix not in (*LINE_ENDINGS, ".xodr"):
        lost.append(pole_map.lines.kind)
    if suffix in _POLES_ALONE:
        lost.append(pole_map.kind[pole_map.kind != LandmarkKind.POLE])
    counted = kind_counts(np.concatenate(lost))
    if counted:
        warnings.warn(
            f"{path}: has no place for {counted}, which were left out; a "
            f"{' or '.join(LINE_ENDINGS)} keeps them",
            stacklevel=3,
        )


def _write(pole_map: PoleMap, path: Path, writer: Callable[[PoleMap, Path], None]) -> None:
    try:
        with atomic_file(path) as part:
            writer(pole_map, part)
    except _LIBRARY_ERRORS as error:
        said = getattr(error, "strerror", None) or str(error) or type(error).__name__
        reason = said.splitlines()[0][:100]
        raise OutputError(f"{path}: cannot be written ({reason})") from error


def read_map(
    path: str | Path, frame: EarthFrame | None = None, *, allow_empty: bool = False
) -> PoleMap:
    """Read a map, in the frame that is asked for.

    Args:
        path: the file.
        frame: the drive's frame. A CSV has none of its own and takes this one (with a note); a map
            in another UTM zone is transformed into it (with a note).
        allow_empty: accept a map without poles.

    Raises:
        InputError: unreadable, a column missing, a value out of range, no poles.
        FrameError: the map's frame is not the drive's, and no transformation leads there.
    """
    path = Path(path)
    # os.path, unlike pathlib, says that a name of 300 letters is no file
    if not os.path.isfile(path):
        raise InputError(f"{path}: no such map")
    suffix = path.suffix.lower()
    if suffix not in _READERS:
        known = ", ".join(sorted(_READERS))
        raise InputError(f"{path}: a map ends in one of {known}")
    try:
        with named(path, InputError, "map"):
            pole_map = _READERS[suffix](path, frame)
            check_crowds(pole_map)
    except InputError as error:
        if str(path) in str(error):
            raise
        raise InputError(f"{path}: {error}") from error
    lines = 0 if pole_map.lines is None else len(pole_map.lines)
    if not len(pole_map) and not lines and not allow_empty:
        raise InputError(f"{path}: the map holds no poles; build it from a drive that saw some")
    if frame is None or pole_map.frame == frame:
        return pole_map
    if not (frame.is_utm and pole_map.frame.is_utm):
        raise FrameError(
            f"{path}: the map is in {pole_map.frame}, the drive in {frame}; no transformation "
            "leads from one to the other: use a map built in the drive's own frame"
        )
    return pole_map.to_frame(frame)


def _write_geopackage(pole_map: PoleMap, path: Path) -> None:
    from polemap.map.formats.geopackage.io import write_geopackage  # geopandas is slow to import

    write_geopackage(pole_map, path)


def _read_geopackage(path: Path, frame: EarthFrame | None) -> PoleMap:
    from polemap.map.formats.geopackage.io import read_geopackage

    return read_geopackage(path, frame)


def _write_geojson(pole_map: PoleMap, path: Path) -> None:
    document = geojson.to_document(pole_map)
    path.write_text(json.dumps(document, allow_nan=False, separators=(",", ":")), encoding="utf-8")


def _read_geojson(path: Path, frame: EarthFrame | None) -> PoleMap:
    try:
        document = read_json(path)
    except ParsingError as error:
        raise InputError(f"{path}: {error}") from error
    return geojson.from_document(document, frame)


def _write_parquet(pole_map: PoleMap, path: Path) -> None:
    # what is no city is a single tile, in its own order
    write_tiles(pole_map, path, TILE_POLES if len(pole_map) >= CITY_POLES else CITY_POLES)


def _read_parquet(path: Path, frame: EarthFrame | None) -> PoleMap:
    pa, parquet = need("pyarrow"), need("pyarrow.parquet")
    from polemap.map.formats import geoparquet  # needs pyarrow, too

    try:
        table = parquet.read_table(path)
    except (pa.ArrowException, OSError) as error:
        detail = str(error).splitlines()[0][:100]
        raise InputError(f"{path}: not a Parquet file ({detail})") from error
    return geoparquet.from_table(table, frame)


def _read_csv(path: Path, frame: EarthFrame | None) -> PoleMap:
    """`east_m,north_m[,…]`; also `x_m,y_m`, as maps labelled in a local LiDAR frame have."""
    if frame is None:
        raise InputError(f"{path}: a CSV map carries no frame; give the drive that it belongs to")
    names = ("east_m", "north_m")
    optional = (*KNOWN, "diameter_m")
    header = read_table(path, (), optional=("x_m", "y_m", *names))
    if not frame.is_utm and "x_m" in header and "east_m" not in header:
        names = ("x_m", "y_m")
    table = read_table(path, names, optional=optional, drop_not_finite=False)
    columns = {name: table[name] for name in KNOWN if name in table}
    if "width_m" not in columns and "diameter_m" in table:
        columns["width_m"] = table["diameter_m"]
    points = np.stack([table[name] for name in names], axis=1)
    note = f"{path.name} carries no frame: it is taken to be in {frame}, the drive's"
    return from_columns(frame, points, columns, notes=(note,))


def _write_osm(pole_map: PoleMap, path: Path) -> None:
    path.write_bytes(osm.to_xml(pole_map))


def _read_osm(path: Path, frame: EarthFrame | None) -> PoleMap:
    return osm.from_xml(read_bytes(path, 1000 * MEGABYTE), frame)


def _write_pbf(pole_map: PoleMap, path: Path) -> None:
    osm.write_pbf(pole_map, str(path))


def _read_pbf(path: Path, frame: EarthFrame | None) -> PoleMap:
    return osm.read_pbf(str(path), frame)


def _write_opendrive(pole_map: PoleMap, path: Path) -> None:
    path.write_bytes(opendrive.to_xml(pole_map))


_READERS = {
    ".gpkg": _read_geopackage,
    ".geojson": _read_geojson,
    ".json": _read_geojson,
    ".parquet": _read_parquet,
    ".csv": _read_csv,
    ".osm": _read_osm,
    ".pbf": _read_pbf,
}
_WRITERS = {".gpkg": _write_geopackage, ".geojson": _write_geojson, ".parquet": _write_parquet}
# for other programs only: they keep less than the whole map
_EXPORTERS = {".osm": _write_osm, ".pbf": _write_pbf, ".xodr": _write_opendrive}
_POLES_ALONE = (".osm", ".pbf")
MAP_ENDINGS = tuple(sorted(_READERS))
LINE_ENDINGS = (".gpkg", ".geojson")
"""Of formats that hold lines, too, and are read again."""
