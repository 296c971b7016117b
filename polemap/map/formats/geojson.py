"""Pole maps as GeoJSON (RFC 7946): WGS84 positions, the grid coordinates beside them.

A map in a local frame cannot be WGS84: its positions are the local metres, and the member
`polemap` says so.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pyproj import CRS, Transformer
from pyproj.exceptions import ProjError

from polemap.drivelog.errors import InputError
from polemap.drivelog.frames import (
    WGS84,
    EarthFrame,
    geographic_from_grid,
    grid_from_geographic,
    utm_frame,
)
from polemap.map.formats.columns import KNOWN, from_columns, numbers_of, to_columns
from polemap.map.formats.lines import are_ours, from_features, properties_of
from polemap.map.line_map import LineMap
from polemap.map.pole_map import KIND_COLUMN, PoleMap

Floats = NDArray[np.float64]
# further than the earth reaches round
LARGEST_M = 1e9

# ten decimals of a degree, or five of a metre, are nearer than this
_SAME_PLACE_M = 0.001


def to_document(pole_map: PoleMap) -> dict[str, Any]:
    """The map as a FeatureCollection."""
    if pole_map.frame.is_utm:
        place = geographic_from_grid(pole_map.frame, pole_map.points_m)
        positions = np.round(place[:, ::-1], 10)
    else:
        positions = np.round(pole_map.points_m, 5)
    columns = to_columns(pole_map)
    columns["east_m"], columns["north_m"] = pole_map.points_m[:, 0], pole_map.points_m[:, 1]
    values = {name: _plain(column) for name, column in columns.items()}
    features = [
        {
            "type": "Feature",
            "id": int(pole_map.ids[row]),
            "geometry": {"type": "Point", "coordinates": positions[row].tolist()},
            "properties": {name: column[row] for name, column in values.items()},
        }
        for row in range(len(pole_map))
    ]
    if pole_map.lines is not None and len(pole_map.lines):
        features += _line_features(pole_map.lines)
    ours: dict[str, Any] = {"format_version": 1, "frame": pole_map.frame.to_dict()}
    if pole_map.doubtful is not None and len(pole_map.doubtful):
        ours["doubtful"] = to_document(pole_map.doubtful)
    document: dict[str, Any] = {"type": "FeatureCollection", "polemap": ours}
    if not pole_map.frame.is_utm:
        # without it other programs take local metres for degrees of WGS84; GDAL reads the name
        name = str(pole_map.frame.name).replace('"', "'")
        system = f'LOCAL_CS["{name}",UNIT["metre",1]]'
        document["crs"] = {"type": "name", "properties": {"name": system}}
    return {**document, "features": features}


def _line_features(lines: LineMap) -> list[dict[str, Any]]:
    """Lines beside the points; the grid coordinates of their vertices stand in `grid_m`."""
    grid = lines.vertices_m
    place = geographic_from_grid(lines.frame, grid)[:, ::-1] if lines.frame.is_utm else grid
    ends = np.cumsum(lines.count)[:-1]
    positions = np.split(np.round(place, 10 if lines.frame.is_utm else 5), ends)
    return [
        {
            "type": "Feature",
            "geometry": {"type": "LineString", "coordinates": shape.tolist()},
            "properties": {**told, "grid_m": points.tolist()},
        }
        for told, shape, points in zip(
            properties_of(lines), positions, np.split(grid, ends), strict=True
        )
    ]


def _lines_of(
    features: list[Any], frame: EarthFrame, system: Any
) -> tuple[LineMap | None, tuple[str, ...]]:
    """The lines of a map of ours, None where it has none, and a note on those moved by hand.

    Args:
        system: the document's member `crs`.

    Raises:
        InputError: positions that are none, or values that no line has.
    """
    vertices, told, moved = [], [], 0
    for row, feature in enumerate(features):
        if not _is_line(feature):
            continue
        parts = _vertices(feature, row)
        places = np.array([_position(part, row) for part in parts], np.float64).reshape(-1, 2)
        if frame.is_utm and len(places):
            places = _in_wgs84(system, places)[0]
            places = grid_from_geographic(frame, places[:, 1], places[:, 0])
        properties = _properties(feature, row)
        given = properties.get("grid_m")
        if isinstance(given, list):
            grid = np.array([_position(part, row) for part in given]).reshape(-1, 2)
            same = np.zeros(len(places), dtype=bool)
            if len(grid) == len(places):
                same = np.hypot(*(grid - places).T) < _SAME_PLACE_M
                places = np.where(same[:, None], grid, places)
            moved += not same.all()
        vertices.append(places)
        told.append(properties)
    notes = (f"{moved} lines do not run through their grid_m: they were moved by hand, and their "
             "vertices count",) if moved else ()  # fmt: skip
    return (from_features(frame, vertices, told) if told else None), notes


def _is_line(feature: Any) -> bool:
    """Whether a feature is a line of a map; other lines are left out as other shapes are."""
    told = feature.get("properties") if isinstance(feature, dict) else None
    return isinstance(told, dict) and are_ours(told)


def _vertices(feature: Any, row: int) -> list[Any]:
    """Positions of a line; a GIS writes each as a multiline of one part.

    Raises:
        InputError: another shape, or several parts.
    """
    geometry = _geometry(feature)
    kind, coordinates = geometry.get("type"), geometry.get("coordinates")
    if kind == "MultiLineString" and isinstance(coordinates, list) and len(coordinates) == 1:
        kind, coordinates = "LineString", coordinates[0]
    if kind != "LineString" or not isinstance(coordinates, list):
        raise InputError(
            f"feature {row}: a line landmark whose shape is {str(kind)[:40]}; draw it as one line, "
            "or delete it"
        )
    return coordinates


def _plain(column: NDArray[Any]) -> list[Any]:
    """JSON has no NaN: unknown is null."""
    if column.dtype.kind == "f":
        return [value if math.isfinite(value) else None for value in column.astype(float).tolist()]
    return list(column.tolist())


def foreign_features(document: Any) -> int:
    """How many features of a document a map would not hold: neither points nor its own lines."""
    features = document.get("features") if isinstance(document, dict) else None
    kinds = [
        _geometry(one).get("type")
        for one in (features if isinstance(features, list) else [])
        if not _is_line(one)
    ]
    return sum(kind not in ("Point", "MultiPoint") for kind in kinds)


def from_document(document: Any, frame: EarthFrame | None) -> PoleMap:
    """A map of ours, or a public inventory of points, from a parsed document.

    Without our member `polemap` the positions are WGS84, and the poles are placed in `frame` if
    that is a UTM zone, else in the zone of the first one.

    Raises:
        InputError: no FeatureCollection, or a feature without a usable point.
    """
    if not isinstance(document, dict) or document.get("type") != "FeatureCollection":
        raise InputError("no GeoJSON FeatureCollection")
    features = document.get("features")
    if not isinstance(features, list):
        raise InputError("the FeatureCollection has no features")
    ours, lines = document.get("polemap"), None
    of_lines: tuple[str, ...] = ()
    if isinstance(ours, dict) and isinstance(ours.get("frame"), dict):
        own_frame = EarthFrame.from_dict(ours["frame"])
        lines, of_lines = _lines_of(features, own_frame, document.get("crs"))
        features = [feature for feature in features if lines is None or not _is_line(feature)]
    positions, properties, notes = _points(features)
    positions, of_system = _in_wgs84(document.get("crs"), positions)
    notes = (*notes, *of_system, *of_lines)
    if isinstance(ours, dict) and isinstance(ours.get("frame"), dict):
        own_frame = EarthFrame.from_dict(ours["frame"])
        if {"east_m", "north_m"} <= set(properties[0] if properties else ()):
            positions, moved = _grid_positions(own_frame, positions, properties)
            if moved:
                notes = (*notes, f"{moved} points do not stand at their east_m and north_m: they "
                         "were moved or added by hand, and the point counts")  # fmt: skip
        elif own_frame.is_utm:
            positions = grid_from_geographic(own_frame, positions[:, 1], positions[:, 0])
        doubtful = from_document(ours["doubtful"], frame) if "doubtful" in ours else None
        next_id = int(doubtful.ids.max()) + 1 if doubtful is not None and len(doubtful) else 0
        pole_map = _build(own_frame, positions, properties, notes, next_id)
        return replace(pole_map, doubtful=doubtful, lines=lines)
    return from_inventory(positions, properties, frame, notes)


def _points(features: list[Any]) -> tuple[Floats, list[Mapping[str, Any]], tuple[str, ...]]:
    """Positions `(n, 2)` and properties of the points, and notes on the other features.

    Every part of a multipoint is a point of its own; the first one keeps the id.
    """
    positions: list[list[float]] = []
    properties: list[Mapping[str, Any]] = []
    several, solid, skipped = [0, 0], False, 0
    for row, feature in enumerate(features):
        geometry = _geometry(feature)
        kind, coordinates = geometry.get("type"), geometry.get("coordinates")
        if kind not in ("Point", "MultiPoint"):
            skipped += 1
            continue
        parts = coordinates if kind == "MultiPoint" and isinstance(coordinates, list) else None
        if parts is not None:
            several = [several[0] + 1, several[1] + len(parts)]
        for number, part in enumerate([coordinates] if parts is None else parts):
            positions.append(_position(part, row))
            solid |= len(part) > 2
            own = _properties(feature, row)
            properties.append({**own, "id": None} if number and "id" in own else own)
    notes = [f"{skipped} features that are not points were left out"] if skipped else []
    if several[0]:
        notes.append(f"{several[0]} multipoints hold {several[1]} points: each is a pole")
    if solid:
        notes.append("heights of the points (z) are not used")
    return np.array(positions, dtype=np.float64).reshape(-1, 2), properties, tuple(notes)


def _in_wgs84(member: Any, positions: Floats) -> tuple[Floats, tuple[str, ...]]:
    """Positions `(n, 2)` as longitude and latitude where the document names another system.

    The member is of the GeoJSON before RFC 7946, which GIS still write; ours names local metres.

    Raises:
        InputError: a system that cannot be read, or in which the positions have no place.
    """
    properties = member.get("properties") if isinstance(member, dict) else None
    name = properties.get("name") if isinstance(properties, dict) else None
    if not isinstance(name, str) or name.startswith("LOCAL_CS"):
        return positions, ()
    try:
        system = CRS.from_user_input(name)
        if system.is_geographic and system.to_epsg() in (None, WGS84) and "84" in system.name:
            return positions, ()
        move = Transformer.from_crs(system, WGS84, always_xy=True)
    except ProjError as error:
        raise InputError(f"its reference system '{name[:40]}' cannot be read") from error
    degrees = len(positions) > 0 and bool((np.abs(positions) <= (180.0, 90.0)).all())
    if system.is_projected and degrees and np.ptp(positions, axis=0).max() < 1.0:
        raise InputError(
            f"its member crs names '{name[:40]}', in metres, and its positions are degrees; "
            "delete that member"
        )
    moved = np.stack(move.transform(positions[:, 0], positions[:, 1]), axis=1)
    if not np.isfinite(moved).all():
        raise InputError(f"positions have no place in its reference system '{name[:40]}'")
    return moved, (f"transformed from {system.name[:60]}, which its member crs names",)


def _grid_positions(
    frame: EarthFrame, positions: Floats, properties: Sequence[Mapping[str, Any]]
) -> tuple[Floats, int]:
    """Grid coordinates `(n, 2)`, to full digits where the point stands at them, and the number of
    the others: a GIS moves the point alone.
    """
    points = positions
    if frame.is_utm and len(positions):
        points = grid_from_geographic(frame, positions[:, 1], positions[:, 0])
    rows = [
        [
            math.nan if p.get(name) is None else _metres(p, name, row)
            for name in ("east_m", "north_m")
        ]
        for row, p in enumerate(properties)
    ]
    given = np.array(rows, dtype=np.float64).reshape(-1, 2)
    same = np.hypot(*(given - points).T) < _SAME_PLACE_M
    return np.where(same[:, None], given, points), int(np.count_nonzero(~same))


def from_inventory(
    longitude_latitude: Floats,
    properties: Sequence[Mapping[str, Any]],
    frame: EarthFrame | None,
    notes: tuple[str, ...],
) -> PoleMap:
    """A first map from WGS84 points `(n, 2)` that were not made by us."""
    if len(longitude_latitude) and np.abs(longitude_latitude[:, 1]).max() > 90.0:
        raise InputError(
            "a latitude beyond 90 degrees: positions must be WGS84 longitude, latitude"
        )
    if frame is None or not frame.is_utm:
        if not len(longitude_latitude):
            raise InputError("no points in it")
        longitude, latitude = longitude_latitude[0]
        frame = utm_frame(float(latitude), float(longitude))
    points = grid_from_geographic(frame, longitude_latitude[:, 1], longitude_latitude[:, 0])
    return _build(frame, points, properties, (*notes, f"imported inventory, placed in {frame}"))


def _geometry(feature: Any) -> dict[str, Any]:
    geometry = feature.get("geometry") if isinstance(feature, dict) else None
    return geometry if isinstance(geometry, dict) else {}


def _position(coordinates: Any, row: int) -> list[float]:
    position = []
    if isinstance(coordinates, list) and all(map(_is_number, coordinates[:2])):
        position = [float(value) for value in coordinates[:2]]
    if len(position) != 2 or not all(math.isfinite(value) for value in position):
        raise InputError(f"feature {row}: coordinates {str(coordinates)[:40]} are no position")
    return position


def _properties(feature: Mapping[str, Any], row: int) -> Mapping[str, Any]:
    properties = feature.get("properties")
    if properties is None:
        return {}
    if not isinstance(properties, dict):
        raise InputError(f"feature {row}: properties {str(properties)[:40]} are no object")
    return properties


def _metres(properties: Mapping[str, Any], name: str, row: int) -> float:
    value: Any = properties.get(name)
    if not _is_number(value) or not abs(value) <= LARGEST_M:
        raise InputError(
            f"feature {row}: {name} is '{str(value)[:40]}', not a number of metres up to "
            f"{LARGEST_M:g}"
        )
    return float(value)


def _is_number(value: Any) -> bool:
    """Whether a value of JSON is a number that an array can hold."""
    whole = isinstance(value, int) and not isinstance(value, bool) and abs(value) < 2**63
    return whole or isinstance(value, float)


def _build(
    frame: EarthFrame,
    points: Floats,
    properties: Sequence[Mapping[str, Any]],
    notes: tuple[str, ...],
    next_id: int = 0,
) -> PoleMap:
    names = {name for entry in properties for name in entry} - {"east_m", "north_m"}
    columns: dict[str, NDArray[Any]] = {}
    extra: dict[str, NDArray[Any]] = {}
    for name in sorted(names):
        column = [entry.get(name) for entry in properties]
        numeric = all(v is None or isinstance(v, bool) or _is_number(v) for v in column)
        if name in KNOWN and not numeric:
            texts = np.array(["" if v is None else str(v) for v in column], dtype=np.str_)
            values, of_ids = numbers_of(name, texts)
            notes = (*notes, *of_ids)
            (extra if of_ids else columns)["id_text" if of_ids else name] = values
            continue
        if numeric:
            whole = all(isinstance(value, int) for value in column)
            values = np.array(column, dtype=np.int64 if whole else np.float64)
        elif name == KIND_COLUMN or all(isinstance(value, str) for value in column):
            values = np.array(["" if v is None else str(v) for v in column], dtype=np.str_)
        else:
            continue
        (columns if name in KNOWN else extra)[name] = values
    return from_columns(frame, points, columns, extra=extra, notes=notes, next_id=next_id)
