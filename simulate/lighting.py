"""Sun, sky and shadows."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from polemap.simulate.patterns import TILE_PX, fractal
from polemap.simulate.raycast import Caster
from polemap.simulate.textures import read_picture
from polemap.simulate.world import World

Floats32 = NDArray[np.float32]
_MAP_LIMIT_PX = 5000
# how far behind its cell's first surface a point may lie and still be lit: within a cell a surface
# that the sun grazes runs through a range of distances
_BIAS_M, _BIAS_CELLS, _LARGEST_BIAS_M = 0.04, 1.2, 0.8
_CELL_M = 0.07
_TRANSLUCENT = 0.5


def _dot(vectors: Floats32, axis: Floats32) -> Floats32:
    """Scalar products `(n,)`; spelled out, since BLAS is slow on slim matrices."""
    out = vectors[:, 0] * axis[0]
    out += vectors[:, 1] * axis[1]
    out += vectors[:, 2] * axis[2]
    return np.asarray(out)


@dataclass(frozen=True, slots=True)
class ShadowMap:
    """Distance of the first surface from the sun, on a plane across its rays.

    `axes` `(3, 3)`: rows are the map's x and y directions and the direction towards the sun.
    """

    distance_m: Floats32
    axes: Floats32
    corner_m: Floats32
    cell_m: float

    def lit(self, points_m: Floats32, cosine: Floats32) -> Floats32:
        """Share of sunlight `(n,)` that reaches points `(n, 3)`, soft over half a cell.

        `cosine` `(n,)` is that of the angle between surface normal and sun, positive.
        """
        grazing = np.sqrt(np.maximum(1 - cosine**2, 0)) / cosine
        bias = np.minimum(
            _BIAS_M + np.float32(_BIAS_CELLS * self.cell_m) * grazing, np.float32(_LARGEST_BIAS_M)
        )
        local = np.stack([_dot(points_m, axis) for axis in self.axes])
        place = (local[:2].T - self.corner_m[:2]) / np.float32(self.cell_m) - np.float32(0.5)
        total = np.zeros(len(place), dtype=np.float32)
        nearest = {
            "interpolation": cv2.INTER_NEAREST,
            "borderMode": cv2.BORDER_CONSTANT,
            "borderValue": (-1e9,),
        }
        for shift in (-0.3, 0.3):
            first = read_picture(self.distance_m, place + np.float32(shift), **nearest)
            total += local[2] > first - bias
        return np.asarray(total * np.float32(0.5))


@dataclass(frozen=True, slots=True)
class Lighting:
    """The light of one world at one time of day."""

    to_sun: Floats32
    sun: float
    ambient: float
    clouds: Floats32
    cloudiness: float
    dusk: bool
    shadow_map: ShadowMap | None

    @property
    def glare(self) -> float:
        """Brightness of the horizon: beside a clear sky's light on the ground it glares."""
        return 1.5 + 3.1 * min(self.sun, 1.0)

    def sky(self, direction: Floats32) -> Floats32:
        """Radiance of the sky `(n,)` along directions `(n, 3)` of any length."""
        length = np.sqrt(np.einsum("ij,ij->i", direction, direction))
        rise = np.clip(direction[:, 2] / length, 0.0, 1.0)
        base = self.ambient * self.glare * (1.0 - 0.48 * np.sqrt(rise))
        if self.dusk:
            toward = direction[:, :2] @ self.to_sun[:2] / length
            base = base * (0.55 + 0.45 * np.clip(toward, 0, 1)) * (1 - 0.5 * rise)
        scale = np.float32(60.0) / (rise + 0.12)
        place = np.stack([direction[:, 0] / length * scale, direction[:, 1] / length * scale], 1)
        place = np.mod(place + 200.0, TILE_PX - 2).astype(np.float32)
        cloud = read_picture(self.clouds, place)
        return np.asarray(base * (1 + self.cloudiness * cloud), dtype=np.float32)

    def on(
        self, points_m: Floats32, normals: Floats32, leafy: NDArray[np.bool_]
    ) -> tuple[Floats32, Floats32]:
        """Light of the sky and of the sun, `(n,)` each, on surfaces that face the viewer.

        Leaves let a part of the light through from behind. Only the shadow map dims the sun here.
        Sunny points move off their surfaces, in place, to where shadow rays may start.
        """
        cosine = _dot(normals, self.to_sun)
        cosine = np.maximum(cosine, cosine * (leafy * np.float32(-_TRANSLUCENT)))
        light = np.asarray(
            self.ambient * (0.55 + 0.45 * normals[:, 2]) + 0.03 * self.sun * (1 - normals[:, 2]),
            dtype=np.float32,
        )
        sunlight = np.zeros(len(light), dtype=np.float32)
        sunny = np.flatnonzero(cosine > 0.0)
        if not len(sunny) or self.sun == 0.0:
            return light, sunlight
        points_m[sunny] += 0.02 * normals[sunny]
        share: Floats32 | float = 1.0
        if self.shadow_map is not None:
            share = self.shadow_map.lit(points_m[sunny], np.abs(_dot(normals[sunny], self.to_sun)))
        sunlight[sunny] = np.float32(self.sun) * cosine[sunny] * share
        return light, sunlight


def sun_direction(elevation_deg: float, azimuth_deg: float) -> Floats32:
    """Unit vector to the sun; azimuth clockwise from north (the y axis)."""
    e, a = np.deg2rad(elevation_deg), np.deg2rad(azimuth_deg)
    return np.array([np.cos(e) * np.sin(a), np.cos(e) * np.cos(a), np.sin(e)], dtype=np.float32)


def make_lighting(world: World, static: Caster, shadows: bool, by_rays: bool) -> Lighting:
    """The light that the scenario asks for; the shadow map covers the street and 45 m around."""
    spec = world.scenario.light
    to_sun = sun_direction(spec.sun_elevation_deg, spec.sun_azimuth_deg)
    rng = np.random.default_rng([world.seed, 5])
    clouds = np.clip(fractal(rng, 1.7), -1, 2)
    shadow_map = None
    if shadows and not by_rays and spec.sun > 0:
        shadow_map = _shadow_map(world, static, to_sun)
    return Lighting(
        to_sun,
        spec.sun,
        spec.sky,
        clouds,
        0.35 * spec.clouds,
        spec.dusk,
        shadow_map,
    )


def _shadow_map(world: World, static: Caster, to_sun: Floats32) -> ShadowMap:
    x = np.cross([0.0, 0.0, 1.0], to_sun)
    x /= np.linalg.norm(x)
    axes = np.stack([x, np.cross(to_sun, x), to_sun]).astype(np.float32)
    route = world.route.points_m
    # the street and what can be seen of its surroundings, at ground level and at 12 m
    reach = 32.0
    ring = [(reach * np.cos(a), reach * np.sin(a)) for a in np.linspace(0, 6.28, 9)]
    points = np.concatenate(
        [np.column_stack([route + r, np.full(len(route), z)]) for r in ring for z in (0.0, 10.0)]
    )
    local = points @ axes.T.astype(np.float64)
    low, high = local.min(axis=0), local.max(axis=0)
    span = high[:2] - low[:2]
    cell = max(_CELL_M, float(span.max()) / _MAP_LIMIT_PX)
    columns, rows = (int(np.ceil(s / cell)) for s in span)
    top = float((world.mesh.vertices_m @ axes[2]).max()) + 1.0
    distance = np.full((rows, columns), -1e9, dtype=np.float32)
    direction = -to_sun
    block = 256
    across = (np.arange(columns, dtype=np.float32) + 0.5) * cell + low[0]
    for start in range(0, rows, block):
        up = (np.arange(start, min(rows, start + block), dtype=np.float32) + 0.5) * cell + low[1]
        u, v = np.meshgrid(across, up)
        local_rays = np.stack([u.ravel(), v.ravel(), np.full(u.size, top)], axis=1)
        rays = np.empty((u.size, 6), dtype=np.float32)
        rays[:, :3] = local_rays @ axes
        rays[:, 3:] = direction
        hits = static.cast(rays)
        distance[start : start + len(up)] = (top - hits.depth).reshape(u.shape)
    return ShadowMap(distance, axes, low.astype(np.float32), cell)
