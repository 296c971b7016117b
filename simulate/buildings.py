"""Houses with relief (windows, doors, plinths, down-pipes) and the far line of trees and roofs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from polemap.simulate.materials import TILES
from polemap.simulate.mesh import Mesh, box, cylinder, join, panel, quads, triangles
from polemap.simulate.objects import Corner, box_corners


@dataclass(frozen=True, slots=True)
class House:
    """A house about the middle of its street front; x along the street, +y towards it."""

    mesh: Mesh
    width_m: float
    depth_m: float
    height_m: float

    @property
    def corners(self) -> tuple[Corner, ...]:
        """Its four, about the middle of the front."""
        return box_corners(self.width_m, self.depth_m, self.height_m, y_m=-self.depth_m / 2)


def house(rng: np.random.Generator, width_m: float, storeys: int) -> House:
    """A house whose front lies in y = 0."""
    depth, storey = float(rng.uniform(7, 10)), float(rng.uniform(2.7, 3.1))
    height = storeys * storey + 0.6
    tile = str(rng.choice(["plaster", "plaster", "plaster", "brick", "concrete"]))
    shade = float(rng.uniform(0.6, 1.25))
    parts = [box((0, -depth / 2, height / 2), (width_m, depth, height), TILES[tile], shade, 0.4)]
    plinth = float(rng.uniform(0.3, 0.7))
    parts.append(
        box(
            (0, -depth / 2, plinth / 2),
            (width_m + 0.06, depth + 0.06, plinth),
            TILES["concrete"],
            0.6,
        )
    )
    columns = max(2, int(width_m / rng.uniform(2.2, 3.0)))
    door = int(rng.integers(0, columns))
    wide, tall = float(rng.uniform(0.9, 1.4)), float(rng.uniform(1.2, 1.6))
    shutters = rng.uniform() < 0.35
    for floor in range(storeys):
        for k in range(columns):
            x = -width_m / 2 + (k + 0.5) * width_m / columns
            z = 0.6 + floor * storey + 0.95
            if floor == 0 and k == door:
                parts += _door(rng, x)
                continue
            parts += _window(x, z, wide, tall, shutters, shade)
    for side in (-1, 1):
        for floor in range(storeys):
            for k in range(2):
                y = -depth * (0.3 + 0.4 * k)
                z = 0.6 + floor * storey + 0.95
                parts.append(
                    panel(
                        (side * (width_m / 2 + 0.01), y - side * wide / 2, z),
                        (0, side * wide, 0),
                        (0, 0, tall),
                        TILES["window"],
                    )
                )
    for side in (-1, 1):
        if rng.uniform() < 0.6:
            x = side * (width_m / 2 - 0.15)
            parts.append(
                cylinder(
                    (x, 0.08, 0), (x, 0.08, height), 0.045, 0.045, TILES["metal"], 0.8, sides=8
                )
            )
    parts.append(_roof(rng, width_m, depth, height))
    return House(join(parts), width_m, depth, height)


def _window(
    x: float, z: float, wide: float, tall: float, shutters: bool, shade: float
) -> list[Mesh]:
    parts = [
        panel((x - wide / 2, 0.012, z), (wide, 0, 0), (0, 0, tall), TILES["window"], 1.0),
        box((x, 0.07, z - 0.04), (wide + 0.2, 0.16, 0.06), TILES["concrete"], 1.1),
    ]
    for side in (-1, 1):
        parts.append(
            box(
                (x + side * (wide / 2 + 0.05), 0.03, z + tall / 2),
                (0.10, 0.06, tall + 0.1),
                TILES["paint"],
                1.3 * shade,
            )
        )
        if shutters:
            parts.append(
                box(
                    (x + side * (wide * 0.75 + 0.12), 0.03, z + tall / 2),
                    (wide / 2, 0.05, tall),
                    TILES["planks"],
                    0.6,
                    2.0,
                )
            )
    return parts


def _door(rng: np.random.Generator, x: float) -> list[Mesh]:
    shade = float(rng.uniform(0.3, 0.9))
    parts = [panel((x - 0.5, 0.012, 0.3), (1.0, 0, 0), (0, 0, 2.1), TILES["planks"], shade, 1.0)]
    parts += [
        box((x + side * 0.56, 0.06, 1.4), (0.12, 0.14, 2.3), TILES["paint"], 1.3)
        for side in (-1, 1)
    ]
    parts.append(box((x, 0.35, 2.6), (1.6, 0.7, 0.08), TILES["concrete"], 0.9))
    for k in range(2):
        place = (x, 0.25 + 0.15 * (1 - k), 0.08 + 0.15 * k)
        parts += [box(place, (1.3, 0.8 - 0.3 * k, 0.16), TILES["concrete"])]
    return parts


def _roof(rng: np.random.Generator, width: float, depth: float, height: float) -> Mesh:
    rise, over = depth * rng.uniform(0.3, 0.45), 0.4
    x, y0, y1 = width / 2 + over, over, -depth - over
    ridge = -depth / 2
    front = [
        (-x, y0, height),
        (x, y0, height),
        (x, ridge, height + rise),
        (-x, ridge, height + rise),
    ]
    back = [
        (x, y1, height),
        (-x, y1, height),
        (-x, ridge, height + rise),
        (x, ridge, height + rise),
    ]
    corners = np.array([front, back])
    u, v = 2 * x * 0.35, np.hypot(rise, depth / 2) * 0.35
    uv = np.broadcast_to(np.array([[0, v], [u, v], [u, 0], [0, 0]]), (2, 4, 2))
    gables = np.array(
        [
            [
                (s * width / 2, 0, height),
                (s * width / 2, -depth, height),
                (s * width / 2, ridge, height + rise),
            ]
            for s in (-1, 1)
        ]
    )
    shade = float(rng.uniform(0.6, 1.4))
    return join(
        [
            quads(corners, uv, TILES["roof"], shade, 0.35),
            triangles(gables, gables[..., 1:] * 0.4, TILES["plaster"], 0.9, 0.4),
            box((rng.uniform(-2, 2), ridge + 0.8, height + rise), (0.6, 0.6, 1.2), TILES["brick"]),
        ]
    )


def backdrop(rng: np.random.Generator, centre_m: tuple[float, float], reach_m: float) -> Mesh:
    """A far, uneven wall of trees and gables, so that the street does not end in empty sky."""
    count = max(60, int(2 * np.pi * reach_m / 9))
    angle = np.linspace(0, 2 * np.pi, count + 1)
    radius = reach_m * (1 + 0.06 * rng.standard_normal(count + 1))
    radius[-1] = radius[0]
    height = np.clip(9 + 4 * rng.standard_normal(count), 4, 18)
    x = centre_m[0] + radius * np.cos(angle)
    y = centre_m[1] + radius * np.sin(angle)
    parts = []
    for k in range(count):
        leafy = rng.uniform() < 0.75
        tile, shade = (
            ("foliage", rng.uniform(0.7, 1.3)) if leafy else ("plaster", rng.uniform(0.5, 1.1))
        )
        a, b = (x[k], y[k], -1.0), (x[k + 1] - x[k], y[k + 1] - y[k], 0.0)
        wall = panel(
            a, b, (0, 0, float(height[k]) + 1.0), TILES[tile], float(shade), 0.12, (0.37 * k, 0.0)
        )
        parts.append(wall)
        if leafy:
            top = np.stack([rng.uniform(0, 1, 150)] * 3, axis=1) * np.array(b) + np.array(a)
            top[:, 2] = height[k] + rng.normal(0, 0.7, 150)
            direction = rng.normal(0, 0.35, (150, 3, 3))
            uv = rng.uniform(0, 1, (150, 3, 2)) * 0.3
            parts.append(
                triangles(top[:, None] + direction, uv, TILES["foliage"], float(shade), 0.12)
            )
    return join(parts)
