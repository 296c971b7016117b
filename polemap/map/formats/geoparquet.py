"""Pole maps as GeoParquet 1.1: WKB points that load without a loop over the poles."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import geopandas
import pyarrow as pa
import shapely
from pyproj import CRS
from pyproj.exceptions import CRSError

from polemap.drivelog.errors import InputError
from polemap.drivelog.frames import EarthFrame
from polemap.map.formats import geojson
from polemap.map.formats.columns import to_columns
from polemap.map.formats.geoparquet_points import in_frame, is_numbers, plain_map, wkb
from polemap.map.formats.layers import map_from_layer
from polemap.map.pole_map import PoleMap
from polemap.parsing.json_text import parse_json
from polemap.parsing.text import decoded


def to_table(pole_map: PoleMap) -> pa.Table:
    """The map as a table whose metadata names the geometry's reference system and our frame."""
    columns = {name: pa.array(values) for name, values in to_columns(pole_map).items()}
    columns["geometry"] = wkb(pole_map.points_m)
    return pa.table(columns).replace_schema_metadata(metadata_of(pole_map))


def metadata_of(pole_map: PoleMap) -> dict[str, str]:
    """What a map's table says of its geometries, its frame and its doubtful poles."""
    frame = pole_map.frame
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
    return {"geo": json.dumps(geo), "polemap": json.dumps(ours)}


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
    as_ours = in_frame(system, own) and is_numbers(table.schema)
    plain = plain_map(table, name, own, next_id) if own is not None and as_ours else None
    if plain is None:
        plain = map_from_layer(_layer(table, name, system), own, frame, next_id)
    pole_map = plain
    if doubtful is None:
        return pole_map
    return replace(pole_map, doubtful=doubtful.to_frame(pole_map.frame))


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
