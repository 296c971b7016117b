"""Textures: an atlas gives back its tiles, wraps, and keeps their mean at every level."""

from __future__ import annotations

import numpy as np
import pytest

from polemap.simulate.materials import TILES
from polemap.simulate.patterns import TILE_PX, dead_leaves, fractal
from polemap.simulate.textures import LEVELS, Atlas, make_atlas


@pytest.fixture(scope="module")
def atlas() -> Atlas:
    return make_atlas(3)


def grid(count: int) -> np.ndarray:
    ticks = (np.arange(count) + 0.5) / count
    u, v = np.meshgrid(ticks, ticks)
    return np.stack([u.ravel(), v.ravel()], axis=1).astype(np.float32)


@pytest.mark.parametrize("name", sorted(TILES))
def test_every_level_keeps_the_mean(atlas: Atlas, name: str) -> None:
    means = [
        atlas.sample_one(TILES[name], grid(TILE_PX >> level), level).mean()
        for level in range(LEVELS)
    ]
    assert np.allclose(means, means[0], rtol=0.02)


def test_the_footprint_chooses_the_level(atlas: Atlas) -> None:
    places = grid(64)
    tile = np.full(len(places), TILES["foliage"], np.uint8)
    for level in range(LEVELS):
        width = np.full(len(places), 2.0**level / TILE_PX, np.float32)
        expected = atlas.sample_one(TILES["foliage"], places, level)
        assert np.array_equal(atlas.sample(tile, places, width), expected)
    # beyond the last level, and below the first, the nearest one serves
    for width, level in ((1e-6, 0), (1e3, LEVELS - 1)):
        found = atlas.sample(tile, places, np.full(len(places), width, np.float32))
        assert np.array_equal(found, atlas.sample_one(TILES["foliage"], places, level))


def test_textures_repeat_without_a_seam(atlas: Atlas) -> None:
    places = grid(32)
    once = atlas.sample_one(TILES["asphalt"], places)
    assert np.allclose(once, atlas.sample_one(TILES["asphalt"], places + 7), atol=2e-3)
    edge = np.stack([np.array([1e-4, 1 - 1e-4]), np.full(2, 0.3)], axis=1).astype(np.float32)
    left, right = atlas.sample_one(TILES["asphalt"], edge)
    assert left == pytest.approx(right, abs=0.02)


def test_fractal_noise_is_normalised_and_smoother_with_the_exponent() -> None:
    roughness = []
    for exponent in (0.2, 1.0, 2.0):
        noise = fractal(np.random.default_rng(1), exponent)
        assert noise.mean() == pytest.approx(0, abs=1e-5)
        assert noise.std() == pytest.approx(1, rel=1e-4)
        roughness.append(float(np.abs(np.diff(noise, axis=1)).mean()))
    assert roughness == sorted(roughness, reverse=True)


def test_dead_leaves_have_edges_and_flat_parts() -> None:
    image = dead_leaves(np.random.default_rng(2), 3000, (4, 30), 0.5)
    step = np.abs(np.diff(image, axis=1))
    assert image.mean() == pytest.approx(1, rel=1e-5)
    assert np.median(step) == 0.0
    assert np.percentile(step, 97) > 0.2


def test_the_seed_decides_every_texel() -> None:
    same, other = make_atlas(3), make_atlas(4)
    assert np.array_equal(same.pixels, make_atlas(3).pixels)
    assert not np.array_equal(same.pixels, other.pixels)
