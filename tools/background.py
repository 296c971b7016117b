"""What lies under a map in a picture: an OpenStreetMap extract's streets, houses, green, water."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.errors import FrameError, InputError
from polemap.drivelog.frames import EarthFrame, geographic_from_grid, grid_from_geographic
from polemap.extras import check_installed, need

Floats = NDArray[np.float64]

ATTRIBUTION = "© OpenStreetMap contributors"
"""Asked for by the licence of the data (ODbL) wherever they are shown."""
ENDINGS = (".osm", ".osm.pbf", ".pbf")
MARGIN_M = 60.0

_PATHS = {"footway", "path", "cycleway", "steps", "pedestrian", "track", "bridleway", "corridor"}
_RAILS = {"rail", "tram", "light_rail", "subway", "narrow_gauge"}
_STREAMS = {"river", "stream", "canal", "ditch", "drain"}
_GREEN = {
    "landuse": {"grass", "forest", "meadow", "recreation_ground", "cemetery", "village_green"},
    "leisure": {"park", "garden", "pitch", "playground"},
    "natural": {"wood", "scrub", "grassland", "heath"},
}
_KEYS = ("highway", "railway", "waterway", "building", "natural", *_GREEN)


@dataclass(frozen=True, slots=True)
class Background:
    """Lines and outlines `(n, 2)` in the map's metres, by what they are.

    Attributes:
        areas: closed outlines by "green", "water", "building".
        lines: by "water", "rail", "path", "road".
    """

    areas: Mapping[str, tuple[Floats, ...]]
    lines: Mapping[str, tuple[Floats, ...]]

    def __len__(self) -> int:
        return sum(len(one) for kinds in (self.areas, self.lines) for one in kinds.values())


def check_background(path: Path | None) -> None:
    """Refuse what cannot be an extract before the work begins.

    Raises:
        InputError: no such file, or another ending.
        MissingExtraError: osmium is not installed.
    """
    if path is None:
        return
    if not path.name.lower().endswith(ENDINGS):
        raise InputError(f"{path}: a background is an OpenStreetMap extract, .osm or .osm.pbf")
    # os.path, unlike pathlib, says that a name of 300 letters is no file
    if not os.path.isfile(path):
        raise InputError(f"{path}: no such OpenStreetMap extract")
    check_installed("osmium")


def read_background(path: Path, frame: EarthFrame, points_m: Floats) -> Background:
    """What an extract shows around the points `(n, 2)` of a frame.

    Raises:
        FrameError: the frame is not on the earth.
        InputError: not an extract, or nothing in it lies around the points.
    """
    check_background(path)
    if not frame.is_utm:
        raise FrameError(f"{path}: a background needs a map on the earth, this one is in {frame}")
    low, high = points_m.min(axis=0) - MARGIN_M, points_m.max(axis=0) + MARGIN_M
    corners = np.array([[e, n] for e in (low[0], high[0]) for n in (low[1], high[1])])
    place = geographic_from_grid(frame, corners)
    box = np.concatenate([place.min(axis=0), place.max(axis=0)])
    areas: dict[str, list[Floats]] = {"green": [], "water": [], "building": []}
    lines: dict[str, list[Floats]] = {"water": [], "rail": [], "path": [], "road": []}
    osmium = need("osmium")
    try:
        processor = osmium.FileProcessor(str(path)).with_areas(osmium.filter.KeyFilter(*_KEYS))
        for item in processor.with_filter(osmium.filter.KeyFilter(*_KEYS)):
            if item.is_way() and (kind := _line_kind(item.tags)):
                _add(lines[kind], item.nodes, box, frame)
            elif item.is_area() and (kind := _area_kind(item.tags)):
                for ring in item.outer_rings():
                    _add(areas[kind], ring, box, frame)
    except (RuntimeError, ValueError, osmium.InvalidLocationError) as error:
        raise InputError(
            f"{path}: not an OpenStreetMap extract ({' '.join(str(error).split())[:80]})"
        ) from error
    found = Background(_frozen(areas), _frozen(lines))
    if not len(found):
        south, west, north, east = box.tolist()
        raise InputError(
            f"{path}: nothing in it lies around the map, which is at latitude {south:.4f} to "
            f"{north:.4f}, longitude {west:.4f} to {east:.4f}"
        )
    return found


def _line_kind(tags: Any) -> str:
    highway = tags.get("highway", "")
    if highway:
        return "path" if highway in _PATHS else "road"
    if tags.get("railway", "") in _RAILS:
        return "rail"
    return "water" if tags.get("waterway", "") in _STREAMS else ""


def _area_kind(tags: Any) -> str:
    if tags.get("building", "no") != "no":
        return "building"
    if tags.get("natural", "") == "water" or tags.get("waterway", "") == "riverbank":
        return "water"
    return "green" if any(tags.get(key, "") in values for key, values in _GREEN.items()) else ""


def _add(kept: list[Floats], nodes: Any, box: Floats, frame: EarthFrame) -> None:
    """Keep a line that has a part in the box `(4,)`: south, west, north, east; a node that the
    extract lacks is left out."""
    places = np.array([(n.location.lat, n.location.lon) for n in nodes if n.location.valid()])
    if len(places) < 2:
        return
    if (places.max(axis=0) < box[:2]).any() or (places.min(axis=0) > box[2:]).any():
        return
    kept.append(grid_from_geographic(frame, places[:, 0], places[:, 1]))


def _frozen(found: dict[str, list[Floats]]) -> dict[str, tuple[Floats, ...]]:
    return {kind: tuple(one) for kind, one in found.items() if one}


_FILLS = {"green": "#e3efdc", "water": "#d3e4f2", "building": "#e6e1da"}
_STROKES = {"water": ("#b9d3ea", 1.5), "rail": ("#b0a8b0", 1.0), "path": ("#dcd3c3", 0.8),
            "road": ("#cfd3d8", 3.0)}  # fmt: skip


def draw_background(
    axes: Any, background: Background, centre: Floats, source: str = ATTRIBUTION
) -> None:
    """Draw it under everything else, moved by `-centre` `(2,)`; the axes keep their limits.

    Args:
        source: whom the picture names for the data.
    """
    from matplotlib.collections import LineCollection, PolyCollection

    for kind, outlines in background.areas.items():
        shapes = [outline - centre for outline in outlines]
        edge = "#d5cec4" if kind == "building" else "none"
        axes.add_collection(
            PolyCollection(shapes, facecolors=_FILLS[kind], edgecolors=edge, lw=0.4, zorder=-3),
            autolim=False,
        )
    for kind, ways in background.lines.items():
        colour, width = _STROKES[kind]
        shapes = [way - centre for way in ways]
        axes.add_collection(
            LineCollection(shapes, colors=colour, linewidths=width, zorder=-2), autolim=False
        )
    axes.annotate(
        source, (1.0, 0.0), xycoords="axes fraction", ha="right", va="bottom", fontsize=7,
        color="#6b737b",
    )  # fmt: skip
