"""The light that comes along each ray of a picture: texture, sky, sun, mirrored sky.

`KernelShader` does in one pass of C++ what `PlainShader` does with arrays.
"""

from __future__ import annotations

from dataclasses import dataclass
from importlib import import_module
from typing import Any, Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from polemap.simulate.lighting import Lighting
from polemap.simulate.materials import TILES
from polemap.simulate.mesh import Mesh
from polemap.simulate.raycast import Hits
from polemap.simulate.textures import Atlas

Floats32 = NDArray[np.float32]
Box = tuple[float, float, float, float]
SKY_OWNER = -1
# rows that stay in the cache together
_BLOCK = 24_576

LEAFY = np.zeros(len(TILES), dtype=np.uint8)
LEAFY[[TILES["leaves"], TILES["foliage"]]] = 1
GLOSS = np.zeros(len(TILES), dtype=np.float32)
GLOSS[TILES["glass"]], GLOSS[TILES["enamel"]] = 0.22, 0.05


@dataclass(frozen=True, slots=True)
class Shaded:
    """What n rays see, before things that a shadow map does not know have cast their shadows.

    Attributes:
        light, owner, leafy: `(n,)` irradiance, id of what is seen, whether it is foliage.
        asked: `(k,)` rows of sunny points where the caller wants to know.
        to_sun: `(k, 6)` rays from there to the sun.
        sunlight: `(k,)` what `light` loses there if something stands between.
    """

    light: Floats32
    owner: NDArray[np.int32]
    leafy: NDArray[np.bool_]
    asked: NDArray[np.int64]
    to_sun: Floats32
    sunlight: Floats32


class Shader(Protocol):
    """Anything that shades the hits of rays `(n, 6)`; `ask` bounds the points to report."""

    def shade(self, mesh: Mesh, hits: Hits, rays: Floats32, ask: Box | None) -> Shaded:
        """Irradiance of every hit, and the points that `ask` bounds."""


def make_shader(
    atlas: Atlas,
    light: Lighting,
    focal_px: float,
    backend: Literal["auto", "native", "numpy"] = "auto",
) -> Shader:
    """The kernel where it is built, else arrays.

    Raises:
        ImportError: `native` is asked for and was not built.
    """
    if backend == "numpy":
        return PlainShader(atlas, light, focal_px)
    try:
        return KernelShader(atlas, light, focal_px)
    except ImportError:
        if backend == "native":
            raise
        return PlainShader(atlas, light, focal_px)


class KernelShader:
    """Shades with the C++ extension."""

    def __init__(self, atlas: Atlas, light: Lighting, focal_px: float) -> None:
        kernel: Any = import_module("polemap.simulate.native.shading_kernel")
        self._kernel = kernel.Shader(
            atlas=atlas.pixels,
            corners=atlas.corner_px,
            leafy=LEAFY,
            gloss=GLOSS,
            macro=TILES["macro"],
            foliage=TILES["foliage"],
            clouds=light.clouds,
            light={
                "to_sun": light.to_sun,
                "sun": light.sun,
                "ambient": light.ambient,
                "glare": light.glare,
                "cloudiness": light.cloudiness,
                "dusk": light.dusk,
            },
            shadow_map=light.shadow_map,
            focal_px=focal_px,
        )

    def shade(self, mesh: Mesh, hits: Hits, rays: Floats32, ask: Box | None) -> Shaded:
        """See `Shader`."""
        found = self._kernel.shade(
            mesh.surface, mesh.tile, mesh.owner, rays,
            hits.depth, hits.triangle, hits.bary, hits.normal, ask or (),
        )  # fmt: skip
        return Shaded(*found)


class PlainShader:
    """Shades with numpy and OpenCV; the reference of the kernel."""

    def __init__(self, atlas: Atlas, light: Lighting, focal_px: float) -> None:
        self._atlas, self._light = atlas, light
        self._per_focal = np.float32(1 / focal_px)

    def shade(self, mesh: Mesh, hits: Hits, rays: Floats32, ask: Box | None) -> Shaded:
        """See `Shader`."""
        count = len(rays)
        light = np.empty(count, dtype=np.float32)
        sunlight = np.zeros(count, dtype=np.float32)
        points = np.zeros((count, 3), dtype=np.float32)
        seen = np.isfinite(hits.depth)
        for start in range(0, count, _BLOCK):
            rows = np.arange(start, min(start + _BLOCK, count))
            empty, found = rows[~seen[rows]], rows[seen[rows]]
            light[empty] = self._light.sky(rays[empty, 3:])
            if len(found):
                light[found], sunlight[found], points[found] = self._surface(
                    mesh, hits.rows(found), rays[found]
                )
        asked = np.empty(0, dtype=np.int64)
        if ask is not None:
            x, y = points[:, 0], points[:, 1]
            near = (x > ask[0]) & (y > ask[1]) & (x < ask[2]) & (y < ask[3])
            asked = np.flatnonzero(near & (sunlight > 0))
        to_sun = np.empty((len(asked), 6), dtype=np.float32)
        to_sun[:, :3], to_sun[:, 3:] = points[asked], self._light.to_sun
        owner = np.where(seen, mesh.owner[hits.triangle], SKY_OWNER).astype(np.int32)
        leafy = seen & (LEAFY[mesh.tile[hits.triangle]] > 0)
        return Shaded(light, owner, leafy, asked, to_sun, sunlight[asked])

    def _surface(
        self, mesh: Mesh, hits: Hits, rays: Floats32
    ) -> tuple[Floats32, Floats32, Floats32]:
        """Light of surfaces, the part of it that is the sun's, and the points `(n, 3)`."""
        ray = rays[:, 3:]
        surface = np.take(mesh.surface, hits.triangle, axis=0)
        uv = surface[:, 0:2] + hits.bary[:, :1] * surface[:, 2:4]
        uv += hits.bary[:, 1:] * surface[:, 4:6]
        facing = np.einsum("ij,ij->i", hits.normal, ray)
        normal = hits.normal * np.where(facing > 0, np.float32(-1), np.float32(1))[:, None]
        reach = np.sqrt(np.einsum("ij,ij->i", ray, ray))
        grazing = np.maximum(np.abs(facing) / reach, 0.03)
        # the geometric mean of the two axes of the footprint: between blur and aliasing
        footprint = hits.depth * surface[:, 7] / np.sqrt(grazing)
        footprint *= self._per_focal
        tile = np.take(mesh.tile, hits.triangle)
        albedo = self._atlas.sample(tile, uv, footprint)
        albedo *= surface[:, 6]
        point = rays[:, :3] + ray * hits.depth[:, None]
        albedo *= 2.0 * self._atlas.sample_one(TILES["macro"], _unfold(point, normal))
        light, sunlight = self._light.on(point, normal, np.take(LEAFY, tile) > 0)
        sunlight *= albedo
        light = light * albedo + sunlight
        gloss = np.take(GLOSS, tile)
        shiny = np.flatnonzero(gloss)
        if len(shiny):
            unit = ray[shiny] / reach[shiny, None]
            across = np.einsum("ij,ij->i", unit, normal[shiny])
            mirrored = unit - 2 * across[:, None] * normal[shiny]
            # Schlick's approximation: everything mirrors at a grazing angle
            share = gloss[shiny] + (1 - gloss[shiny]) * 0.7 * (1 + across) ** 5
            light[shiny] += share * self._light.sky(mirrored) * self._reflection(mirrored)
        return light, sunlight, point

    def _reflection(self, direction: Floats32) -> Floats32:
        """What glass mirrors besides the sky: blotches that slide as the car moves."""
        seen = self._atlas.sample_one(TILES["foliage"], direction[:, :2] * np.float32(0.6), 2)
        return np.asarray(np.clip(0.3 + 3.0 * seen, 0, 2), dtype=np.float32)


def _unfold(points_m: Floats32, normals: Floats32) -> Floats32:
    """Coordinates `(n, 2)` of the large stains: from above on the ground, along and up on walls."""
    upright = np.abs(normals[:, 2]) < 0.7
    out = np.empty((len(points_m), 2), dtype=np.float32)
    out[:, 0] = points_m[:, 0] + points_m[:, 1] * (upright * np.float32(0.83))
    out[:, 1] = np.where(upright, points_m[:, 2] * np.float32(1.7), points_m[:, 1])
    out *= np.float32(0.041)
    return out
