"""Triangle meshes with texture coordinates, gathered part by part into one table a ray can hit."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from polemap.vehicle.pose import pose_rotation

Floats32 = NDArray[np.float32]
Floats = NDArray[np.float64]
Ints = NDArray[np.int32]


@dataclass(frozen=True, slots=True)
class Mesh:
    """Triangles ready to be ray cast and shaded; row i of every table is triangle i.

    Attributes:
        vertices_m: `(n, 3)` float32, world metres.
        triangles: `(m, 3)` uint32 rows of `vertices_m`.
        surface: `(m, 8)` float32: texture coordinate of the first corner (2), its change along
            the first and the second barycentric coordinate (2 + 2), albedo, tile repeats a metre.
        tile: `(m,)` texture tile, see `textures.TILES`.
        owner: `(m,)` id of the object that the triangle belongs to; 0 is the ground.
    """

    vertices_m: Floats32
    triangles: NDArray[np.uint32]
    surface: Floats32
    tile: NDArray[np.uint8]
    owner: Ints

    def __len__(self) -> int:
        return len(self.triangles)

    def placed(
        self, x_m: float, y_m: float, z_m: float, yaw_rad: float, scale: float = 1.0
    ) -> Mesh:
        """The same mesh scaled, turned about its own z axis and moved."""
        turn = (pose_rotation(yaw_rad) * scale).astype(np.float32)
        moved = self.vertices_m @ turn.T + np.array([x_m, y_m, z_m], dtype=np.float32)
        return Mesh(moved, self.triangles, self.surface, self.tile, self.owner)

    def owned_by(self, owner: int, albedo_gain: float = 1.0) -> Mesh:
        """The same mesh as object `owner`, lighter or darker as a whole."""
        surface = self.surface
        if albedo_gain != 1.0:
            surface = surface.copy()
            surface[:, 6] *= albedo_gain
        ids = np.full(len(self), owner, dtype=np.int32)
        return Mesh(self.vertices_m, self.triangles, surface, self.tile, ids)


def join(meshes: list[Mesh]) -> Mesh:
    """One mesh out of many, in the order given."""
    if not meshes:
        return Mesh(
            np.zeros((0, 3), np.float32),
            np.zeros((0, 3), np.uint32),
            np.zeros((0, 8), np.float32),
            np.zeros(0, np.uint8),
            np.zeros(0, np.int32),
        )
    offsets = np.cumsum([0] + [len(m.vertices_m) for m in meshes[:-1]])
    return Mesh(
        np.concatenate([m.vertices_m for m in meshes]),
        np.concatenate(
            [m.triangles + np.uint32(o) for m, o in zip(meshes, offsets, strict=True)]
        ).astype(np.uint32),
        np.concatenate([m.surface for m in meshes]),
        np.concatenate([m.tile for m in meshes]),
        np.concatenate([m.owner for m in meshes]),
    )


def triangles(
    corners_m: NDArray[np.floating],
    uv: NDArray[np.floating],
    tile: int,
    albedo: float | NDArray[np.floating] = 1.0,
    repeats_per_m: float = 1.0,
) -> Mesh:
    """A mesh of loose triangles: corners `(m, 3, 3)` and texture coordinates `(m, 3, 2)`."""
    count = len(corners_m)
    surface = np.empty((count, 8), dtype=np.float32)
    surface[:, 0:2] = uv[:, 0]
    surface[:, 2:4] = uv[:, 1] - uv[:, 0]
    surface[:, 4:6] = uv[:, 2] - uv[:, 0]
    surface[:, 6] = albedo
    surface[:, 7] = repeats_per_m
    return Mesh(
        np.ascontiguousarray(corners_m, dtype=np.float32).reshape(-1, 3),
        np.arange(3 * count, dtype=np.uint32).reshape(-1, 3),
        surface,
        np.full(count, tile, dtype=np.uint8),
        np.zeros(count, dtype=np.int32),
    )


def quads(
    corners_m: NDArray[np.floating],
    uv: NDArray[np.floating],
    tile: int,
    albedo: float | NDArray[np.floating] = 1.0,
    repeats_per_m: float = 1.0,
) -> Mesh:
    """Quads `(q, 4, 3)`, corners in order around, with coordinates `(q, 4, 2)`."""
    order = np.array([[0, 1, 2], [0, 2, 3]])
    shade = np.repeat(np.broadcast_to(np.asarray(albedo, dtype=np.float32), len(corners_m)), 2)
    return triangles(
        np.asarray(corners_m)[:, order].reshape(-1, 3, 3),
        np.asarray(uv)[:, order].reshape(-1, 3, 2),
        tile,
        shade,
        repeats_per_m,
    )


def panel(
    origin_m: tuple[float, float, float],
    along_m: tuple[float, float, float],
    up_m: tuple[float, float, float],
    tile: int,
    albedo: float = 1.0,
    repeats_per_m: float | None = None,
    uv_shift: tuple[float, float] = (0.0, 0.0),
) -> Mesh:
    """One flat rectangle spanned by two edges; without repeats the tile covers it exactly once."""
    o, a, b = (np.asarray(v, dtype=np.float64) for v in (origin_m, along_m, up_m))
    width, height = float(np.linalg.norm(a)), float(np.linalg.norm(b))
    corners = np.stack([o, o + a, o + a + b, o + b])[None]
    if repeats_per_m is None:
        uv = np.array([[[0.002, 0.998], [0.998, 0.998], [0.998, 0.002], [0.002, 0.002]]])
        return quads(corners, uv, tile, albedo, 1.0 / max(width, height))
    u, v = width * repeats_per_m, height * repeats_per_m
    uv = np.array([[[0, v], [u, v], [u, 0], [0, 0]]]) + np.asarray(uv_shift)
    return quads(corners, uv, tile, albedo, repeats_per_m)


def box(
    centre_m: tuple[float, float, float],
    size_m: tuple[float, float, float],
    tile: int,
    albedo: float = 1.0,
    repeats_per_m: float = 1.0,
    taper: tuple[float, float] = (1.0, 1.0),
    shift_top_m: float = 0.0,
) -> Mesh:
    """An upright box about `centre_m`; `taper` scales its top, `shift_top_m` moves it."""
    hx, hy, hz = (s / 2 for s in size_m)
    cx, cy, cz = centre_m
    tx, ty = hx * taper[0], hy * taper[1]
    bottom = np.array([[-hx, -hy, -hz], [hx, -hy, -hz], [hx, hy, -hz], [-hx, hy, -hz]])
    top = np.array([[-tx, -ty, hz], [tx, -ty, hz], [tx, ty, hz], [-tx, ty, hz]])
    top[:, 0] += shift_top_m
    p = np.concatenate([bottom, top]) + np.array([cx, cy, cz])
    faces = [(0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7), (4, 5, 6, 7), (3, 2, 1, 0)]
    spans = [(0, 2), (1, 2), (0, 2), (1, 2), (0, 1), (0, 1)]
    corners, uv = list[Floats](), list[Floats]()
    for face, (a, b) in zip(faces, spans, strict=True):
        corners.append(p[list(face)])
        u, v = size_m[a] * repeats_per_m, size_m[b] * repeats_per_m
        shift = (0.37 * len(uv) + cx, 0.61 * len(uv) + cy)
        uv.append(np.array([[0, v], [u, v], [u, 0], [0, 0]]) + shift)
    return quads(np.array(corners), np.array(uv), tile, albedo, repeats_per_m)


def cylinder(
    base_m: tuple[float, float, float],
    top_m: tuple[float, float, float],
    radius_base_m: float,
    radius_top_m: float,
    tile: int,
    albedo: float = 1.0,
    repeats_per_m: float = 1.0,
    sides: int = 14,
    cap: bool = True,
) -> Mesh:
    """A round, tapered rod between two points, textured around and along."""
    b, t = np.asarray(base_m, dtype=np.float64), np.asarray(top_m, dtype=np.float64)
    axis = t - b
    length = float(np.linalg.norm(axis))
    axis /= length
    helper = np.array([1.0, 0, 0]) if abs(axis[2]) > 0.7 else np.array([0, 0, 1.0])
    e1 = np.cross(axis, helper)
    e1 /= np.linalg.norm(e1)
    e2 = np.cross(axis, e1)
    angle = np.linspace(0, 2 * np.pi, sides + 1)
    ring = np.cos(angle)[:, None] * e1 + np.sin(angle)[:, None] * e2
    low, high = b + radius_base_m * ring, t + radius_top_m * ring
    corners = np.stack([low[:-1], low[1:], high[1:], high[:-1]], axis=1)
    around = angle / (2 * np.pi) * max(1.0, round(2 * np.pi * radius_base_m * repeats_per_m))
    v = length * repeats_per_m
    zero = np.zeros(sides)
    uv = np.stack(
        [
            np.stack([around[:-1], zero + v], 1),
            np.stack([around[1:], zero + v], 1),
            np.stack([around[1:], zero], 1),
            np.stack([around[:-1], zero], 1),
        ],
        axis=1,
    ) + np.array([base_m[0] * 0.31, base_m[1] * 0.17])
    rod = quads(corners, uv, tile, albedo, repeats_per_m)
    if not cap:
        return rod
    lid = np.stack([high[:-1], high[1:], np.broadcast_to(t, (sides, 3))], axis=1)
    flat = (lid[..., :2] - t[:2]) * repeats_per_m
    return join([rod, triangles(lid, flat, tile, albedo, repeats_per_m)])


def cards(
    centres_m: NDArray[np.floating],
    size_m: float,
    tile: int,
    albedo: float,
    repeats_per_m: float,
    rng: np.random.Generator,
) -> Mesh:
    """Small triangles in random directions: leaves, twigs, blossoms. Centres are `(m, 3)`."""
    count = len(centres_m)
    a = rng.normal(size=(count, 3))
    a /= np.linalg.norm(a, axis=1, keepdims=True)
    b = np.cross(a, rng.normal(size=(count, 3)))
    b /= np.linalg.norm(b, axis=1, keepdims=True)
    span = size_m * rng.uniform(0.6, 1.4, (count, 1))
    corners = np.stack([-0.5 * a - 0.4 * b, 0.5 * a - 0.4 * b, 0.7 * b], axis=1)
    corners = corners * span[:, None] + np.asarray(centres_m)[:, None]
    uv = np.stack([[-0.5, -0.4], [0.5, -0.4], [0.0, 0.7]])[None] * span[:, None] * repeats_per_m
    uv = uv + rng.uniform(0, 1, (count, 1, 2))
    return triangles(corners, uv, tile, albedo * rng.uniform(0.55, 1.45, count), repeats_per_m)
