"""Ray-cast stereo: scene irradiance of both cameras, true disparity and object ids.

A pixel's ray is cast through its centre; pixels at depth or object edges get further rays, so
that thin poles do not snap to the pixel grid. Sun shadows come from a depth map seen from the
sun, made once a world, or from shadow rays.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from polemap.simulate.camera_mounting import CameraPose
from polemap.simulate.lighting import make_lighting
from polemap.simulate.mesh import Mesh
from polemap.simulate.picture_rays import cast_picture, picture_rays, rays_through
from polemap.simulate.raycast import Caster, Hits
from polemap.simulate.shading import Shaded, make_shader
from polemap.simulate.textures import make_atlas
from polemap.simulate.world import World
from polemap.stereo.rig import StereoRig

Floats32 = NDArray[np.float32]
_SHADOW_REACH_M = 14.0
_EVERYWHERE = (-np.inf, -np.inf, np.inf, np.inf)


@dataclass(frozen=True, slots=True)
class View:
    """What one camera sees, `(height, width)`: irradiance, depth in metres, object ids."""

    irradiance: Floats32
    depth_m: Floats32
    owner: NDArray[np.int32]


@dataclass(frozen=True, slots=True)
class RenderOptions:
    """Quality against speed."""

    edge_rays: int = 2
    shadows: bool = True
    shadow_rays: bool = False
    threads: int = 0


class Renderer:
    """A world made ready for pictures of one rig."""

    def __init__(self, world: World, rig: StereoRig, options: RenderOptions | None = None) -> None:
        self.world = world
        self.rig = rig
        self.options = options or RenderOptions()
        self._static = Caster(world.mesh, self.options.threads)
        light = make_lighting(world, self._static, self.options.shadows, self.options.shadow_rays)
        self._shader = make_shader(make_atlas(world.seed), light, rig.focal_px)
        u, v = np.meshgrid(np.arange(rig.width_px), np.arange(rig.height_px))
        pixels = np.stack([u, v], axis=-1).reshape(-1, 2).astype(np.float32)
        self._pixels = pixels
        self._shifts = _shifts(self.options.edge_rays)

    def pair(self, poses: tuple[CameraPose, CameraPose], moving: Mesh) -> tuple[View, View]:
        """Left and right view of the world with the moving things at their places."""
        movers = Caster(moving, self.options.threads)
        left, right = (self._view(pose, moving, movers) for pose in poses)
        return left, right

    def _trace(
        self,
        pixels: Floats32,
        rays: Floats32,
        hits: Hits,
        pose: CameraPose,
        moving: Mesh,
        movers: Caster,
    ) -> Shaded:
        """What the rays through the pixels see; `hits` receive the depth of moving things."""
        shaded = self._shade(self.world.mesh, hits, rays, movers)
        if len(moving):
            candidates = self._may_see(moving, pixels, pose)
            self._over(moving, movers, rays, candidates, shaded, hits.depth)
        return shaded

    def _over(
        self,
        moving: Mesh,
        movers: Caster,
        rays: Floats32,
        candidates: NDArray[np.int64],
        shaded: Shaded,
        depth: Floats32,
    ) -> None:
        """Lays the moving things over the static picture, in place, where they may be."""
        if not len(candidates):
            return
        hits = movers.cast(rays[candidates])
        nearer = np.flatnonzero(hits.depth < depth[candidates])
        if not len(nearer):
            return
        rows = candidates[nearer]
        part = hits.rows(nearer)
        over = self._shade(moving, part, rays[rows], movers)
        shaded.light[rows], shaded.owner[rows] = over.light, over.owner
        depth[rows] = part.depth

    def _may_see(self, moving: Mesh, pixels: Floats32, pose: CameraPose) -> NDArray[np.int64]:
        """Rows of the pixels inside the bounding box of a moving thing's projection."""
        camera = (moving.vertices_m - pose.position_m) @ pose.rotation
        by_vertex = np.empty(len(camera), dtype=np.int32)
        by_vertex[moving.triangles.ravel()] = np.repeat(moving.owner, 3)
        inside = np.zeros(len(pixels), dtype=np.bool_)
        centre = np.array([self.rig.cx_px, self.rig.cy_px])
        for thing in np.unique(moving.owner):
            corners = camera[by_vertex == thing]
            if corners[:, 2].max() < 0.3:
                continue
            ahead = corners[corners[:, 2] > 0.3]
            place = centre + self.rig.focal_px * ahead[:, :2] / ahead[:, 2:]
            low, high = place.min(axis=0) - 2, place.max(axis=0) + 2
            inside |= (
                (pixels[:, 0] >= low[0]) & (pixels[:, 0] <= high[0])
                & (pixels[:, 1] >= low[1]) & (pixels[:, 1] <= high[1])
            )  # fmt: skip
        return np.flatnonzero(inside)

    def _shade(self, mesh: Mesh, hits: Hits, rays: Floats32, movers: Caster) -> Shaded:
        """What the rays see of one mesh, with the shadows of all."""
        by_rays = self.options.shadows and self.options.shadow_rays
        near = movers.around(_SHADOW_REACH_M) if self.options.shadows else None
        shaded = self._shader.shade(mesh, hits, rays, _EVERYWHERE if by_rays else near)
        if len(shaded.asked):
            blocked = movers.blocked(shaded.to_sun)
            if by_rays:
                blocked |= self._static.blocked(shaded.to_sun)
            shaded.light[shaded.asked[blocked]] -= shaded.sunlight[blocked]
        return shaded

    def _view(self, pose: CameraPose, moving: Mesh, movers: Caster) -> View:
        shape = (self.rig.height_px, self.rig.width_px)
        rays = picture_rays(self.rig, pose)
        hits = cast_picture(self._static, rays, self.rig)
        seen = self._trace(self._pixels, rays, hits, pose, moving, movers)
        light, depth = seen.light.reshape(shape), hits.depth.reshape(shape)
        owner = seen.owner.reshape(shape)
        if self.options.edge_rays:
            rows = np.flatnonzero(_edges(depth, owner, seen.leafy.reshape(shape)))
            total = seen.light[rows]
            for shift in self._shifts:
                pixels = self._pixels[rows] + shift
                more = rays_through(pixels, self.rig, pose)
                total += self._trace(
                    pixels, more, self._static.cast(more), pose, moving, movers
                ).light
            seen.light[rows] = total / (1 + self.options.edge_rays)
        return View(light, depth, owner)

    def true_disparity(self, view: View) -> Floats32:
        """Disparity in pixels `(height, width)`; 0 in the sky."""
        with np.errstate(divide="ignore"):
            return np.asarray(
                self.rig.focal_px * self.rig.baseline_m / view.depth_m, dtype=np.float32
            )


def _shifts(count: int) -> Floats32:
    """Places within a pixel, spread evenly from left to right and unevenly up and down."""
    across = (np.arange(count) - (count - 1) / 2) * (0.72 / max(count - 1, 1))
    down = ((np.arange(count) * 0.618) % 1.0 - 0.5) * 0.7
    return np.stack([across, down], axis=1).astype(np.float32)


def _edges(
    depth: Floats32, owner: NDArray[np.int32], leafy: NDArray[np.bool_]
) -> NDArray[np.bool_]:
    """Pixels beside a jump in inverse depth or between two objects; not inside foliage."""
    inverse = 1.0 / depth
    mark = np.zeros(depth.shape, dtype=np.bool_)
    for one, other, limit, by_owner in (
        (np.s_[:, 1:], np.s_[:, :-1], 0.03, True),
        # what lies flat comes nearer from row to row by itself
        (np.s_[1:], np.s_[:-1], 0.08, False),
    ):
        a, b = inverse[one], inverse[other]
        jump = np.abs(a - b) > limit * np.maximum(a, b)
        if by_owner:
            jump |= owner[one] != owner[other]
        jump &= ~(leafy[one] & leafy[other])
        mark[one] |= jump
        mark[other] |= jump
    return mark
