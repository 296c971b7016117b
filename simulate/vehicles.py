"""Cars, vans, cyclists: bodies that are parked at the kerb or move along the street."""

from __future__ import annotations

import numpy as np

from polemap.simulate.materials import TILES
from polemap.simulate.mesh import Mesh, box, cylinder, join, panel, quads
from polemap.simulate.objects import Maker, Standing, Wish, person

# side views: (x forward, z) of the lower body and of the cabin, as shares of length and height
_CAR = ((-0.5, 0.18), (-0.5, 0.56), (0.47, 0.56), (0.5, 0.40), (0.5, 0.16))
_CABINS = {
    "car": ((-0.47, 0.55), (-0.36, 0.97), (-0.02, 1.0), (0.18, 0.58)),
    "estate": ((-0.49, 0.55), (-0.44, 0.97), (0.00, 1.0), (0.20, 0.58)),
    "van": ((-0.50, 0.40), (-0.49, 0.98), (0.28, 1.0), (0.43, 0.45)),
}
_SIZES = {"car": (4.2, 1.75, 1.46), "estate": (4.6, 1.80, 1.52), "van": (5.2, 1.95, 2.25)}


def car(rng: np.random.Generator, kind: str | None = None) -> Mesh:
    """A car heading +x, standing on z = 0, its middle at the origin."""
    kind = kind or str(rng.choice(["car", "car", "estate", "van"]))
    length, width, height = _SIZES[kind]
    length *= rng.uniform(0.93, 1.07)
    shade = float(rng.choice([0.10, 0.16, 0.35, 0.7, 1.1, 1.5]))
    lower = np.array(_CAR) * (length, height)
    cabin = np.array(_CABINS[kind]) * (length, height)
    parts = [_prism(lower, width, "enamel", shade), _prism(cabin, width * 0.86, "enamel", shade)]
    half = width * 0.43 + 0.006
    glass = cabin.mean(axis=0) + (cabin - cabin.mean(axis=0)) * 0.82
    for side in (half, -half):
        corners = np.insert(glass, 1, side, axis=1)[None]
        parts.append(
            quads(corners, glass[None] * 0.3 + rng.uniform(0, 1, 2), TILES["glass"], 0.9, 0.3)
        )
        pillar = (cabin[1, 0] + cabin[2, 0]) / 2 + 0.05
        parts.append(
            box(
                (pillar, side, 0.75 * height),
                (0.09, 0.012, 0.42 * height),
                TILES["paint"],
                shade * 0.6,
            )
        )
    for a, b in ((0, 1), (3, 2)):
        low, high = np.insert(cabin[a], 1, 0.0), np.insert(cabin[b], 1, 0.0)
        out = np.array([-0.01 if a == 0 else 0.01, 0, 0.01])
        wide = np.array([0, width * 0.37, 0])
        span = high - low
        corners = (
            np.stack(
                [
                    low + 0.1 * span - wide,
                    low + 0.1 * span + wide,
                    low + 0.88 * span + wide,
                    low + 0.88 * span - wide,
                ]
            )[None]
            + out
        )
        uv = np.array([[[0, 0.3], [0.4, 0.3], [0.4, 0], [0, 0]]]) + rng.uniform(0, 1, 2)
        parts.append(quads(corners, uv, TILES["glass"], 1.1, 0.3))
    for x in (-0.31 * length, 0.31 * length):
        for side in (1, -1):
            y = side * (width / 2 - 0.10)
            parts.append(
                cylinder(
                    (x, y - side * 0.1, 0.31),
                    (x, y + side * 0.105, 0.31),
                    0.31,
                    0.31,
                    TILES["cloth"],
                    0.2,
                    1.0,
                    18,
                )
            )
            parts.append(
                cylinder(
                    (x, y, 0.31),
                    (x, y + side * 0.112, 0.31),
                    0.19,
                    0.19,
                    TILES["metal"],
                    1.0,
                    3,
                    12,
                )
            )
    for x in (-0.5 * length - 0.01, 0.5 * length + 0.01):
        plate = 0.26 if x > 0 else -0.26
        parts.append(panel((x, -plate, 0.45), (0, 2 * plate, 0), (0, 0, 0.12), TILES["sign"], 1.0))
        for side in (-1, 1):
            light = 1.7 if x > 0 else 0.5
            y = side * width * 0.38
            parts.append(box((x, y, 0.43 * height), (0.03, 0.28, 0.14), TILES["paint"], light))
    shadow = box((0, 0, 0.02), (length * 0.97, width * 0.92, 0.02), TILES["paint"], 0.05)
    return join([*parts, shadow])


def _prism(outline: np.ndarray, width: float, tile: str, albedo: float) -> Mesh:
    """An outline in x and z, drawn out to `width` in y; the shoulders are pulled in a little."""
    n = len(outline)
    pull = 1.0 - 0.10 * (outline[:, 1] - outline[:, 1].min()) / max(np.ptp(outline[:, 1]), 1e-6)
    left = np.stack([outline[:, 0], width / 2 * pull, outline[:, 1]], axis=1)
    right = left * (1, -1, 1)
    corners = [
        np.stack([left[i], left[(i + 1) % n], right[(i + 1) % n], right[i]]) for i in range(n)
    ]
    middle = outline.mean(axis=0)
    for side, sign in ((left, 1.0), (right, -1.0)):
        hub = np.array([middle[0], sign * width / 2 * 0.97, middle[1]])
        corners += [
            np.stack([hub, side[i], side[(i + 1) % n], side[(i + 1) % n]]) for i in range(n)
        ]
    stack = np.array(corners)
    return quads(
        stack, stack[..., [0, 2]] * 0.4 + stack[..., [1, 1]] * 0.2, TILES[tile], albedo, 0.4
    )


def cyclist(rng: np.random.Generator) -> Mesh:
    """A rider heading +x on a bicycle with thin wheels."""
    rider = person(rng, 0.25).placed(0.0, 0.0, 0.30, 0.0, 0.92)
    parts = [rider]
    for x in (-0.52, 0.52):
        for a in np.linspace(0, 2 * np.pi, 17)[:-1]:
            b = a + 2 * np.pi / 16
            parts.append(
                cylinder(
                    (x + 0.33 * np.cos(a), 0, 0.34 + 0.33 * np.sin(a)),
                    (x + 0.33 * np.cos(b), 0, 0.34 + 0.33 * np.sin(b)),
                    0.018,
                    0.018,
                    TILES["cloth"],
                    0.2,
                    1.0,
                    5,
                    False,
                )
            )
    frame = [
        ((-0.52, 0, 0.34), (-0.1, 0, 0.85)),
        ((-0.1, 0, 0.35), (-0.1, 0, 0.95)),
        ((-0.1, 0, 0.35), (0.42, 0, 0.9)),
        ((0.52, 0, 0.34), (0.42, 0, 1.05)),
    ]
    for low, high in frame:
        parts.append(cylinder(low, high, 0.02, 0.02, TILES["paint"], 0.5, 1.0, 6, False))
    return join(parts)


def parked_car(rng: np.random.Generator, wish: Wish) -> Standing:
    """A car or van at the kerb, heading either way."""
    turn = 0.0 if rng.uniform() < 0.8 else np.pi
    mesh = car(rng).placed(0, 0, 0, turn + float(rng.normal(0, 0.02)))
    return Standing(mesh, False, 1.8, 1.6)


def parked_van(rng: np.random.Generator, wish: Wish) -> Standing:
    """A van at the kerb: tall upright edges."""
    return Standing(car(rng, "van").placed(0, 0, 0, float(rng.normal(0, 0.02))), False, 1.95, 2.25)


def parked_bicycle(rng: np.random.Generator, wish: Wish) -> Standing:
    """A bicycle leaning at a stand, riderless."""
    mesh = cyclist(rng)
    keep = slice(len(person(np.random.default_rng(0), 0.25)), None)
    vertices = mesh.vertices_m[mesh.triangles[keep].ravel()]
    corners = np.arange(len(vertices), dtype=np.uint32).reshape(-1, 3)
    bare = Mesh(vertices, corners, mesh.surface[keep], mesh.tile[keep], mesh.owner[keep])
    return Standing(bare, False, 1.6, 1.0)


PARKED: dict[str, Maker] = {
    "parked_car": parked_car,
    "parked_van": parked_van,
    "parked_bicycle": parked_bicycle,
}
