"""The zoomable map of the page: plain SVG in metres that a small script pans and zooms.

Without the script, and in print, it is still a picture of the whole route.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from shapely.geometry import LineString

from polemap.evaluation.results import RouteResult
from polemap.tools.background import ATTRIBUTION, Background
from polemap.tools.report.figures import drawn_systems, near_points, system_label
from polemap.tools.report.route_bound import STEP_M, route_bound

Floats = NDArray[np.float64]

SIMPLIFY_M = 0.01
MARGIN_M = 25.0
BOUND_LIMITS_M = (0.3, 1.0)


@dataclass(frozen=True, slots=True)
class Layer:
    """One switchable layer: its label, its CSS class and the path data of its lines."""

    label: str
    css: str
    paths: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class InteractiveMap:
    """What the page's template draws; y runs down, so that north is up.

    Attributes:
        origin_east_m, origin_north_m: added to the drawing's coordinates for the read-out.
        view: x, y, width, height of the whole, in metres.
    """

    origin_east_m: float
    origin_north_m: float
    view: tuple[float, float, float, float]
    layers: tuple[Layer, ...]


def interactive_map(result: RouteResult, background: Background | None = None) -> InteractiveMap:
    """Trajectories of the first run of every system, and the poles around them."""
    line = np.concatenate([one.guide.poses[:, :2] for one in result.route.recordings])
    origin = np.floor(line.min(axis=0))
    layers = []
    poles = result.route.pole_map
    if poles is not None and len(poles):
        points = near_points(poles.points_m, result) - origin
        dots = "".join(f"M{x:.2f} {-y:.2f}h0" for x, y in points.tolist())
        layers.append(Layer(f"mapped poles ({len(points)})", "pole", (dots,)))
    layers = _bound_layers(result, origin) + layers
    if background is not None:
        layers = _background_layers(background, origin) + layers
    for one in drawn_systems(result):
        paths = [
            _path_data(part)
            for track in one.system.tracks[0]
            for part in _unbroken(track.thinned(0.1).poses[:, :2] - origin)
        ]
        if paths:
            layers.append(Layer(system_label(one), one.system.kind, tuple(paths)))
    low = line.min(axis=0) - origin - MARGIN_M
    high = line.max(axis=0) - origin + MARGIN_M
    width, height = (float(v) for v in high - low)
    view = (float(low[0]), float(-high[1]), width, height)
    return InteractiveMap(float(origin[0]), float(origin[1]), view, tuple(layers))


def _background_layers(background: Background, origin: Floats) -> list[Layer]:
    """Streets, houses and the rest, to a decimetre."""
    layers = []
    for shape, kinds in (("area", background.areas), ("line", background.lines)):
        for kind, ways in kinds.items():
            end = "z" if shape == "area" else ""
            paths = tuple(_path_data(np.round(way - origin, 1)) + end for way in ways)
            layers.append(Layer(kind, f"osm {shape} {kind}", paths))
    layers[-1] = replace(layers[-1], label=f"{layers[-1].label} ({ATTRIBUTION})")
    return layers


def _bound_layers(result: RouteResult, origin: Floats) -> list[Layer]:
    """Localizability along the first recording: where one look at the map says much or little."""
    found = route_bound(result)
    if found is None:
        return []
    points = found.bound.poses[:, :2] - origin
    ahead = np.vstack([points[1:], points[-1:]])
    level = np.digitize(found.bound.lateral_sd_m, BOUND_LIMITS_M)
    near, far = BOUND_LIMITS_M
    names = (f"one look: lateral sd below {near} m", f"{near} – {far} m", f"above {far} m")
    layers = []
    for number, name in enumerate(names):
        rows = np.flatnonzero((level == number) & (np.hypot(*(ahead - points).T) < 3.0 * STEP_M))
        steps = (np.concatenate([points[row], ahead[row]]) for row in rows)
        path = "".join(f"M{a:.2f} {-b:.2f}L{c:.2f} {-d:.2f}" for a, b, c, d in steps)
        layers.append(Layer(name, f"bound bound{number}", (path,) if path else ()))
    return layers


def _unbroken(points_m: Floats, jump_m: float = 5.0) -> list[Floats]:
    """Cut where a trajectory jumps (re-initialization, gap): a line there would be invented."""
    steps = np.hypot(*np.diff(points_m, axis=0).T)
    return [
        part for part in np.split(points_m, np.flatnonzero(steps > jump_m) + 1) if len(part) > 1
    ]


def _path_data(points_m: Floats) -> str:
    line = np.asarray(LineString(points_m).simplify(SIMPLIFY_M).coords)
    return "M" + "L".join(f"{x:.2f} {-y:.2f}" for x, y in line.tolist())
