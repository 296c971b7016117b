"""A town of streets in a grid: lamps and trees on both sides, and a route through all of them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from polemap.simulate.points.poles import Poles

Floats = NDArray[np.float64]

BLOCK_M = 120.0
_SPACING_M = 24.0
_TWINS = 0.05  # share of poles with a close neighbour
_LEAST_GAP_M = 1.3


def town_poles(origin_m: Floats, blocks: int, rng: np.random.Generator) -> Poles:
    """Poles along the streets of a grid of `blocks` by `blocks`; they differ in how visible they
    are, and every twentieth has a close neighbour.

    Args:
        origin_m: `(2,)` south-west corner.
        blocks: along each side.
        rng: all randomness.
    """
    points = []
    length = blocks * BLOCK_M
    for street in range(blocks + 1):
        for side in (-6.0, 6.0):
            along = np.arange(0.5 * _SPACING_M, length - 8.0, _SPACING_M)
            along = along + rng.uniform(-6.0, 6.0, len(along))
            across = street * BLOCK_M + side + rng.uniform(-1.5, 1.5, len(along))
            points += [np.stack([along, across], 1), np.stack([across, along], 1)]
    every = np.concatenate(points)
    twins = every[rng.random(len(every)) < _TWINS]
    angle = rng.uniform(0, 2 * np.pi, len(twins))
    twins = twins + 1.6 * np.stack([np.cos(angle), np.sin(angle)], 1)
    every = _thinned(np.concatenate([every, twins]), _LEAST_GAP_M)
    n = len(every)
    return Poles(every + origin_m, rng.uniform(0.08, 0.5, n), rng.beta(6.0, 2.0, n))


def _thinned(points: Floats, least_m: float) -> Floats:
    kept: list[Floats] = []
    for point in points:
        if all(np.hypot(*(point - other)) >= least_m for other in kept):
            kept.append(point)
    return np.array(kept)


def town_route(origin_m: Floats, blocks: int, step_m: float = 1.0) -> Floats:
    """Poses `(n, 3)` through every street of the grid, there and back, every `step_m`."""
    length = blocks * BLOCK_M
    corners: list[tuple[float, float]] = []
    for k in range(blocks + 1):
        ends = [(0.0, k * BLOCK_M), (length, k * BLOCK_M)]
        corners += ends if k % 2 == 0 else ends[::-1]
    for k in range(blocks, -1, -1):
        ends = [(k * BLOCK_M, 0.0), (k * BLOCK_M, length)]
        corners += ends[::-1] if (blocks - k) % 2 == 0 else ends
    corners += corners[::-1]
    path = np.array(corners)
    path = path[np.concatenate([[True], np.linalg.norm(np.diff(path, axis=0), axis=1) > 1.0])]
    station = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))])
    s = np.arange(0.0, station[-1], step_m)
    xy = np.stack([np.interp(s, station, path[:, axis]) for axis in (0, 1)], axis=1)
    # corners are rounded over ten steps, so that a car can take them
    kernel = np.ones(11) / 11.0
    padded = np.pad(xy, ((5, 5), (0, 0)), mode="edge")
    xy = np.stack([np.convolve(padded[:, axis], kernel, mode="valid") for axis in (0, 1)], axis=1)
    heading = np.gradient(xy, axis=0)
    return np.column_stack([xy + origin_m, np.arctan2(heading[:, 1], heading[:, 0])])
