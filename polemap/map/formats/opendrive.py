"""Pole maps as ASAM OpenDRIVE 1.7 objects of type `pole`.

A map has no roads, and OpenDRIVE objects hang on one. The road is a straight reference line along
the map's longer side; `s` and `t` of an object are its place along and to the left of it, so that
the objects stand where the poles stand. It carries one lane of type `none`.
"""

from __future__ import annotations

from xml.etree import ElementTree

import numpy as np
from pyproj import CRS

from polemap.drivelog.errors import InputError
from polemap.map.pole_map import PoleMap
from polemap.vehicle.pose import rotate_back

_DEFAULT_WIDTH_M, _DEFAULT_HEIGHT_M = 0.2, 3.0


def to_xml(pole_map: PoleMap) -> bytes:
    """The map as an .xodr document.

    Raises:
        InputError: the map holds no poles.
    """
    if not len(pole_map):
        raise InputError("a map without poles has no OpenDRIVE road to hang them on")
    low, high = pole_map.points_m.min(axis=0), pole_map.points_m.max(axis=0)
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
        _object(objects, pole_map, row, float(station[row]), float(lateral[row]))
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


def _object(
    objects: ElementTree.Element, pole_map: PoleMap, row: int, station: float, lateral: float
) -> None:
    width, height = float(pole_map.width_m[row]), float(pole_map.height_m[row])
    radius = (width if np.isfinite(width) and width > 0 else _DEFAULT_WIDTH_M) / 2.0
    entry = ElementTree.SubElement(
        objects,
        "object",
        id=str(pole_map.ids[row]),
        name=f"pole {pole_map.ids[row]}",
        type="pole",
        s=f"{station:.4f}",
        t=f"{lateral:.4f}",
        zOffset="0",
        hdg="0",
        pitch="0",
        roll="0",
        orientation="none",
        dynamic="no",
        radius=f"{radius:.4f}",
        height=f"{height if np.isfinite(height) and height > 0 else _DEFAULT_HEIGHT_M:.4f}",
    )
    known = "measured" if np.isfinite(height) else "assumed"
    ElementTree.SubElement(entry, "userData", code="polemap:height", value=known)
    ElementTree.SubElement(
        entry, "userData", code="polemap:existence", value=f"{pole_map.existence[row]:.3f}"
    )
