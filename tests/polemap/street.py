"""An exact street for the eye's tests: flat road, far wall, upright things; images and both maps.

Depth is known in closed form, so the half-occlusions of the disparity maps are exact.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from polemap.stereo.matching import DisparityPair
from polemap.stereo.rig import Mounting, StereoRig

RIG = StereoRig(640, 400, 700.0, 319.5, 190.0, 0.4, Mounting(x_m=1.5, y_m=0.1, z_m=1.4))
WALL_M = 60.0


@dataclass(frozen=True)
class Thing:
    """An upright board facing the camera: a pole when it is narrow. Vehicle frame."""

    x_m: float
    y_m: float
    width_m: float
    height_m: float
    base_m: float = 0.0
    lean: float = 0.0  # metres aside a metre of height
    grey: float = 190.0


def street(
    things: list[Thing], rng: np.random.Generator, noise_px: float = 0.0, rig: StereoRig = RIG
) -> tuple[NDArray[np.uint8], NDArray[np.uint8], DisparityPair]:
    """Left and right image, and both disparity maps after the left-right check."""
    views = [_view(things, rig, shift) for shift in (0.0, rig.baseline_m)]
    texture = rng.uniform(40, 120, (64, 4096))
    images = [
        _paint(view, things, texture, rig, shift)
        for view, shift in zip(views, (0.0, rig.baseline_m), strict=True)
    ]
    left, right = (view[0] for view in views)
    left = left + noise_px * rng.standard_normal(left.shape)
    right = right + noise_px * rng.standard_normal(right.shape)
    checked = (_check(left, right, -1), _check(right, left, 1))
    return images[0], images[1], DisparityPair(*(m.astype(np.float32) for m in checked))


def _view(
    things: list[Thing], rig: StereoRig, shift_m: float
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Disparity and owner (-1 wall, -2 road) of the camera that stands `shift_m` to the right."""
    mount = rig.vehicle_from_camera
    v, u = np.mgrid[0 : rig.height_px, 0 : rig.width_px].astype(np.float64)
    fb = rig.focal_px * rig.baseline_m
    below = (v - rig.cy_px) / rig.focal_px
    with np.errstate(divide="ignore"):
        road = np.where(below > 1e-9, mount.z_m / np.maximum(below, 1e-9), np.inf)
    depth = np.minimum(road, WALL_M)
    owner = np.where(road < WALL_M, -2, -1)
    for number, thing in enumerate(things):
        z = thing.x_m - mount.x_m
        height = mount.z_m - below * z
        aside = -(thing.y_m - mount.y_m) - shift_m  # to the right of this camera
        across = (u - rig.cx_px) / rig.focal_px * z - aside + thing.lean * height
        hit = (np.abs(across) <= thing.width_m / 2) & (depth > z)
        hit &= (height >= thing.base_m) & (height <= thing.height_m)
        depth = np.where(hit, z, depth)
        owner = np.where(hit, number, owner)
    return fb / depth, owner


def _paint(
    view: tuple[NDArray[np.float64], NDArray[np.int64]],
    things: list[Thing],
    texture: NDArray[np.float64],
    rig: StereoRig,
    shift_m: float,
) -> NDArray[np.uint8]:
    """Grey values that belong to points in space, so that both views agree."""
    disparity, owner = view
    v, u = np.mgrid[0 : rig.height_px, 0 : rig.width_px].astype(np.float64)
    z = rig.focal_px * rig.baseline_m / disparity
    x = (u - rig.cx_px) / rig.focal_px * z + shift_m
    y = (v - rig.cy_px) / rig.focal_px * z
    # smooth enough to be sampled: a sum of waves whose phase hangs on the random texture
    grey = 80 + 20 * np.sin(6.0 * x + texture[0, 0]) + 15 * np.sin(9.0 * y + 2.0 * x)
    grey = grey + 10 * np.sin(2.0 * z)
    for number, thing in enumerate(things):
        mine = owner == number
        grey = np.where(mine, thing.grey + 12 * np.sin(7.0 * y + 3.0) + 25 * np.sin(45.0 * x), grey)
    return np.clip(grey, 0, 255).astype(np.uint8)


def _check(own: NDArray[np.float64], other: NDArray[np.float64], sign: int) -> NDArray[np.float64]:
    """NaN where the partner is outside of the other view or disagrees."""
    width = own.shape[1]
    at = np.rint(np.arange(width) + sign * own).astype(np.int64)
    inside = (at >= 0) & (at < width)
    partner = np.take_along_axis(other, np.clip(at, 0, width - 1), axis=1)
    return np.where(inside & (np.abs(partner - own) <= 1.0), own, np.nan)
