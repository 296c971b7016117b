"""Albedo of surfaces, a tile each, with the contrast of real ones.

Vegetation is drawn by the dead-leaves model (opaque discs falling on each other), which has the
edge statistics of natural images; mineral surfaces are filtered noise with cracks and joints.
"""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np

from polemap.simulate.patterns import TILE_PX, Texture, dead_leaves, fractal, stones


def _asphalt(rng: np.random.Generator) -> Texture:
    grain = 1 + 0.10 * fractal(rng, 0.15) + 0.06 * fractal(rng, 1.0)
    cracks = np.abs(fractal(rng, 1.6)) < 0.012
    grain[cracks] *= 0.6
    return 0.26 * grain


def _worn_asphalt(rng: np.random.Generator) -> Texture:
    grain = 1 + 0.13 * fractal(rng, 0.2) + 0.09 * fractal(rng, 1.2)
    cracks = np.abs(fractal(rng, 1.5)) < 0.03
    grain[cracks] *= 0.5
    return 0.33 * grain


def _birch(rng: np.random.Generator) -> Texture:
    image = 0.62 * (1 + 0.08 * fractal(rng, 1.0))
    image[fractal(rng, 1.0, 4.0) > 1.35] *= 0.3
    return image


def _planks(rng: np.random.Generator) -> Texture:
    shade = (1 + 0.14 * rng.standard_normal(8)).repeat(TILE_PX // 8).astype(np.float32)
    image = 0.36 * shade[None, :] * (1 + 0.16 * fractal(rng, 1.0, 0.12))
    image[:, np.arange(TILE_PX) % (TILE_PX // 8) < 5] *= 0.3
    return np.asarray(image, dtype=np.float32)


def _glass(rng: np.random.Generator) -> Texture:
    return 0.10 * (1 + 0.35 * fractal(rng, 2.2))


def _sign(rng: np.random.Generator) -> Texture:
    image = np.full((TILE_PX, TILE_PX), 0.82, dtype=np.float32)
    half = TILE_PX // 2
    cv2.circle(image, (half, half), half - 20, 0.28, 60)
    for _ in range(4):
        corner = rng.integers(half - 120, half + 60, 2)
        size = rng.integers(30, 110, 2)
        cv2.rectangle(image, corner.tolist(), (corner + size).tolist(), 0.12, -1)
    return image * (1 + 0.02 * fractal(rng, 1.0))


def _poster(rng: np.random.Generator) -> Texture:
    """Posters side by side: what advertising columns and shop windows show."""
    image = np.full((TILE_PX, TILE_PX), 0.4, dtype=np.float32)
    for i in range(4):
        for j in range(3):
            x, y = i * TILE_PX // 4, j * TILE_PX // 3
            ground = float(rng.uniform(0.2, 0.8))
            cv2.rectangle(image, (x + 6, y + 6), (x + 120, y + 160), ground, -1)
            for _ in range(6):
                a = rng.integers(0, 90, 2) + np.array([x + 10, y + 10])
                b = a + rng.integers(8, 50, 2)
                cv2.rectangle(image, a.tolist(), b.tolist(), float(rng.uniform(0.05, 0.9)), -1)
    return image


def _window(rng: np.random.Generator) -> Texture:
    """A window with frame, sash bars and curtains; its uprights look like thin poles."""
    image = _glass(rng) * 1.2
    third = TILE_PX // 3
    image[: TILE_PX // 2, third : 2 * third] = 0.16
    image[:, : TILE_PX // 5] = 0.34
    for x in (0, TILE_PX // 2 - 18, TILE_PX - 37):
        image[:, x : x + 37] = 0.78
    for y in (0, TILE_PX // 3, TILE_PX - 37):
        image[y : y + 37] = 0.78
    return np.asarray(image, dtype=np.float32)


# every material draws its tile from a generator
MAKERS: dict[str, Callable[[np.random.Generator], Texture]] = {
    # stains, wear and patches that no two places share; multiplied over everything
    "macro": lambda rng: np.asarray(np.clip(0.5 * (1 + 0.12 * fractal(rng, 1.1)), 0.3, 0.75)),
    "asphalt": _asphalt,
    "worn_asphalt": _worn_asphalt,
    "cobble": lambda rng: 0.34 * stones(12, 12, 5, rng, 0.18) * (1 + 0.12 * fractal(rng, 0.6)),
    "slabs": lambda rng: (
        0.42
        * stones(6, 6, 3, rng, 0.07)
        * (1 + 0.10 * fractal(rng, 0.5) + 0.08 * fractal(rng, 1.3))
    ),
    "grass": lambda rng: (
        0.27 * dead_leaves(rng, 9000, (2, 9), 0.38) * (1 + 0.15 * fractal(rng, 1.4))
    ),
    "gravel": lambda rng: (
        0.36 * dead_leaves(rng, 9000, (2, 12), 0.25) * (1 + 0.10 * fractal(rng, 1.2))
    ),
    "leaves": lambda rng: 0.26 * dead_leaves(rng, 5000, (4, 26), 0.75),
    "foliage": lambda rng: (
        0.20 * dead_leaves(rng, 6500, (3, 40), 0.8) * (1 + 0.3 * fractal(rng, 1.8))
    ),
    "bark": lambda rng: 0.20 * (1 + 0.30 * fractal(rng, 1.0, 0.2) + 0.16 * fractal(rng, 0.5)),
    "birch": _birch,
    "plaster": lambda rng: 0.62 * (1 + 0.035 * fractal(rng, 0.4) + 0.05 * fractal(rng, 1.6)),
    "brick": lambda rng: 0.30 * stones(8, 24, 3, rng, 0.16) * (1 + 0.10 * fractal(rng, 0.8)),
    "planks": _planks,
    "concrete": lambda rng: 0.45 * (1 + 0.08 * fractal(rng, 0.7) + 0.09 * fractal(rng, 1.6)),
    "paint": lambda rng: 0.50 * (1 + 0.02 * fractal(rng, 0.3) + 0.05 * fractal(rng, 1.8)),
    # car paint: hardly any texture of its own; it lives from what it mirrors
    "enamel": lambda rng: 0.50 * (1 + 0.012 * fractal(rng, 0.3) + 0.03 * fractal(rng, 2.0)),
    "metal": lambda rng: 0.40 * (1 + 0.05 * fractal(rng, 0.6) + 0.10 * fractal(rng, 1.4, 0.3)),
    "glass": _glass,
    "marking": lambda rng: (
        np.where(fractal(rng, 0.9) > 1.3, 0.38, 0.80).astype(np.float32)
        * (1 + 0.06 * fractal(rng, 0.3))
    ),
    "roof": lambda rng: 0.24 * stones(10, 14, 4, rng, 0.14) * (1 + 0.12 * fractal(rng, 1.0)),
    "sign": _sign,
    "poster": _poster,
    "window": _window,
    "cloth": lambda rng: 0.30 * (1 + 0.12 * fractal(rng, 1.5, 0.4) + 0.04 * fractal(rng, 0.3)),
}
TILES: dict[str, int] = {name: index for index, name in enumerate(MAKERS)}
