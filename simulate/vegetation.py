"""Trees, bushes and hedges: trunks that count as poles under crowns of loose leaves."""

from __future__ import annotations

from math import cos, sin

import numpy as np

from polemap.simulate.materials import TILES
from polemap.simulate.mesh import Mesh, box, cards, cylinder, join
from polemap.simulate.objects import Maker, Standing, Wish, lean_slope, pick


def _crown(
    rng: np.random.Generator, centre: tuple[float, float, float], radius_m: float, leaves: int
) -> Mesh:
    """Leaves in the shells of several clumps, as a crown seen from below."""
    clumps = int(rng.integers(6, 11))
    middle = rng.normal(0, 0.45, (clumps, 3)) * radius_m * (1, 1, 0.75) + centre
    size = rng.uniform(0.35, 0.62, clumps) * radius_m
    which = rng.integers(0, clumps, leaves)
    direction = rng.normal(size=(leaves, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    depth = rng.uniform(0.5, 1.0, (leaves, 1)) ** 0.5
    centres = middle[which] + direction * depth * size[which][:, None]
    return cards(centres, 0.04 * radius_m + 0.12, TILES["leaves"], 1.0, 1.6, rng)


def tree(rng: np.random.Generator, wish: Wish) -> Standing:
    """A street tree: leaning, tapered trunk, some branches, a crown of loose leaves."""
    radius = pick(rng, wish.radius_m, (0.07, 0.19))
    bare = pick(rng, wish.height_m, (2.0, 3.0))
    slope = lean_slope(rng, wish.lean_rad)
    tile = "birch" if rng.uniform() < 0.2 else "bark"
    shade = float(rng.uniform(0.7, 1.5))
    top = (slope[0] * bare, slope[1] * bare, bare)
    parts = [cylinder((0, 0, -0.1), top, radius, radius * 0.8, TILES[tile], shade, 1.4, 16, False)]
    parts.append(
        cylinder((0, 0, -0.1), (0, 0, 0.25), radius * 1.35, radius, TILES[tile], shade, 1.4, 16)
    )
    spread = float(rng.uniform(1.3, 2.4))
    for k in range(int(rng.integers(4, 7))):
        turn = k * 2.4 + rng.uniform(-0.5, 0.5)
        out = spread * rng.uniform(0.5, 0.9)
        tip = (top[0] + out * cos(turn), top[1] + out * sin(turn), bare + rng.uniform(0.8, 2.2))
        thick = radius * rng.uniform(0.35, 0.55)
        parts.append(cylinder(top, tip, thick, 0.02, TILES[tile], shade, 1.4, 8, False))
    crown = (top[0], top[1], bare + 0.85 * spread + 0.3)
    parts.append(_crown(rng, crown, spread, int(650 * spread**2 + 700)))
    return Standing(join(parts), True, 2 * radius, bare + 2 * spread)


def young_tree(rng: np.random.Generator, wish: Wish) -> Standing:
    """A sapling held by a stake; both are thin."""
    thin = Wish(wish.lean_rad, wish.height_m or (1.8, 2.4), wish.radius_m or (0.03, 0.05))
    sapling = tree(rng, thin)
    stake = cylinder((0.25, 0, 0), (0.22, 0, 1.6), 0.03, 0.03, TILES["planks"], 1.1, sides=8)
    return Standing(join([sapling.mesh, stake]), True, sapling.width_m, sapling.height_m)


def park_tree(rng: np.random.Generator, wish: Wish) -> Standing:
    """A large tree further from the road, with a wide crown."""
    big = Wish(wish.lean_rad, wish.height_m or (2.6, 3.6), wish.radius_m or (0.16, 0.30))
    base = tree(rng, big)
    more = _crown(rng, (0, 0, 5.6), float(rng.uniform(2.6, 3.6)), 5000)
    return Standing(join([base.mesh, more]), True, base.width_m, 9.0)


def bush(rng: np.random.Generator, wish: Wish) -> Standing:
    """A bush: leaves down to the ground."""
    size = float(rng.uniform(0.6, 1.3))
    leaves = int(1500 * size**2)
    direction = rng.normal(size=(leaves, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    direction[:, 2] = np.abs(direction[:, 2])
    shell = direction * rng.uniform(0.6, 1.0, (leaves, 1)) * (size, size, 1.1 * size)
    inner = cylinder(
        (0, 0, 0), (0, 0, 0.8 * size), 0.75 * size, 0.4 * size, TILES["foliage"], 0.7, 0.5
    )
    leaf = cards(shell, 0.15, TILES["leaves"], 1.0, 1.3, rng)
    return Standing(join([inner, leaf]), False, 2 * size, 1.1 * size)


def hedge(rng: np.random.Generator, wish: Wish) -> Standing:
    """Eight metres of clipped hedge."""
    height = float(rng.uniform(1.0, 1.7))
    core = box((0, 0, height / 2), (8.0, 0.55, height), TILES["leaves"], 0.85, 1.0)
    n = 1800
    face = np.stack(
        [rng.uniform(-4, 4, n), rng.choice([-0.3, 0.3], n), rng.uniform(0, height, n)], axis=1
    )
    top = np.stack([rng.uniform(-4, 4, 200), rng.uniform(-0.3, 0.3, 200), np.full(200, height)], 1)
    leaf = cards(np.concatenate([face, top]), 0.10, TILES["leaves"], 1.1, 1.5, rng)
    return Standing(join([core, leaf]), False, 8.0, height)


PLANTS: dict[str, Maker] = {
    "tree": tree,
    "young_tree": young_tree,
    "park_tree": park_tree,
    "bush": bush,
    "hedge": hedge,
}
