"""What bounds gardens along a street: walls, gateways between piers, garages; with their corners.

As of `objects`: x along the road, +y towards it, base at z = 0.
"""

from __future__ import annotations

import numpy as np

from polemap.simulate.materials import TILES
from polemap.simulate.mesh import box, join
from polemap.simulate.objects import Corner, Maker, Standing, Wish, box_corners, pick

_BELOW_M = 0.1  # stands so deep in the ground, which is not level


def _surface(rng: np.random.Generator) -> tuple[int, float]:
    """Tile and shade of masonry."""
    tile = str(rng.choice(["brick", "plaster", "concrete", "brick"]))
    return TILES[tile], float(rng.uniform(0.6, 1.2))


def wall(rng: np.random.Generator, wish: Wish) -> Standing:
    """A stretch of garden wall with a coping and free ends."""
    height = pick(rng, wish.height_m, (0.9, 2.1))
    length, thick = float(rng.uniform(2.5, 6.5)), float(rng.uniform(0.2, 0.35))
    tile, shade = _surface(rng)
    tall = height + _BELOW_M
    parts = [
        box((0, 0, height - tall / 2), (length, thick, tall), tile, shade, 0.5),
        box((0, 0, height + 0.03), (length + 0.06, thick + 0.08, 0.06), TILES["concrete"], shade),
    ]
    return Standing(join(parts), False, length, height, box_corners(length, thick, height))


def gateway(rng: np.random.Generator, wish: Wish) -> Standing:
    """Two piers beside a drive, each with a lower wall that goes on from it."""
    height = pick(rng, wish.height_m, (1.3, 2.2))
    opening, pier = float(rng.uniform(2.6, 3.8)), float(rng.uniform(0.35, 0.55))
    wing, thick = float(rng.uniform(1.5, 3.5)), float(rng.uniform(0.2, 0.28))
    low = height * float(rng.uniform(0.55, 0.9))
    tile, shade = _surface(rng)
    parts, corners = [], list[Corner]()
    for side in (-1.0, 1.0):
        x = side * (opening + pier) / 2
        beyond = x + side * (pier + wing) / 2
        tall, long = height + _BELOW_M, low + _BELOW_M
        parts += [
            box((x, 0, height - tall / 2), (pier, pier, tall), tile, shade, 0.7),
            box((x, 0, height + 0.04), (pier + 0.1, pier + 0.1, 0.08), TILES["concrete"], shade),
            box((beyond, 0, low - long / 2), (wing, thick, long), tile, shade, 0.5),
        ]
        ends = [*box_corners(pier, pier, height, x), *box_corners(wing, thick, low, beyond)]
        # the other two corners of pier and wall are one within the other
        corners += [corner for corner in ends[:4] if (corner.x_m - x) * side < 0]
        corners += [corner for corner in ends[4:] if (corner.x_m - beyond) * side > 0]
    width = opening + 2 * (pier + wing)
    return Standing(join(parts), False, width, height, tuple(corners))


def garage(rng: np.random.Generator, wish: Wish) -> Standing:
    """A garage with its door to the street."""
    height = pick(rng, wish.height_m, (2.3, 2.9))
    width, depth = float(rng.uniform(2.8, 3.6)), float(rng.uniform(4.5, 6.0))
    tile, shade = _surface(rng)
    tall = height + _BELOW_M
    parts = [
        box((0, 0, height - tall / 2), (width, depth, tall), tile, shade, 0.4),
        box((0, depth / 2, 1.0), (width - 0.5, 0.04, 2.0), TILES["planks"], 0.8, 1.5),
        box((0, 0, height + 0.06), (width + 0.2, depth + 0.2, 0.12), TILES["concrete"], 0.5),
    ]
    return Standing(join(parts), False, width, height, box_corners(width, depth, height))


WALLS: dict[str, Maker] = {"wall": wall, "gateway": gateway, "garage": garage}
