"""Ray-cast stereo: scene irradiance of both cameras, true disparity and object ids.

A pixel's ray is cast through its centre; pixels at depth or object edges get further rays, so
that thin poles do not snap to the pixel grid. Sun shadows come from a depth map seen from the
sun, made once a world, or from shadow rays.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simulate.lighting import Lighting, make_lighting
from simulate.mesh import Mesh, join
from simulate.raycast import Caster, Hits
from simulate.textures import TILES, make_atlas
from simulate.world import World
from stereo.rig import StereoRig

Floats = NDArray[np.float64]
Floats32 = NDArray[np.float32]
SKY_OWNER = -1
_BLOCK = 24_576


@dataclass(frozen=True, slots=True)
class CameraPose:
    """A camera in the world: rotation `(3, 3)` world from camera axes, position `(3,)` metres."""

    rotation: Floats
    position_m: Floats


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
        self._atlas = make_atlas(world.seed)
        self._static = Caster(world.mesh, self.options.threads)
        self._light: Lighting = make_lighting(
            world, self._static, self.options.shadows, self.options.shadow_rays
        )
        u, v = np.meshgrid(np.arange(rig.width_px), np.arange(rig.height_px))
        pixels = np.stack([u, v], axis=-1).reshape(-1, 2).astype(np.float32)
        self._pixels = pixels
        self._shifts = _shifts(self.options.edge_rays)
        self._leafy = np.zeros(len(TILES), dtype=np.bool_)
        self._gloss = np.zeros(len(TILES), dtype=np.float32)
        self._gloss[TILES["glass"]], self._gloss[TILES["enamel"]] = 0.22, 0.05
        self._leafy[[TILES["leaves"], TILES["foliage"]]] = True

    def pair(self, poses: tuple[CameraPose, CameraPose], moving: Mesh) -> tuple[View, View]:
        """Left and right view of the world with the moving things at their places."""
        movers = Caster(moving, self.options.threads)
        left, right = (self._view(pose, moving, movers) for pose in poses)
        return left, right

    def _directions(self, pixels: Floats32, pose: CameraPose) -> Floats32:
        rig, turn = self.rig, pose.rotation.astype(np.float32)
        across = (pixels[:, 0] - np.float32(rig.cx_px)) * np.float32(1 / rig.focal_px)
        down = (pixels[:, 1] - np.float32(rig.cy_px)) * np.float32(1 / rig.focal_px)
        # spelled out: a matrix product of this slim shape is ten times slower
        out = np.empty((len(pixels), 3), dtype=np.float32)
        for axis in range(3):
            np.multiply(across, turn[axis, 0], out=out[:, axis])
            out[:, axis] += down * turn[axis, 1] + turn[axis, 2]
        return out

    def _rays(self, pixels: Floats32, pose: CameraPose) -> Floats32:
        rays = np.empty((len(pixels), 6), dtype=np.float32)
        rays[:, :3] = pose.position_m
        rays[:, 3:] = self._directions(pixels, pose)
        return rays

    def _cast_picture(self, rays: Floats32) -> Hits:
        """Every second row is cast; between two hits on one triangle the third follows.

        Along an image column inverse depth, and barycentric coordinates times it, are linear on a
        plane, so the row between is their mean. Only things less than a row high can be missed.
        """
        height, width = self.rig.height_px, self.rig.width_px
        rows = rays.reshape(height, width, 6)
        even = self._static.cast(np.ascontiguousarray(rows[::2]).reshape(-1, 6))
        odd_rows = height // 2
        shape = (-1, width)
        inverse = (1.0 / even.depth).reshape(shape)
        triangle = even.triangle.reshape(shape)
        bary = even.bary.reshape(-1, width, 2)
        normal = even.normal.reshape(-1, width, 3)
        below = np.minimum(np.arange(odd_rows) + 1, len(triangle) - 1)
        same = (triangle[:odd_rows] == triangle[below]) & (
            (inverse[:odd_rows] > 0) == (inverse[below] > 0)
        )
        same[below == np.arange(odd_rows)] = False
        out = Hits(
            np.empty(height * width, np.float32),
            np.empty(height * width, np.int64),
            np.empty((height * width, 2), np.float32),
            np.empty((height * width, 3), np.float32),
        )
        grids = (
            out.depth.reshape(height, width),
            out.triangle.reshape(height, width),
            out.bary.reshape(height, width, 2),
            out.normal.reshape(height, width, 3),
        )
        grids[0][::2], grids[1][::2] = even.depth.reshape(shape), triangle
        grids[2][::2], grids[3][::2] = bary, normal
        middle = 0.5 * (inverse[:odd_rows] + inverse[below])
        with np.errstate(divide="ignore", invalid="ignore"):
            depth = (1.0 / middle).astype(np.float32)
            between = (
                0.5
                * (
                    bary[:odd_rows] * inverse[:odd_rows, :, None]
                    + bary[below] * inverse[below][..., None]
                )
                * depth[..., None]
            )
        grids[0][1::2], grids[1][1::2] = depth, triangle[:odd_rows]
        grids[2][1::2], grids[3][1::2] = between, normal[:odd_rows]
        ask = np.flatnonzero(~same.ravel())
        found = self._static.cast(rows[1::2].reshape(-1, 6)[ask])
        at = ask + (ask // width + 1) * width
        out.depth[at], out.triangle[at] = found.depth, found.triangle
        out.bary[at], out.normal[at] = found.bary, found.normal
        return out

    def _trace(
        self,
        pixels: Floats32,
        rays: Floats32,
        hits: Hits,
        pose: CameraPose,
        moving: Mesh,
        movers: Caster,
    ) -> tuple[Floats32, Floats32, NDArray[np.int32], NDArray[np.bool_]]:
        """Irradiance, depth, owner and leafiness `(n,)` along the rays through the pixels."""
        count = len(rays)
        light = np.empty(count, dtype=np.float32)
        mesh = self.world.mesh
        # blocks that stay in the cache
        for start in range(0, count, _BLOCK):
            part = slice(start, start + _BLOCK)
            light[part] = self._shade(mesh, hits.rows(part), rays[part, 3:], pose, movers)
        depth = hits.depth
        seen = np.isfinite(depth)
        owner = np.where(seen, mesh.owner[hits.triangle], SKY_OWNER)
        leafy = seen & self._leafy[mesh.tile[hits.triangle]]
        if len(moving):
            candidates = self._may_see(moving, pixels, pose)
            self._over(moving, movers, rays, candidates, pose, light, depth, owner)
        return light, depth, owner, leafy

    def _over(
        self,
        moving: Mesh,
        movers: Caster,
        rays: Floats32,
        candidates: NDArray[np.int64],
        pose: CameraPose,
        light: Floats32,
        depth: Floats32,
        owner: NDArray[np.int32],
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
        light[rows] = self._shade(moving, part, rays[rows, 3:], pose, movers)
        depth[rows] = part.depth
        owner[rows] = moving.owner[part.triangle]

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

    def _shade(
        self, mesh: Mesh, hits: Hits, direction: Floats32, pose: CameraPose, movers: Caster
    ) -> Floats32:
        """Irradiance `(n,)` of the hit surfaces, or of the sky."""
        seen = np.isfinite(hits.depth)
        if seen.all():
            return self._surface(mesh, hits, direction, pose, movers)
        out = np.empty(len(seen), dtype=np.float32)
        found, empty = np.flatnonzero(seen), np.flatnonzero(~seen)
        out[empty] = self._light.sky(direction[empty])
        if len(found):
            out[found] = self._surface(mesh, hits.rows(found), direction[found], pose, movers)
        return out

    def _surface(
        self, mesh: Mesh, hits: Hits, ray: Floats32, pose: CameraPose, movers: Caster
    ) -> Floats32:
        surface = np.take(mesh.surface, hits.triangle, axis=0)
        uv = surface[:, 0:2] + hits.bary[:, :1] * surface[:, 2:4]
        uv += hits.bary[:, 1:] * surface[:, 4:6]
        facing = np.einsum("ij,ij->i", hits.normal, ray)
        normal = hits.normal * -np.sign(facing)[:, None]
        reach = np.sqrt(np.einsum("ij,ij->i", ray, ray))
        grazing = np.maximum(np.abs(facing) / reach, 0.03)
        # the geometric mean of the two axes of the footprint: between blur and aliasing
        footprint = hits.depth * surface[:, 7] / np.sqrt(grazing)
        footprint *= np.float32(1 / self.rig.focal_px)
        tile = np.take(mesh.tile, hits.triangle)
        albedo = self._atlas.sample(tile, uv, footprint)
        albedo *= surface[:, 6]
        point = pose.position_m.astype(np.float32) + ray * hits.depth[:, None]
        albedo *= 2.0 * self._atlas.sample_one(TILES["macro"], _unfold(point, normal))
        albedo *= self._light.on(point, normal, np.take(self._leafy, tile), movers)
        gloss = np.take(self._gloss, tile)
        shiny = np.flatnonzero(gloss)
        if len(shiny):
            unit = ray[shiny] / reach[shiny, None]
            across = np.einsum("ij,ij->i", unit, normal[shiny])
            mirrored = unit - 2 * across[:, None] * normal[shiny]
            # Schlick's approximation: everything mirrors at a grazing angle
            share = gloss[shiny] + (1 - gloss[shiny]) * 0.7 * (1 + across) ** 5
            albedo[shiny] += share * self._light.sky(mirrored) * self._reflection(mirrored)
        return albedo

    def _reflection(self, direction: Floats32) -> Floats32:
        """What glass mirrors besides the sky: blotches that slide as the car moves."""
        seen = self._atlas.sample_one(TILES["foliage"], direction[:, :2] * np.float32(0.6), 2)
        return np.asarray(np.clip(0.3 + 3.0 * seen, 0, 2), dtype=np.float32)

    def _view(self, pose: CameraPose, moving: Mesh, movers: Caster) -> View:
        shape = (self.rig.height_px, self.rig.width_px)
        rays = self._rays(self._pixels, pose)
        hits = self._cast_picture(rays)
        light, depth, owner, leafy = self._trace(self._pixels, rays, hits, pose, moving, movers)
        if self.options.edge_rays:
            marks = _edges(depth.reshape(shape), owner.reshape(shape), leafy.reshape(shape))
            rows = np.flatnonzero(marks.ravel())
            total = light[rows].copy()
            for k in range(self.options.edge_rays):
                pixels = self._pixels[rows] + self._shifts[k]
                more = self._rays(pixels, pose)
                hits = self._static.cast(more)
                total += self._trace(pixels, more, hits, pose, moving, movers)[0]
            light[rows] = total / (1 + self.options.edge_rays)
        return View(
            light.reshape(shape), depth.reshape(shape), owner.reshape(shape).astype(np.int32)
        )

    def true_disparity(self, view: View) -> Floats32:
        """Disparity in pixels `(height, width)`; 0 in the sky."""
        with np.errstate(divide="ignore"):
            return np.asarray(
                self.rig.focal_px * self.rig.baseline_m / view.depth_m, dtype=np.float32
            )


def _unfold(points_m: Floats32, normals: Floats32) -> Floats32:
    """Coordinates `(n, 2)` of the large stains: from above on the ground, along and up on walls."""
    upright = np.abs(normals[:, 2]) < 0.7
    out = np.empty((len(points_m), 2), dtype=np.float32)
    out[:, 0] = points_m[:, 0] + points_m[:, 1] * (upright * np.float32(0.83))
    out[:, 1] = np.where(upright, points_m[:, 2] * np.float32(1.7), points_m[:, 1])
    out *= np.float32(0.041)
    return out


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
    for one, other, limit in (
        (np.s_[:, 1:], np.s_[:, :-1], 0.03),
        (np.s_[1:], np.s_[:-1], 0.08),
    ):
        a, b = inverse[one], inverse[other]
        jump = np.abs(a - b) > limit * np.maximum(a, b)
        if limit < 0.05:
            jump |= owner[one] != owner[other]
        jump &= ~(leafy[one] & leafy[other])
        mark[one] |= jump
        mark[other] |= jump
    return mark


def camera_poses(
    rig: StereoRig,
    vehicle_position_m: Floats,
    vehicle_rotation: Floats,
    right_tilt: Floats | None = None,
) -> tuple[CameraPose, CameraPose]:
    """Both cameras of a vehicle; `right_tilt` `(3, 3)` turns the right camera out of true."""
    mount = rig.vehicle_from_camera
    rotation = vehicle_rotation @ mount.rotation()
    origin = vehicle_position_m + vehicle_rotation @ np.array([mount.x_m, mount.y_m, mount.z_m])
    beside = origin + rotation @ np.array([rig.baseline_m, 0.0, 0.0])
    turned = rotation if right_tilt is None else rotation @ right_tilt
    return CameraPose(rotation, origin), CameraPose(turned, beside)


def rotation_from_angles(yaw_rad: float, pitch_rad: float, roll_rad: float) -> Floats:
    """Rz(yaw) Ry(pitch) Rx(roll) `(3, 3)`; a positive pitch turns the nose down (ISO 8855)."""
    cy, sy = np.cos(yaw_rad), np.sin(yaw_rad)
    cp, sp = np.cos(pitch_rad), np.sin(pitch_rad)
    cr, sr = np.cos(roll_rad), np.sin(roll_rad)
    rz = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1.0]])
    ry = np.array([[cp, 0, sp], [0, 1.0, 0], [-sp, 0, cp]])
    rx = np.array([[1.0, 0, 0], [0, cr, -sr], [0, sr, cr]])
    return np.asarray(rz @ ry @ rx)


NOTHING = join([])
