"""Pole maps as GeoParquet 1.1: WKB points that load without a loop over the poles."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import geopandas
import numpy as np
import pyarrow as pa
import shapely
from numpy.typing import NDArray
from pyproj import CRS
from pyproj.exceptions import CRSError

from polemap.drivelog.errors import InputError
from polemap.drivelog.frames import EarthFrame
from polemap.map.formats import geojson
from polemap.map.formats.columns import KNOWN, from_columns, to_columns
from polemap.map.formats.layers import map_from_layer
from polemap.map.pole_map import PoleMap
from polemap.parsing.errors import ParsingError
from polemap.parsing.json_text import parse_json
from polemap.parsing.text import decoded

Floats = NDArray[np.float64]

_POINT = np.dtype([("order", "u1"), ("type", "<u4"), ("x", "<f8"), ("y", "<f8")])


def to_table(pole_map: PoleMap) -> pa.Table:
    """The map as a table whose metadata names the geometry's reference system and our frame."""
    frame = pole_map.frame
    columns = {name: pa.array(values) for name, values in to_columns(pole_map).items()}
    columns["geometry"] = _wkb(pole_map.points_m)
    table = pa.table(columns)
    geo: dict[str, Any] = {
        "version": "1.1.0",
        "primary_column": "geometry",
        "columns": {
            "geometry": {
                "encoding": "WKB",
                "geometry_types": ["Point"],
                "crs": CRS.from_epsg(frame.epsg).to_json_dict() if frame.epsg else None,
            }
        },
    }
    if len(pole_map):
        low, high = pole_map.points_m.min(axis=0), pole_map.points_m.max(axis=0)
        geo["columns"]["geometry"]["bbox"] = [*low.tolist(), *high.tolist()]
    ours: dict[str, Any] = {"format_version": 1, "frame": frame.to_dict()}
    if pole_map.doubtful is not None and len(pole_map.doubtful):
        ours["doubtful"] = geojson.to_document(pole_map.doubtful)
    return table.replace_schema_metadata({"geo": json.dumps(geo), "polemap": json.dumps(ours)})


def _wkb(points: Floats) -> pa.Array:
    packed = np.empty(len(points), dtype=_POINT)
    packed["order"], packed["type"] = 1, 1
    packed["x"], packed["y"] = points[:, 0], points[:, 1]
    offsets = np.arange(len(points) + 1, dtype=np.int32) * _POINT.itemsize
    if len(points) * _POINT.itemsize >= 2**31:
        raise InputError(
            "a map of over 100 million poles does not fit one Parquet column: split it"
        )
    return pa.Array.from_buffers(
        pa.binary(), len(points), [None, pa.py_buffer(offsets), pa.py_buffer(packed)]
    )


def from_table(table: pa.Table, frame: EarthFrame | None) -> PoleMap:
    """A map from a table of ours, or from any GeoParquet of points.

    A table as we write it is read column by column; one that a GIS has edited, reprojected or made
    goes the way of every other layer.

    Raises:
        InputError: no geometry, no frame, or geometries that are not points.
    """
    metadata = {key.decode(): value for key, value in (table.schema.metadata or {}).items()}
    try:
        geo = parse_json(decoded(metadata.get("geo", b"{}")))
        ours = parse_json(decoded(metadata.get("polemap", b"{}")))
        name = geo.get("primary_column", "geometry")
        about = geo.get("columns", {}).get(name, {})
        encoding = about.get("encoding", "WKB")
        # the specification: none stated is longitude and latitude, null is not known
        crs = about.get("crs", "OGC:CRS84" if about else None)
    except (ValueError, AttributeError) as error:
        raise InputError(f"the geo metadata cannot be read ({error})") from error
    if name not in table.column_names:
        raise InputError(f"column '{name}' is missing, it must hold the points")
    if encoding != "WKB":
        raise InputError(f"its points are encoded as '{str(encoding)[:20]}'; write them as WKB")
    own = EarthFrame.from_dict(ours["frame"]) if "frame" in ours else None
    try:
        system = None if crs is None else CRS.from_user_input(crs)
    except CRSError as error:
        raise InputError(f"its reference system cannot be read ({str(error)[:80]})") from error
    doubtful = geojson.from_document(ours["doubtful"], frame) if "doubtful" in ours else None
    next_id = int(doubtful.ids.max()) + 1 if doubtful is not None and len(doubtful) else 0
    as_ours = _in_frame(system, own) and _is_numbers(table.schema)
    plain = plain_map(table, name, own, next_id) if own is not None and as_ours else None
    if plain is None:
        plain = map_from_layer(_layer(table, name, system), own, frame, next_id)
    pole_map = plain
    if doubtful is None:
        return pole_map
    return replace(pole_map, doubtful=doubtful.to_frame(pole_map.frame))


def _in_frame(system: CRS | None, own: EarthFrame | None) -> bool:
    if own is None or own.epsg is None or system is None:
        return own is not None and own.epsg is None and system is None
    return bool(system.to_epsg() == own.epsg)


def plain_map(table: pa.Table, name: str, own: EarthFrame, next_id: int = 0) -> PoleMap | None:
    """The rows of a table as we write it; None where the column `name` is not all plain points."""
    points = _plain_points(table.column(name))
    if points is None:
        return None
    columns: dict[str, NDArray[Any]] = {}
    extra: dict[str, NDArray[Any]] = {}
    for column in table.column_names:
        values = None if column == name else _numpy(table.column(column))
        if values is not None:
            (columns if column in KNOWN else extra)[column] = values
    return from_columns(own, points, columns, extra=extra, next_id=next_id)


def is_plain(schema: pa.Schema, own: EarthFrame) -> bool:
    """Whether a file's geometry is in the frame `own`, and its known columns are numbers."""
    try:
        geo = parse_json(decoded((schema.metadata or {}).get(b"geo", b"{}")))
        crs = geo["columns"][geo["primary_column"]]["crs"]
        system = None if crs is None else CRS.from_user_input(crs)
    except (ParsingError, CRSError, KeyError, TypeError, ValueError):
        return False
    return _in_frame(system, own) and _is_numbers(schema)


def text_columns(table: pa.Table) -> list[str]:
    """Those that a dictionary makes smaller: others, all different, would only cost time."""
    return [field.name for field in table.schema if pa.types.is_string(field.type)]


def _is_numbers(schema: pa.Schema) -> bool:
    """Whether the columns that a map knows hold numbers."""
    kinds = [field.type for field in schema if field.name in KNOWN]
    return all(pa.types.is_integer(kind) or pa.types.is_floating(kind) for kind in kinds)


def _layer(table: pa.Table, name: str, system: CRS | None) -> geopandas.GeoDataFrame:
    """The table as a layer; columns of structures and lists have no place in a map.

    Raises:
        InputError: geometries that are no WKB.
    """
    flat = [
        field.name
        for field in table.schema
        if field.name != name and not pa.types.is_nested(field.type)
    ]
    try:
        geometry = shapely.from_wkb(table.column(name).to_numpy())
    except (shapely.errors.ShapelyError, TypeError) as error:
        raise InputError(f"column '{name}' holds no WKB ({str(error)[:60]})") from error
    return geopandas.GeoDataFrame(table.select(flat).to_pandas(), geometry=geometry, crs=system)


def _plain_points(column: pa.ChunkedArray) -> Floats | None:
    """Places `(n, 2)` of little-endian 2-D points, None where some are something else."""
    array = column.combine_chunks() if column.num_chunks != 1 else column.chunk(0)
    if isinstance(array, pa.ChunkedArray):
        array = pa.concat_arrays(array.chunks) if array.num_chunks else pa.array([], pa.binary())
    n = len(array)
    points = np.empty((n, 2))
    if not n:
        return points
    if array.null_count or not (
        pa.types.is_binary(array.type) or pa.types.is_large_binary(array.type)
    ):
        return None
    array = array.cast(pa.large_binary()) if array.type != pa.large_binary() else array
    offsets = np.frombuffer(array.buffers()[1], dtype=np.int64)[array.offset : array.offset + n + 1]
    start, end = int(offsets[0]), int(offsets[-1])
    if end - start != n * _POINT.itemsize or (np.diff(offsets) != _POINT.itemsize).any():
        return None
    packed = np.frombuffer(array.buffers()[2], dtype=_POINT, count=n, offset=start)
    if (packed["order"] != 1).any() or (packed["type"] != 1).any():
        return None
    points[:, 0], points[:, 1] = packed["x"], packed["y"]
    return points if np.isfinite(points).all() else None


def _numpy(column: pa.ChunkedArray) -> NDArray[Any] | None:
    if pa.types.is_integer(column.type) and not column.null_count:
        return np.asarray(column.to_numpy())
    if pa.types.is_float32(column.type) and not column.null_count:
        return np.asarray(column.to_numpy())
    if pa.types.is_integer(column.type) or pa.types.is_floating(column.type):
        return np.asarray(column.to_numpy(), dtype=np.float64)
    if pa.types.is_string(column.type) or pa.types.is_large_string(column.type):
        return np.array([value or "" for value in column.to_pylist()], dtype=np.str_)
    return None
