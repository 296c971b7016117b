"""A winding road for path following: a smooth path and the poles beside it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from polemap.electric.control.path import Path
from polemap.map.pole_map import PoleMap
from polemap.simulate.points.drive import FRAME
from polemap.simulate.points.poles import Poles, roadside_poles

Floats = NDArray[np.float64]
_STEP_M = 0.5
# shorter bends than this are no road's at these speeds
_WAVES_M = (70.0, 110.0, 180.0, 300.0)


@dataclass(frozen=True, slots=True)
class Road:
    """A path to follow, the map of its poles, and where they really stand."""

    path: Path
    pole_map: PoleMap
    poles: Poles
    start: Floats


def winding_road(
    length_m: float,
    curvature_max_radpm: float,
    rng: np.random.Generator,
    *,
    pole_spacing_m: float = 5.0,
    map_sd_m: float = 0.05,
) -> Road:
    """A road whose curvature is a sum of sines, straight over its first 30 m.

    Args:
        length_m: of the road.
        curvature_max_radpm: of its sharpest bend.
        rng: all randomness.
        pole_spacing_m: mean way from one pole to the next, on both sides together.
        map_sd_m: of the map's positions, in each axis.
    """
    station = np.arange(0.0, length_m, _STEP_M)
    curvature = sum(
        np.sin(2.0 * np.pi * station / wave + rng.uniform(0.0, 2.0 * np.pi)) for wave in _WAVES_M
    )
    curvature = np.asarray(curvature) * curvature_max_radpm / np.abs(curvature).max()
    curvature *= np.clip((station - 30.0) / 40.0, 0.0, 1.0)
    yaw = rng.uniform(-np.pi, np.pi) + np.concatenate(
        [[0.0], np.cumsum(0.5 * (curvature[1:] + curvature[:-1]) * _STEP_M)]
    )
    middle = 0.5 * (yaw[1:] + yaw[:-1])
    steps = _STEP_M * np.stack([np.cos(middle), np.sin(middle)], axis=1)
    points = np.vstack([np.zeros((1, 2)), np.cumsum(steps, axis=0)])
    poses = np.column_stack([points, yaw])
    poles = roadside_poles(poses, pole_spacing_m, rng)
    return Road(Path(points), poles.surveyed(FRAME, map_sd_m, rng), poles, poses[0])
