"""Tables of plain points: GeoParquet as we write it, read column by column.

Nothing here needs geopandas, which takes a second and a hundred megabytes.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray
from pyproj import CRS
from pyproj.exceptions import CRSError

from polemap.drivelog.errors import InputError
from polemap.drivelog.frames import EarthFrame
from polemap.map.formats.columns import KNOWN, from_columns
from polemap.map.pole_map import PoleMap
from polemap.parsing.errors import ParsingError
from polemap.parsing.json_text import parse_json
from polemap.parsing.text import decoded

Floats = NDArray[np.float64]

_POINT = np.dtype([("order", "u1"), ("type", "<u4"), ("x", "<f8"), ("y", "<f8")])


def wkb(points: Floats) -> pa.Array:
    """Points `(n, 2)` as a column of WKB.

    Raises:
        InputError: more than such a column can hold.
    """
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


def in_frame(system: CRS | None, own: EarthFrame | None) -> bool:
    """Whether a reference system is that of a frame; local frames have none."""
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
    return in_frame(system, own) and is_numbers(schema)


def text_columns(table: pa.Table) -> list[str]:
    """Those that a dictionary makes smaller: others, all different, would only cost time."""
    return [field.name for field in table.schema if pa.types.is_string(field.type)]


def is_numbers(schema: pa.Schema) -> bool:
    """Whether the columns that a map knows hold numbers."""
    kinds = [field.type for field in schema if field.name in KNOWN]
    return all(pa.types.is_integer(kind) or pa.types.is_floating(kind) for kind in kinds)


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
