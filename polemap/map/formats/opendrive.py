"""Maps as ASAM OpenDRIVE 1.7 objects: poles, corners of buildings, and lines as open outlines.

A map has no roads, and OpenDRIVE objects hang on one. The road is a straight reference line along
the map's longer side; `s` and `t` of an object are its place along and to the left of it, so that
the objects stand where the poles stand. It carries one lane of type `none`.
"""

from __future__ import annotations

from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray
from pyproj import CRS

from polemap.drivelog.errors import InputError
from polemap.drivelog.landmark_kind import LandmarkKind, LineStyle, kind_name
from polemap.map.line_map import LineMap
from polemap.map.pole_map import FACING_COLUMN, PoleMap
from polemap.vehicle.pose import rotate_back

Floats = NDArray[np.float64]

_DEFAULT_WIDTH_M, _DEFAULT_HEIGHT_M, _KERB_HEIGHT_M = 0.2, 3.0, 0.12
_TYPES = {
    int(LandmarkKind.POLE): "pole",
    int(LandmarkKind.CORNER): "building",
    int(LandmarkKind.LANE_MARKING): "roadMark",
    int(LandmarkKind.FACADE): "building",
}


def to_xml(pole_map: PoleMap) -> bytes:
    """The map as an .xodr document.

    Raises:
        InputError: the map holds no poles.
    """
    lines = pole_map.lines if pole_map.lines is not None else LineMap.empty(pole_map.frame)
    places = np.concatenate([pole_map.points_m, lines.vertices_m])
    if not len(places):
        raise InputError("a map without landmarks has no OpenDRIVE road to hang them on")
    low, high = places.min(axis=0), places.max(axis=0)
    along = int(high[1] - low[1] > high[0] - low[0])
    heading = np.pi / 2.0 if along else 0.0
    start = np.where([along == 0, along == 1], low - 1.0, (low + high) / 2.0)
    length = float((high - low)[along]) + 2.0
    root = ElementTree.Element("OpenDRIVE")
    header = ElementTree.SubElement(
        root, "header", revMajor="1", revMinor="7", name="polemap", version="1.00",
        north=f"{high[1]:.3f}", south=f"{low[1]:.3f}", east=f"{high[0]:.3f}", west=f"{low[0]:.3f}",
    )  # fmt: skip
    if pole_map.frame.epsg is not None:
        reference = ElementTree.SubElement(header, "geoReference")
        reference.text = _proj(pole_map.frame.epsg)
    road = ElementTree.SubElement(
        root, "road", name="poles", length=f"{length:.4f}", id="1", junction="-1"
    )
    view = ElementTree.SubElement(road, "planView")
    geometry = ElementTree.SubElement(
        view, "geometry", s="0", x=f"{start[0]:.4f}", y=f"{start[1]:.4f}", hdg=f"{heading:.9f}",
        length=f"{length:.4f}",
    )  # fmt: skip
    ElementTree.SubElement(geometry, "line")
    _lanes(road)
    objects = ElementTree.SubElement(road, "objects")
    station, lateral = rotate_back(pole_map.points_m - start, heading).T
    for row in range(len(pole_map)):
        _point(objects, pole_map, row, float(station[row]), float(lateral[row]))
    for row in range(len(lines)):
        _line(objects, lines, row, rotate_back(lines.polyline_m(row) - start, heading))
    ElementTree.indent(root)
    return bytes(ElementTree.tostring(root, encoding="utf-8", xml_declaration=True))


def _proj(epsg: int) -> str:
    """The PROJ string that OpenDRIVE asks for."""
    crs = CRS.from_epsg(epsg)
    south = " +south" if str(crs.utm_zone).endswith("S") else ""
    zone = str(crs.utm_zone).rstrip("NS")
    return f"+proj=utm +zone={zone}{south} +datum=WGS84 +units=m +no_defs"


def _lanes(road: ElementTree.Element) -> None:
    lanes = ElementTree.SubElement(road, "lanes")
    section = ElementTree.SubElement(lanes, "laneSection", s="0")
    centre = ElementTree.SubElement(section, "center")
    ElementTree.SubElement(centre, "lane", id="0", type="none", level="false")
    right = ElementTree.SubElement(section, "right")
    lane = ElementTree.SubElement(right, "lane", id="-1", type="none", level="false")
    ElementTree.SubElement(lane, "width", sOffset="0", a="1", b="0", c="0", d="0")


def _point(
    objects: ElementTree.Element, pole_map: PoleMap, row: int, station: float, lateral: float
) -> None:
    width, height = float(pole_map.width_m[row]), float(pole_map.height_m[row])
    kind = int(pole_map.kind[row])
    entry = _object(objects, kind, f"{pole_map.ids[row]}", station, lateral)
    if kind == LandmarkKind.POLE:
        radius = (width if np.isfinite(width) and width > 0 else _DEFAULT_WIDTH_M) / 2.0
        entry.set("radius", f"{radius:.4f}")
    known = bool(np.isfinite(height)) and height > 0
    entry.set("height", f"{height if known else _DEFAULT_HEIGHT_M:.4f}")
    _tell(entry, "height", "measured" if np.isfinite(height) else "assumed")
    facing = (
        float(pole_map.extra[FACING_COLUMN][row]) if FACING_COLUMN in pole_map.extra else np.nan
    )
    if np.isfinite(facing):
        _tell(entry, "facing_rad", f"{facing:.4f}")
    _tell(entry, "existence", f"{pole_map.existence[row]:.3f}")


def _line(objects: ElementTree.Element, lines: LineMap, row: int, places: Floats) -> None:
    """An open outline through its vertices, at `s` and `t` of each."""
    kind, style = int(lines.kind[row]), LineStyle(int(lines.style[row]))
    # points have the plain numbers
    entry = _object(objects, kind, f"line-{lines.ids[row]}", *map(float, places[0]))
    height = _DEFAULT_HEIGHT_M if kind == LandmarkKind.FACADE else _KERB_HEIGHT_M
    height = 0.0 if kind == LandmarkKind.LANE_MARKING else height
    entry.set("height", f"{height:.4f}")
    outlines = ElementTree.SubElement(entry, "outlines")
    outline = ElementTree.SubElement(outlines, "outline", id="0", closed="false", outer="true")
    for number, (station, lateral) in enumerate(places.tolist()):
        ElementTree.SubElement(
            outline, "cornerRoad", id=str(number), s=f"{station:.4f}", t=f"{lateral:.4f}", dz="0",
            height=f"{height:.4f}",
        )  # fmt: skip
    if style != LineStyle.UNKNOWN:
        _tell(entry, "style", style.name.lower())
    _tell(entry, "height", "assumed")
    _tell(entry, "existence", f"{lines.existence[row]:.3f}")


def _object(
    objects: ElementTree.Element, kind: int, identity: str, station: float, lateral: float
) -> ElementTree.Element:
    """An object of a kind; one that the standard has no type for is named by its subtype."""
    sort = _TYPES.get(kind, "none")
    entry = ElementTree.SubElement(
        objects, "object", id=identity, name=f"{kind_name(kind)} {identity.removeprefix('line-')}",
        type=sort, s=f"{station:.4f}", t=f"{lateral:.4f}", zOffset="0", hdg="0", pitch="0",
        roll="0", orientation="none", dynamic="no",
    )  # fmt: skip
    if sort in ("none", "building"):
        entry.set("subtype", kind_name(kind))
    return entry


def _tell(entry: ElementTree.Element, code: str, value: str) -> None:
    ElementTree.SubElement(entry, "userData", code=f"polemap:{code}", value=value)
