"""The ground: a cross-section swept along the route, lane markings, patches and the far plane."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from polemap.simulate.materials import TILES
from polemap.simulate.mesh import Mesh, join, quads
from polemap.simulate.route import CrossSection, Route
from polemap.simulate.scenario import SectionSpec, SideStreetSpec
from polemap.vehicle.pose import rotate

Floats = NDArray[np.float64]
_REPEATS = {
    "asphalt": 0.22,
    "worn_asphalt": 0.22,
    "cobble": 0.55,
    "slabs": 0.4,
    "grass": 0.4,
    "gravel": 0.4,
    "concrete": 0.3,
    "marking": 0.5,
}


def kerb_m(spec: SectionSpec) -> float:
    """Distance of the kerb from the centre line."""
    return spec.road_half_width_m + spec.parking_width_m


def make_section(spec: SectionSpec) -> CrossSection:
    """The profile from the left border to the right one."""
    edge = spec.road_half_width_m
    lateral, height = [0.0], [0.0]
    surface: list[tuple[str, float]] = []

    def strip(to: float, rise: float, name: str, albedo: float = 1.0) -> None:
        lateral.append(to)
        height.append(height[-1] + rise)
        surface.append((name, albedo))

    inner = 0.0
    if spec.median_width_m > 0:
        inner = spec.median_width_m / 2
        lateral, height = [0.0], [spec.kerb_height_m]
        strip(inner - 0.15, 0.0, "grass")
        strip(inner, 0.0, "concrete")
        strip(inner + 0.02, -spec.kerb_height_m, "concrete", 0.8)
    if spec.edge_line:
        strip(edge - 0.45, -spec.crossfall * (edge - 0.45 - lateral[-1]), spec.surface)
        strip(edge - 0.30, -spec.crossfall * 0.15, "marking")
    gutter = 0.30 if spec.gutter else 0.0
    strip(edge - gutter, -spec.crossfall * (edge - gutter - lateral[-1]), spec.surface)
    if gutter:
        strip(edge, -spec.crossfall * gutter, "cobble", 0.8)
    if spec.parking_width_m > 0:
        strip(kerb_m(spec), 0.02 * spec.parking_width_m, spec.parking_surface, 0.85)
    kerb = kerb_m(spec)
    strip(kerb + 0.02, spec.kerb_height_m, "concrete", 0.9)
    strip(kerb + 0.17, 0.002, "concrete", 1.15)
    at = kerb + 0.17
    for width, name in (
        (spec.verge_width_m, spec.verge_surface),
        (spec.sidewalk_width_m, spec.sidewalk_surface),
        (spec.border_width_m, spec.border_surface),
    ):
        if width > 0:
            at += width
            strip(at, 0.02 * width, name)
    right_first = [-x for x in lateral[:0:-1]] + lateral
    heights = height[:0:-1] + height
    names = surface[::-1] + surface
    return CrossSection(
        np.array(right_first),
        np.array(heights),
        tuple(n for n, _ in names),
        tuple(_REPEATS.get(n, 0.4) for n, _ in names),
        tuple(a for _, a in names),
    )


def _stations(route: Route, step_m: float) -> Floats:
    count = max(2, round(route.length_m / step_m))
    return np.linspace(0.0, route.length_m, count + 1)


def ribbon(
    route: Route,
    stations: Floats,
    lateral_m: tuple[float, float],
    height_m: tuple[float, float],
    tile: str,
    albedo: float = 1.0,
    repeats_per_m: float | None = None,
) -> Mesh:
    """A strip between two lateral positions along consecutive stations."""
    repeats = repeats_per_m or _REPEATS.get(tile, 0.4)
    edges = []
    for lateral, height in zip(lateral_m, height_m, strict=True):
        pose = route.at(stations, lateral)
        edges.append(np.column_stack([pose[:, :2], np.full(len(stations), height)]))
    right, left = edges
    corners = np.stack([right[:-1], right[1:], left[1:], left[:-1]], axis=1)
    rise = abs(height_m[1] - height_m[0])
    across = np.array([0.0, np.hypot(lateral_m[1] - lateral_m[0], rise)]) * repeats
    across = across + lateral_m[0] * repeats
    along = stations * repeats
    uv = np.stack(
        [
            np.stack(np.broadcast_arrays(across[0], along[:-1]), 1),
            np.stack(np.broadcast_arrays(across[0], along[1:]), 1),
            np.stack(np.broadcast_arrays(across[1], along[1:]), 1),
            np.stack(np.broadcast_arrays(across[1], along[:-1]), 1),
        ],
        axis=1,
    )
    return quads(corners, uv, TILES[tile], albedo, repeats)


def make_ground(
    route: Route, section: CrossSection, spec: SectionSpec, rng: np.random.Generator
) -> Mesh:
    """Everything that one drives or walks on."""
    stations = _stations(route, 1.5)
    parts: list[Mesh] = []
    for i, name in enumerate(section.surface):
        lateral = (float(section.lateral_m[i]), float(section.lateral_m[i + 1]))
        height = (float(section.height_m[i]), float(section.height_m[i + 1]))
        for low, high, surface in _paved(route, spec, name):
            part = stations[(stations >= low) & (stations <= high)]
            if len(part) > 1:
                parts.append(ribbon(route, part, lateral, height, surface, section.albedo[i]))
    parts += _markings(route, section, spec)
    parts += _patches(route, section, spec, rng)
    parts.append(_far_plane(route, float(section.height_m.min()) - 0.3))
    return join(parts)


def _paved(route: Route, spec: SectionSpec, name: str) -> list[tuple[float, float, str]]:
    """Stretches (from, to, surface) of one strip; only the road itself changes its paving."""
    if name != spec.surface:
        return [(0.0, route.length_m, name)]
    stretches, at = [], 0.0
    for paving in sorted(spec.paving, key=lambda p: p.from_m):
        low, high = round(paving.from_m / 1.5) * 1.5, round(paving.to_m / 1.5) * 1.5
        stretches += [(at, low, name), (low, min(high, route.length_m), paving.surface)]
        at = high
    return [*stretches, (at, route.length_m, name)]


def side_street(
    route: Route, section: CrossSection, spec: SectionSpec, side: SideStreetSpec
) -> Mesh:
    """The mouth of a side street: tarmac laid over pavement and border, straight outwards."""
    sign = 1.0 if side.side == "left" else -1.0
    kerb = kerb_m(spec)
    parts = []
    steps = np.linspace(kerb - 0.1, kerb + side.length_m, 24)
    offsets = np.linspace(-side.width_m / 2, side.width_m / 2, 5)
    pose = route.at(np.array(side.at_m), 0.0)
    forward, left = rotate(np.eye(2), pose[2])
    out = left * sign
    height = section.height_at(sign * steps) + 0.02
    height = np.maximum(height, float(section.height_at(sign * (kerb + 0.3))) - 0.06)
    for a, b in pairwise(offsets):
        near = pose[:2] + np.outer(steps, out) + a * forward
        far = pose[:2] + np.outer(steps, out) + b * forward
        low = np.column_stack([near, height])
        high = np.column_stack([far, height])
        corners = np.stack([low[:-1], low[1:], high[1:], high[:-1]], axis=1)
        parts.append(quads(corners, corners[..., :2] * 0.22, TILES["asphalt"], 0.9, 0.22))
    return join(parts)


def marking_lines(spec: SectionSpec) -> list[float]:
    """Where lines of markings run, metres left of the street's centre line."""
    edge = [spec.road_half_width_m - 0.375] if spec.edge_line else []
    return [*edge, *_lines(spec), *(-x for x in edge)]


def _lines(spec: SectionSpec) -> list[float]:
    lanes = max(
        1, int((spec.road_half_width_m - spec.median_width_m / 2) / spec.lane_width_m + 0.05)
    )
    first = spec.median_width_m / 2
    inner = [first + k * spec.lane_width_m for k in range(1, lanes)]
    middle = [0.0] if spec.median_width_m == 0 and spec.centre_line != "none" else []
    return middle + inner + [-x for x in inner]


def _markings(route: Route, section: CrossSection, spec: SectionSpec) -> list[Mesh]:
    parts = []
    for lateral in _lines(spec):
        height = float(section.height_at(lateral)) + 0.006
        solid = lateral == 0.0 and spec.centre_line == "solid"
        period, dash = (6.0, 6.0) if solid else (9.0, 3.0)
        for start in np.arange(0.0, route.length_m - dash, period):
            stations = np.linspace(start, start + dash, 4)
            parts.append(
                ribbon(
                    route, stations, (lateral - 0.06, lateral + 0.06), (height, height), "marking"
                )
            )
    return parts


def _patches(
    route: Route, section: CrossSection, spec: SectionSpec, rng: np.random.Generator
) -> list[Mesh]:
    """Mended places: darker or lighter rectangles of tarmac, and manhole covers."""
    parts = []
    inner = spec.median_width_m / 2 + 0.2
    for _ in range(int(route.length_m / 18)):
        start = rng.uniform(0, max(1.0, route.length_m - 20))
        length = rng.uniform(1.0, 18.0) if rng.uniform() < 0.5 else 0.65
        width = rng.uniform(0.7, 1.6) if length > 0.7 else 0.65
        low = rng.uniform(inner, max(inner + 0.1, spec.road_half_width_m - 0.4 - width))
        side = 1.0 if rng.uniform() < 0.5 else -1.0
        a, b = sorted((side * low, side * (low + width)))
        heights = (float(section.height_at(a)) + 0.004, float(section.height_at(b)) + 0.004)
        stations = np.linspace(start, start + length, max(2, int(length) + 1))
        tile, shade = (
            ("asphalt", float(rng.uniform(0.45, 0.95))) if length > 0.7 else ("metal", 0.4)
        )
        parts.append(ribbon(route, stations, (a, b), heights, tile, shade))
    return parts


def _far_plane(route: Route, height_m: float) -> Mesh:
    low, high = route.points_m.min(axis=0) - 300, route.points_m.max(axis=0) + 300
    corner = np.array([[low[0], low[1]], [high[0], low[1]], [high[0], high[1]], [low[0], high[1]]])
    corners = np.column_stack([corner, np.full(4, height_m)])[None]
    return quads(corners, corners[..., :2] * 0.25, TILES["grass"], 1.0, 0.25)
