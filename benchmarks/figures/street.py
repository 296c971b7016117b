"""The street of a simulated world as an OpenStreetMap file, to lay maps over."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.frames import EarthFrame, geographic_from_grid
from polemap.simulate.route import make_route
from polemap.simulate.scenario import Scenario
from polemap.simulate.skyline import Fronts
from polemap.simulate.world import make_world
from polemap.vehicle.pose import rotate

Floats = NDArray[np.float64]

_DEPTH_M = 8.0


def street_extract(scenario: Scenario, frame: EarthFrame, path: Path) -> Path:
    """Write the carriageway and the fronts of the houses of world 0."""
    world = make_world(scenario, 0)
    origin = np.array([scenario.origin_east_m, scenario.origin_north_m])
    spec = scenario.route
    route = make_route(spec.corners_m, spec.corner_radius_m, spec.closed)
    line = route.at(np.linspace(0.0, route.length_m, 120))[:, :2]
    root = ElementTree.Element("osm", version="0.6", generator="polemap")
    ways = [({"highway": "residential"}, line + origin)]
    ways += [({"building": "yes"}, house + origin) for house in _houses(world.fronts, line)]
    count = 0
    pieces = []
    for number, (tags, points) in enumerate(ways, start=1):
        way = ElementTree.Element("way", id=str(number), version="1")
        for latitude, longitude in geographic_from_grid(frame, points).tolist():
            count += 1
            ElementTree.SubElement(
                root, "node", id=str(count), version="1", lat=f"{latitude:.7f}",
                lon=f"{longitude:.7f}",
            )  # fmt: skip
            ElementTree.SubElement(way, "nd", ref=str(count))
        for key, value in tags.items():
            ElementTree.SubElement(way, "tag", k=key, v=value)
        pieces.append(way)
    root.extend(pieces)
    path.write_bytes(ElementTree.tostring(root, encoding="utf-8", xml_declaration=True))
    return path


def _houses(fronts: Fronts, line: Floats) -> list[Floats]:
    """Outlines `(5, 2)` of houses behind their fronts, away from the street `(n, 2)`."""
    found = []
    for x, y, yaw, width in zip(
        fronts.x_m, fronts.y_m, fronts.yaw_rad, fronts.width_m, strict=True
    ):
        half = rotate([0.5 * width, 0.0], yaw)
        back = rotate([0.0, _DEPTH_M], yaw)
        middle = np.array([x, y])
        nearest = line[np.argmin(np.hypot(*(line - middle).T))]
        if back @ (middle - nearest) < 0.0:
            back = -back
        corners = [middle - half, middle + half, middle + half + back, middle - half + back]
        found.append(np.array([*corners, corners[0]]))
    return found
