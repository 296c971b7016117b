"""What stands beside a street: poles of every kind, and what is easily taken for one.

Every maker builds its object about the origin: x along the road, +y towards the road, base at
z = 0. Whether it counts as a pole of the true map is said by `Standing.pole`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import cos, radians, sin

import numpy as np

from polemap.simulate.materials import TILES
from polemap.simulate.mesh import Mesh, box, cylinder, join, panel, quads


@dataclass(frozen=True, slots=True)
class Corner:
    """A vertical edge; `facing_rad` points away from what it bounds, between its two sides."""

    x_m: float
    y_m: float
    facing_rad: float
    height_m: float


def box_corners(
    size_x_m: float, size_y_m: float, height_m: float, x_m: float = 0.0, y_m: float = 0.0
) -> tuple[Corner, ...]:
    """The four vertical edges of an upright box about (`x_m`, `y_m`)."""
    return tuple(
        Corner(x_m + i * size_x_m / 2, y_m + j * size_y_m / 2, float(np.arctan2(j, i)), height_m)
        for i, j in ((1, 1), (-1, 1), (-1, -1), (1, -1))
    )


@dataclass(frozen=True, slots=True)
class Standing:
    """An object of one kind: its mesh and, for a pole, diameter near the ground and height."""

    mesh: Mesh
    pole: bool
    width_m: float
    height_m: float
    corners: tuple[Corner, ...] = ()


@dataclass(frozen=True, slots=True)
class Wish:
    """What a scenario row asks of its objects; None leaves it to the kind."""

    lean_rad: float = 0.0
    height_m: tuple[float, float] | None = None
    radius_m: tuple[float, float] | None = None


Maker = Callable[[np.random.Generator, Wish], Standing]


def pick(
    rng: np.random.Generator, span: tuple[float, float] | None, usual: tuple[float, float]
) -> float:
    """A size drawn from the span that the scenario gives, or else the usual one."""
    low, high = span or usual
    return float(rng.uniform(low, high))


def lean_slope(rng: np.random.Generator, lean_rad: float) -> tuple[float, float]:
    """Slope (dx, dy per metre of height) of an axis that leans up to `lean_rad` any way."""
    angle, turn = rng.uniform(0, lean_rad), rng.uniform(0, 2 * np.pi)
    return float(np.tan(angle) * cos(turn)), float(np.tan(angle) * sin(turn))


def _rod(
    radius_m: float,
    height_m: float,
    tile: str,
    albedo: float,
    slope: tuple[float, float] = (0.0, 0.0),
    taper: float = 1.0,
    repeats_per_m: float = 1.0,
    sides: int = 14,
) -> Mesh:
    top = (slope[0] * height_m, slope[1] * height_m, height_m)
    return cylinder(
        (0, 0, -0.1), top, radius_m, radius_m * taper, TILES[tile], albedo, repeats_per_m, sides
    )


def lamp(rng: np.random.Generator, wish: Wish) -> Standing:
    """A street lamp with an arm over the road, or a park lamp with a globe."""
    height = pick(rng, wish.height_m, (4.2, 8.0))
    radius = pick(rng, wish.radius_m, (0.055, 0.095))
    slope = lean_slope(rng, max(wish.lean_rad, radians(1.0)))
    shade = float(rng.choice([0.45, 0.9, 1.5]))
    parts = [_rod(radius, height, "metal", shade, slope, 0.65)]
    parts.append(_rod(radius * 1.5, 0.9, "metal", shade * 0.9, slope))
    x, y = slope[0] * height, slope[1] * height
    if height > 5.2:
        reach = float(rng.uniform(0.9, 1.8))
        tip = (x, y + reach, height + 0.35)
        parts.append(cylinder((x, y, height), tip, 0.035, 0.03, TILES["metal"], shade, sides=8))
        parts.append(box((x, y + reach + 0.25, height + 0.34), (0.28, 0.65, 0.14), TILES["paint"]))
    else:
        parts.append(
            cylinder(
                (x, y, height), (x, y, height + 0.5), 0.16, 0.22, TILES["paint"], 1.5, sides=10
            )
        )
    return Standing(join(parts), True, 2 * radius, height)


def sign(rng: np.random.Generator, wish: Wish) -> Standing:
    """A traffic sign: one or two plates on a grey tube."""
    radius = pick(rng, wish.radius_m, (0.03, 0.042))
    height = pick(rng, wish.height_m, (2.3, 3.1))
    slope = lean_slope(rng, max(wish.lean_rad, radians(2.0)))
    parts = [_rod(radius, height, "metal", 1.2, slope, sides=10)]
    size = float(rng.uniform(0.42, 0.68))
    z = height
    facing = 1.0 if rng.uniform() < 0.5 else -1.0
    for _ in range(int(rng.integers(1, 3))):
        z -= size + 0.03
        x = slope[0] * z + facing * (radius + 0.012)
        y = slope[1] * z
        if rng.uniform() < 0.6:
            parts.append(_disc(x, y, z + size / 2, size / 2, facing))
        else:
            parts.append(
                panel(
                    (x, y - facing * size / 2, z),
                    (0, facing * size, 0),
                    (0, 0, size),
                    TILES["sign"],
                )
            )
    return Standing(join(parts), True, 2 * radius, height)


def _disc(x: float, y: float, z: float, radius_m: float, facing: float) -> Mesh:
    angle = np.linspace(0, 2 * np.pi, 19)
    rim = np.stack([np.full(19, x), y + radius_m * np.cos(angle), z + radius_m * np.sin(angle)], 1)
    hub = np.broadcast_to([x, y, z], (18, 3))
    corners = np.stack([hub, rim[:-1], rim[1:], rim[1:]], axis=1)
    uv = 0.5 + 0.49 * np.stack(
        [corners[..., 1] - y, -(corners[..., 2] - z)], axis=-1
    ) / radius_m * [facing, 1]
    return quads(corners, uv, TILES["sign"], 1.0, 0.5 / radius_m)


def traffic_light(rng: np.random.Generator, wish: Wish) -> Standing:
    """A signal on a mast, with a dark head."""
    radius = pick(rng, wish.radius_m, (0.06, 0.09))
    height = pick(rng, wish.height_m, (3.1, 3.6))
    parts = [_rod(radius, height, "metal", 1.1)]
    parts.append(box((-radius - 0.17, 0, height - 0.55), (0.30, 0.30, 0.95), TILES["paint"], 0.12))
    if rng.uniform() < 0.5:
        parts.append(box((0, radius + 0.16, height - 1.0), (0.2, 0.3, 0.75), TILES["paint"], 0.14))
    parts.append(box((0, radius + 0.05, 1.1), (0.12, 0.10, 0.18), TILES["paint"], 1.5))
    return Standing(join(parts), True, 2 * radius, height)


def bollard(rng: np.random.Generator, wish: Wish) -> Standing:
    """A bollard of stone, iron or plastic, about hip-high."""
    height = pick(rng, wish.height_m, (0.85, 1.15))
    radius = pick(rng, wish.radius_m, (0.05, 0.10))
    tile, shade = [("concrete", 0.9), ("metal", 0.3), ("paint", 1.6)][int(rng.integers(0, 3))]
    parts = [_rod(radius, height, tile, shade, lean_slope(rng, radians(2)), 0.92)]
    if shade > 1:
        band = cylinder(
            (0, 0, 0.6), (0, 0, 0.75), radius + 0.004, radius + 0.004, TILES["paint"], 0.3
        )
        parts.append(band)
    return Standing(join(parts), True, 2 * radius, height)


def thin_post(rng: np.random.Generator, wish: Wish) -> Standing:
    """A bare post of about 6 cm: a marker, a gas sign, a forgotten stake."""
    height = pick(rng, wish.height_m, (1.3, 2.2))
    radius = pick(rng, wish.radius_m, (0.028, 0.034))
    tile, shade = [("metal", 1.0), ("planks", 0.9), ("paint", 1.5)][int(rng.integers(0, 3))]
    parts = [
        _rod(radius, height, tile, shade, lean_slope(rng, max(wish.lean_rad, radians(3))), sides=10)
    ]
    if rng.uniform() < 0.4:
        parts.append(box((0, 0, height), (0.18, 0.03, 0.14), TILES["sign"]))
    return Standing(join(parts), True, 2 * radius, height)


def fence(rng: np.random.Generator, wish: Wish) -> Standing:
    """Eight metres of fence: boards, pickets or bars between posts."""
    height = float(rng.uniform(0.9, 1.5))
    style = int(rng.integers(0, 3))
    posts = (-4.0, -2.0, 0.0, 2.0)
    parts = [box((x, 0, height / 2), (0.08, 0.08, height), TILES["planks"], 0.8) for x in posts]
    if style == 0:
        parts.append(
            panel((-4, 0, 0.08), (8, 0, 0), (0, 0, height - 0.12), TILES["planks"], 0.9, 1.0)
        )
    else:
        pitch, width = (0.14, 0.075) if style == 1 else (0.125, 0.022)
        tile, shade = ("planks", 1.3) if style == 1 else ("metal", 0.3)
        up = (0.0, 0.0, height - 0.1)
        parts += [
            panel((float(x), 0.05, 0.06), (width, 0, 0), up, TILES[tile], shade, 1.0)
            for x in np.arange(-3.95, 4.0, pitch)
        ]
        parts += [
            box((0, 0.03, z), (8, 0.03, 0.06), TILES[tile], shade) for z in (0.25, height - 0.2)
        ]
    return Standing(join(parts), False, 8.0, height)


def advertising_column(rng: np.random.Generator, wish: Wish) -> Standing:
    """A round column pasted with posters: upright, but far too thick for a pole."""
    column = cylinder((0, 0, 0), (0, 0, 2.9), 0.62, 0.62, TILES["poster"], 1.0, 0.35, 28)
    roof = cylinder((0, 0, 2.9), (0, 0, 3.2), 0.75, 0.55, TILES["metal"], 0.4, 1.0, 28)
    return Standing(join([column, roof]), False, 1.24, 3.2)


def cabinet(rng: np.random.Generator, wish: Wish) -> Standing:
    """A grey switch cabinet."""
    w, h = float(rng.uniform(0.5, 1.2)), float(rng.uniform(0.9, 1.4))
    return Standing(box((0, 0, h / 2), (w, 0.35, h), TILES["concrete"], 0.9), False, w, h)


def waste_bin(rng: np.random.Generator, wish: Wish) -> Standing:
    """A wheeled bin or two by the kerb."""
    parts = []
    for k in range(int(rng.integers(1, 3))):
        shade = float(rng.choice([0.15, 0.3, 0.7]))
        parts.append(
            box((0.65 * k, 0, 0.52), (0.50, 0.55, 1.04), TILES["paint"], shade, taper=(1.1, 1.1))
        )
        parts.append(box((0.65 * k, 0, 1.08), (0.58, 0.63, 0.07), TILES["paint"], shade * 1.3))
    return Standing(join(parts), False, 0.55, 1.1)


def standing_pedestrian(rng: np.random.Generator, wish: Wish) -> Standing:
    """Someone who waits: of a trunk's width and a bollard's manners, but gone in the next lap."""
    return Standing(person(rng), False, 0.45, 1.75)


def person(rng: np.random.Generator, stride_m: float = 0.0) -> Mesh:
    """A person facing +x, legs `stride_m` apart."""
    height = float(rng.uniform(1.58, 1.9))
    legs, coat = (float(v) for v in rng.choice([0.2, 0.35, 0.8, 1.4, 2.0], 2))
    hip = 0.48 * height
    parts = []
    for side, ahead in ((0.09, stride_m / 2), (-0.09, -stride_m / 2)):
        parts.append(
            cylinder((ahead, side, 0), (0, side, hip), 0.065, 0.09, TILES["cloth"], legs, 1.5, 10)
        )
        parts.append(
            cylinder(
                (-ahead * 0.6, side * 2.6, hip),
                (0, side * 2.3, 0.82 * height),
                0.045,
                0.06,
                TILES["cloth"],
                coat,
                1.5,
                8,
            )
        )
    parts.append(
        box(
            (0, 0, 0.655 * height),
            (0.24, 0.40, 0.36 * height),
            TILES["cloth"],
            coat,
            1.5,
            (0.8, 0.9),
        )
    )
    parts.append(
        cylinder((0, 0, 0.86 * height), (0, 0, height), 0.085, 0.075, TILES["cloth"], 1.6, 2, 10)
    )
    return join(parts)


MAKERS: dict[str, Maker] = {
    "lamp": lamp,
    "sign": sign,
    "traffic_light": traffic_light,
    "bollard": bollard,
    "thin_post": thin_post,
    "fence": fence,
    "advertising_column": advertising_column,
    "cabinet": cabinet,
    "bin": waste_bin,
    "standing_pedestrian": standing_pedestrian,
}
