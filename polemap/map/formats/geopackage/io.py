"""GeoPackage: a layer of poles, one of doubtful ones, the frame in their metadata, a QGIS style."""

from __future__ import annotations

import json
import sqlite3
import warnings
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import geopandas
import numpy as np
import pyogrio
import shapely

from polemap.drivelog.errors import InputError
from polemap.drivelog.frames import EarthFrame
from polemap.map.city.geopackage.io import LAYER, describe_city
from polemap.map.city.packing import packed_order
from polemap.map.city.statistics import MapStatistics
from polemap.map.city.stored import CITY_POLES, StoredCity
from polemap.map.formats import qgis
from polemap.map.formats.columns import to_columns
from polemap.map.formats.geopackage.layers import DOUBTFUL
from polemap.map.formats.layers import map_from_layer
from polemap.map.formats.lines import LINES, are_ours, as_text, from_features, properties_of
from polemap.map.line_map import LineMap
from polemap.map.pole_map import PoleMap
from polemap.parsing.errors import ParsingError, short
from polemap.parsing.json_text import parse_json

_SQLITE = b"SQLite format 3\0"
# a table of points costs the library a kilobyte a row
_ROWS_AT_ONCE = 1_000_000


def write_geopackage(pole_map: PoleMap, path: Path) -> None:
    """Write a map as a layer of poles, one of doubtful ones where there are any, and its style.

    The poles of a city stand in the order of tiles, so that neighbours share pages of the disk.
    """
    layers = [LAYER]
    _write_poles(pole_map, path)
    if pole_map.doubtful is not None and len(pole_map.doubtful):
        layers.append(DOUBTFUL)
        _write_layer(pole_map.doubtful, path, DOUBTFUL)
    # styles are of layers of poles; lines are drawn as the program likes
    rows = qgis.style_rows(
        {name: pyogrio.read_info(path, name)["geometry_name"] for name in layers}
    )
    if pole_map.lines is not None and len(pole_map.lines):
        _write_lines(pole_map.lines, path)
    with closing(sqlite3.connect(path)) as database, database:
        database.execute(qgis.TABLE)
        database.execute(qgis.REGISTER)
        database.executemany(qgis.INSERT, rows)
        for statement in qgis.STAMPS:
            database.execute(statement)


def _write_poles(pole_map: PoleMap, path: Path) -> None:
    """Write the layer of poles such that it can be read by tiles."""
    packed = pole_map
    if len(pole_map) >= CITY_POLES:
        packed = pole_map.rows(packed_order(pole_map.points_m))
    _write_layer(packed.rows(slice(0, _ROWS_AT_ONCE)), path, LAYER)
    for start in range(_ROWS_AT_ONCE, len(packed), _ROWS_AT_ONCE):
        part = packed.rows(slice(start, start + _ROWS_AT_ONCE))
        _write_layer(part, path, LAYER, append=True)
    describe_city(path, StoredCity(packed.frame, MapStatistics.of(packed), {}))


def _write_layer(pole_map: PoleMap, path: Path, layer: str, *, append: bool = False) -> None:
    frame = pole_map.frame
    points = shapely.points(pole_map.points_m)
    table = geopandas.GeoDataFrame(
        to_columns(pole_map), geometry=points, crs=frame.epsg if frame.is_utm else None
    )
    metadata = {"polemap": json.dumps({"format_version": 1, "frame": frame.to_dict()})}
    with warnings.catch_warnings():
        # a local frame has no reference system that other programs know; the metadata name it
        warnings.filterwarnings("ignore", message="'crs' was not provided")
        pyogrio.write_dataframe(
            table, path, layer=layer, driver="GPKG", geometry_type="Point",
            layer_metadata=metadata, append=append,
        )  # fmt: skip


def _write_lines(lines: LineMap, path: Path) -> None:
    frame = lines.frame
    ends = np.cumsum(lines.count)[:-1]
    shapes = [shapely.linestrings(points) for points in np.split(lines.vertices_m, ends)]
    rows = [as_text(told) for told in properties_of(lines)]
    columns = {name: [row[name] for row in rows] for name in rows[0]}
    crs = frame.epsg if frame.is_utm else None
    table = geopandas.GeoDataFrame(columns, geometry=shapes, crs=crs)
    metadata = {"polemap": json.dumps({"format_version": 1, "frame": frame.to_dict()})}
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="'crs' was not provided")
        pyogrio.write_dataframe(
            table, path, layer=LINES, driver="GPKG", geometry_type="LineString",
            layer_metadata=metadata,
        )  # fmt: skip


def _read_lines(path: Path, frame: EarthFrame) -> LineMap:
    """The layer of lines, in the frame of the map.

    Raises:
        InputError: a row that is no line, or values that no line has.
    """
    table = pyogrio.read_dataframe(path, layer=LINES)
    # a GIS that exports the layer makes each line a multiline of one part
    single = shapely.get_num_geometries(table.geometry.to_numpy()) == 1
    parts = shapely.get_geometry(table.geometry.to_numpy(), 0)
    table = table.set_geometry(np.where(single, parts, table.geometry.to_numpy()), crs=table.crs)
    wrong = table.geometry.geom_type != "LineString"
    if wrong.any():
        raise InputError(f"{path}: layer '{LINES}' has a row that is no line; delete it there")
    if table.crs is not None and frame.is_utm and table.crs.to_epsg() != frame.epsg:
        table = table.to_crs(frame.epsg)
    vertices = [shapely.get_coordinates(shape) for shape in table.geometry]
    rows = table.drop(columns="geometry").to_dict("records")
    return from_features(frame, vertices, rows)


def read_geopackage(path: Path, frame: EarthFrame | None) -> PoleMap:
    """Read a map; the first layer of points where none is called poles.

    Args:
        path: the file.
        frame: of a file that does not name its own.

    Raises:
        InputError: no GeoPackage, or no layer of points in it.
    """
    with path.open("rb") as file:
        if file.read(len(_SQLITE)) != _SQLITE:
            # the library would look for any other format that it knows, and follow what that names
            raise InputError(f"{path}: not a GeoPackage (no SQLite database)")
    with warnings.catch_warnings(record=True) as warned:
        # the library says the same for every time that it opens the file
        warnings.simplefilter("always")
        pole_map = _read_layers(path, frame)
    said = tuple(dict.fromkeys(" ".join(str(one.message).split())[:200] for one in warned))
    return replace(pole_map, notes=(*pole_map.notes, *said))


def _read_layers(path: Path, frame: EarthFrame | None) -> PoleMap:
    try:
        # tables without geometry (styles, say) are no layers of poles
        layers = [str(name) for name, kind in pyogrio.list_layers(path) if kind is not None]
        if layers == [DOUBTFUL]:
            raise InputError(
                f"{path}: the layer '{LAYER}' is missing, '{DOUBTFUL}' alone is no map; restore it"
            )
        of_lines, layers = LINES in layers and LAYER in layers, [*layers]
        if of_lines:
            layers.remove(LINES)
        layer = LAYER if LAYER in layers else next(name for name in layers if name != DOUBTFUL)
        doubtful, next_id = None, 0
        if layer == LAYER and DOUBTFUL in layers:
            doubtful = _read_layer(path, DOUBTFUL, frame)
            next_id = int(doubtful.ids.max()) + 1 if len(doubtful) else 0
        pole_map = _read_layer(path, layer, frame, next_id)
        if doubtful is not None:
            pole_map = replace(pole_map, doubtful=doubtful.to_frame(pole_map.frame))
        if not of_lines:
            return pole_map
        if not are_ours(pyogrio.read_info(path, layer=LINES)["fields"].tolist()):
            said = f"its layer '{LINES}' has not the columns of a map's lines and is not used"
            return replace(pole_map, notes=(*pole_map.notes, said))
        return replace(pole_map, lines=_read_lines(path, pole_map.frame))
    except (pyogrio.errors.DataSourceError, pyogrio.errors.DataLayerError, StopIteration) as error:
        raise InputError(
            f"{path}: not a GeoPackage with a layer of points ({short(error)})"
        ) from error


def _read_layer(path: Path, layer: str, frame: EarthFrame | None, next_id: int = 0) -> PoleMap:
    ours = (pyogrio.read_info(path, layer=layer).get("layer_metadata") or {}).get("polemap")
    table = pyogrio.read_dataframe(path, layer=layer)
    if not isinstance(table, geopandas.GeoDataFrame):
        raise InputError(f"{path}: layer '{layer}' holds no points")
    try:
        own = EarthFrame.from_dict(parse_json(ours)["frame"]) if ours else None
    except (ParsingError, ValueError, KeyError, TypeError) as error:
        raise InputError(f"{path}: the frame in its metadata cannot be read ({error})") from error
    return map_from_layer(table, own, frame, next_id)
