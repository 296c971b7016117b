"""Poles strewn about at random, what a car sees of them, and the same street twice."""

from __future__ import annotations

import numpy as np

from polemap.map.pole_map import PoleMap
from tests.pole_maps import plain_map


def street(rng: np.random.Generator, count: int = 250, extent_m: float = 250.0) -> PoleMap:
    return plain_map(rng.uniform(-extent_m, extent_m, (count, 2)))


def twice(world: PoleMap) -> PoleMap:
    """The same poles once more, 400 m east."""
    return plain_map(np.vstack([world.points_m, world.points_m + np.array([400.0, 0.0])]))


def seen_from(world: PoleMap, pose: np.ndarray, reach_m: float) -> np.ndarray:
    c, s = np.cos(pose[2]), np.sin(pose[2])
    local = (world.points_m - pose[:2]) @ np.array([[c, -s], [s, c]])
    return local[np.hypot(*local.T) < reach_m]
