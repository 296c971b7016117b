"""Pole maps as OpenStreetMap XML or PBF, and nodes of an OpenStreetMap extract as a first map.

The tags are those of OpenStreetMap's own schema; what it has no tag for stands under `polemap:`.
PBF keeps positions to 1e-7 degrees, a centimetre.
"""

from __future__ import annotations

import ctypes
import math
import re
from collections.abc import Iterable, Iterator
from typing import Any
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.errors import FrameError, InputError
from polemap.drivelog.frames import EarthFrame, geographic_from_grid
from polemap.extras import need
from polemap.map.formats.geojson import from_inventory
from polemap.map.pole_map import PoleMap
from polemap.parsing.text import decoded

Floats = NDArray[np.float64]

# tags of nodes that stand up like poles
POLES = {
    "highway": {"street_lamp", "traffic_signals"},
    "power": {"pole"},
    "natural": {"tree"},
    "man_made": {"utility_pole", "mast", "flagpole"},
    "barrier": {"bollard"},
    "support": {"pole"},
}


def to_xml(pole_map: PoleMap) -> bytes:
    """The map as an .osm document; ids are negative, as those of objects not yet uploaded are.

    Raises:
        FrameError: the map is in a local frame.
    """
    place = _places(pole_map)
    root = ElementTree.Element("osm", version="0.6", generator="polemap", upload="false")
    for row in range(len(pole_map)):
        node = ElementTree.SubElement(
            root,
            "node",
            id=str(_node_id(pole_map, row)),
            visible="true",
            version="1",
            lat=f"{place[row, 0]:.9f}",
            lon=f"{place[row, 1]:.9f}",
        )
        for key, value in _tags(pole_map, row).items():
            ElementTree.SubElement(node, "tag", k=key, v=value)
    ElementTree.indent(root)
    return bytes(ElementTree.tostring(root, encoding="utf-8", xml_declaration=True))


def _places(pole_map: PoleMap) -> Floats:
    """Latitudes and longitudes `(n, 2)`."""
    if not pole_map.frame.is_utm:
        raise FrameError(f"OpenStreetMap needs WGS84 positions, but the map is in {pole_map.frame}")
    return geographic_from_grid(pole_map.frame, pole_map.points_m)


def _node_id(pole_map: PoleMap, row: int) -> int:
    return -(int(pole_map.ids[row]) + 1)


def write_pbf(pole_map: PoleMap, path: str) -> None:
    """Write the map as an .osm.pbf file, sorted as OpenStreetMap sorts negative ids.

    Raises:
        FrameError: the map is in a local frame.
    """
    osmium = need("osmium")
    place = _places(pole_map)
    header = osmium.io.Header()
    header.set("generator", "polemap")
    writer = osmium.SimpleWriter(osmium.io.File(path, "pbf"), header=header, overwrite=True)
    try:
        for row in np.argsort(pole_map.ids):
            latitude, longitude = place[row].tolist()
            writer.add_node(
                osmium.osm.mutable.Node(
                    id=_node_id(pole_map, int(row)),
                    version=1,
                    visible=True,
                    location=(longitude, latitude),
                    tags=_tags(pole_map, int(row)),
                )
            )
        writer.close()
    except BaseException:
        # the destructor of a writer that failed (a full disk, say) ends the whole process: one
        # reference that nobody gives back keeps it from running
        ctypes.pythonapi.Py_IncRef(ctypes.py_object(writer))
        raise


def read_pbf(path: str, frame: EarthFrame | None) -> PoleMap:
    """The nodes of an .osm.pbf extract that stand up like poles, as a first map.

    Raises:
        InputError: no PBF, or no such node in it.
    """
    osmium = need("osmium")
    wanted = [(key, value) for key, values in POLES.items() for value in sorted(values)]
    nodes = []
    try:
        # what has none of the tags never leaves the library: an extract of a country is read too
        for node in osmium.FileProcessor(osmium.io.File(path, "pbf"), osmium.osm.NODE).with_filter(
            osmium.filter.TagFilter(*wanted)
        ):
            place = (node.location.lon, node.location.lat) if node.location.valid() else None
            nodes.append((node.id, place, dict(node.tags)))
    except RuntimeError as error:
        raise InputError(f"not an OpenStreetMap PBF file ({str(error)[:80]})") from error
    return _from_nodes(nodes, frame)


def _tags(pole_map: PoleMap, row: int) -> dict[str, str]:
    tags = {"man_made": "utility_pole"}
    if np.isfinite(pole_map.height_m[row]):
        tags["height"] = f"{pole_map.height_m[row]:.2f}"
    if np.isfinite(pole_map.width_m[row]):
        tags["diameter"] = f"{1000 * pole_map.width_m[row]:.0f} mm"
    sd = np.sqrt(np.trace(pole_map.covariance_m2[row]) / 2.0)
    tags["polemap:id"] = str(pole_map.ids[row])
    tags["polemap:sd_m"] = f"{sd:.3f}"
    tags["polemap:existence"] = f"{pole_map.existence[row]:.3f}"
    return tags


def from_xml(data: bytes, frame: EarthFrame | None) -> PoleMap:
    """The nodes of an .osm extract that stand up like poles, as a first map.

    Raises:
        InputError: no OpenStreetMap XML, or no such node in it.
    """
    decoded(data)
    if b"<!DOCTYPE" in data or b"<!ENTITY" in data:
        raise InputError("a document type or entity stands in it; OpenStreetMap files have none")
    try:
        root = ElementTree.fromstring(data)
    except ElementTree.ParseError as error:
        raise InputError(f"not XML ({error})") from error
    if root.tag != "osm":
        raise InputError(f"not OpenStreetMap XML: its root is <{root.tag[:40]}>")
    return _from_nodes(_xml_nodes(root), frame)


_Node = tuple[Any, tuple[float, float] | None, dict[str, str]]


def _xml_nodes(root: ElementTree.Element) -> Iterator[_Node]:
    for node in root.iter("node"):
        tags = {str(tag.get("k")): str(tag.get("v")) for tag in node.iter("tag")}
        try:
            place = (float(node.get("lon", "")), float(node.get("lat", "")))
        except ValueError:
            yield node.get("id"), None, tags
        else:
            yield node.get("id"), place, tags


def _from_nodes(nodes: Iterable[_Node], frame: EarthFrame | None) -> PoleMap:
    positions, properties = [], []
    for name, place, tags in nodes:
        if not any(tags.get(key) in values for key, values in POLES.items()):
            continue
        if place is None:
            raise InputError(f"node {name} has no position")
        positions.append(place)
        properties.append(_properties(tags))
    if not positions:
        raise InputError("no node in it is a lamp, pole, mast, bollard or tree")
    return from_inventory(np.array(positions), properties, frame, ())


def _properties(tags: dict[str, str]) -> dict[str, Any]:
    """Height and width; the wiki gives `diameter` in mm, the rest in metres without a unit."""
    width = _metres(tags.get("diameter"), "mm")
    around = _metres(tags.get("circumference"), "m")
    if width is None and around is not None:
        width = around / math.pi
    if width is None:
        width = _metres(tags.get("width"), "m")
    return {"height_m": _metres(tags.get("height"), "m"), "width_m": width}


_UNITS_M = {
    "mm": 0.001, "cm": 0.01, "m": 1.0, "km": 1000.0, "ft": 0.3048, "feet": 0.3048, "'": 0.3048,
    "in": 0.0254, "inch": 0.0254, "inches": 0.0254, '"': 0.0254,
}  # fmt: skip
_LENGTH = re.compile(
    r"""([0-9]+(?:[.,][0-9]+)?|[.,][0-9]+)\s*(mm|cm|km|m|ft|feet|inches|inch|in|'|")?\s*"""
)


def _metres(text: str | None, default_unit: str) -> float | None:
    """A length as OpenStreetMap writes it: `12`, `12 m`, `150 mm`, `39'4"`, `39 ft 4 in`.

    Args:
        default_unit: of a number without a unit, which depends on the key.
    """
    if text is None:
        return None
    words = text.strip().lower().replace("\u2032", "'").replace("\u2033", '"').replace("''", '"')
    at, total, parts = 0, 0.0, 0
    while at < len(words):
        match = _LENGTH.match(words, at)
        if match is None or (parts and not match.group(2)):
            return None
        value = float(match.group(1).replace(",", "."))
        total += value * _UNITS_M[match.group(2) or default_unit]
        at, parts = match.end(), parts + 1
    return total if 0.0 < total < 500.0 else None
