"""Layers that a GIS has written or edited: whose reference system counts, and what is a pole."""

from __future__ import annotations

from typing import Any

import geopandas
import numpy as np
import shapely
from numpy.typing import NDArray

from polemap.drivelog.errors import InputError
from polemap.drivelog.frames import EarthFrame
from polemap.map.formats.columns import KNOWN, from_columns, numbers_of
from polemap.map.pole_map import PoleMap


def map_from_layer(
    table: geopandas.GeoDataFrame,
    own: EarthFrame | None,
    frame: EarthFrame | None,
    next_id: int = 0,
) -> PoleMap:
    """A map from a layer of any format, with a note on all that had to be done for it.

    Args:
        own: the frame that our metadata name, if any.
        frame: the frame that is asked for, if any.
        next_id: the least id for poles that have none among others that have one.

    Raises:
        InputError: no points, no usable reference system, or values that a map refuses.
    """
    table, of_points = points_only(table)
    table, own, of_place = placed(table, own, frame)
    columns, extra, of_columns = split_columns(table)
    return from_columns(
        own,
        shapely.get_coordinates(table.geometry),
        columns,
        extra=extra,
        notes=(*of_points, *of_place, *of_columns),
        next_id=next_id,
    )


def placed(
    table: geopandas.GeoDataFrame, own: EarthFrame | None, frame: EarthFrame | None
) -> tuple[geopandas.GeoDataFrame, EarthFrame, list[str]]:
    """The layer in a frame of ours, that frame, and what had to be done for it.

    The reference system of the layer itself counts: a GIS that reprojects it keeps our metadata as
    they were.

    Args:
        own: the frame that our metadata name, if any.
        frame: the frame that is asked for, if any.

    Raises:
        InputError: no reference system and no frame, or one that cannot be transformed.
    """
    notes: list[str] = []
    system = table.crs
    if system is None:
        if own is None and frame is None:
            raise InputError("it names no reference system and no frame")
        return table, own or frame, notes  # type: ignore[return-value]
    code = system.to_epsg()
    said = f"EPSG:{code}" if code else str(system.name)[:60]
    if own is not None and code == own.epsg:
        return table, own, notes
    if own is not None:
        notes.append(f"its metadata say {own}, the layer itself {said}: the layer counts")
    if code is not None and not system.is_geographic and system.utm_zone is not None:
        return table, EarthFrame("utm", code), notes
    wanted = frame if frame is not None and frame.is_utm else None
    try:
        target = int(wanted.epsg or 0) if wanted else int(table.estimate_utm_crs().to_epsg() or 0)
        moved = table.to_crs(target)
    except (RuntimeError, ValueError) as error:
        raise InputError(f"its reference system {said} cannot be transformed ({error})") from error
    if len(moved) and not np.isfinite(shapely.get_coordinates(moved.geometry)).all():
        raise InputError(f"points of {said} have no place in EPSG:{target}")
    if not system.is_geographic:
        notes.append(f"transformed from {said} to EPSG:{target}")
    return moved, EarthFrame("utm", target), notes


def points_only(table: geopandas.GeoDataFrame) -> tuple[geopandas.GeoDataFrame, list[str]]:
    """Every part of a multipoint is a pole of its own; features without a place are left out.

    Raises:
        InputError: lines or areas.
    """
    notes: list[str] = []
    missing = table.geometry.isna() | table.geometry.is_empty
    if missing.any():
        notes.append(f"{int(missing.sum())} features without a place were left out")
        table = table[~missing]
    kinds = set(table.geom_type.unique())
    if kinds - {"Point", "MultiPoint"}:
        other = ", ".join(sorted(kinds - {"Point", "MultiPoint"}))
        raise InputError(f"it holds {other}; a pole map holds points")
    if "MultiPoint" in kinds:
        before = len(table)
        table = table.explode(index_parts=True)
        # the first part keeps the id; the others are given new ones
        further = table.index.get_level_values(-1).to_numpy() > 0
        table = table.reset_index(drop=True)
        if "id" in table.columns and further.any():
            table["id"] = table["id"].astype(object)
            table.loc[further, "id"] = None
        notes.append(f"{before} multipoints hold {len(table)} points: each is a pole")
    if shapely.has_z(table.geometry.to_numpy()).any():
        notes.append("heights of the points (z) are not used")
    return table, notes


def split_columns(
    table: geopandas.GeoDataFrame,
) -> tuple[dict[str, NDArray[Any]], dict[str, NDArray[Any]], list[str]]:
    """Columns that a map knows, the others, and notes; NULL is NaN in numbers and "" in texts.

    Raises:
        InputError: a known column that holds something else than numbers.
    """
    known: dict[str, NDArray[Any]] = {}
    extra: dict[str, NDArray[Any]] = {}
    notes: list[str] = []
    for name in table.columns:
        if name == table.geometry.name:
            continue
        column = table[name]
        values = column.to_numpy()
        if values.dtype.kind in "iuf":
            (known if name in KNOWN else extra)[str(name)] = values
            continue
        texts = np.array(["" if v is None or v != v else str(v) for v in values], dtype=np.str_)
        if name not in KNOWN:
            extra[str(name)] = texts
            continue
        numbers, of_ids = numbers_of(str(name), texts)
        notes += of_ids
        (extra if of_ids else known)["id_text" if of_ids else str(name)] = numbers
    return known, extra, notes
