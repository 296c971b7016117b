"""Roads made by the tests: the rays of all pixels meet a road, a kerb, what stands beside it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from polemap.stereo.depth_edges import UprightMaps, upright_maps
from polemap.stereo.matching import DisparityPair
from polemap.stereo.rig import Mounting, StereoRig

Floats = NDArray[np.float64]
RIG = StereoRig(
    900, 340, 650.0, 449.5, 140.0, 0.5, Mounting(x_m=1.2, y_m=0.1, z_m=1.6, yaw_rad=0.03)
)
_FAR_PX = 0.5


@dataclass(frozen=True)
class Scene:
    """A road at height 0; left of `kerb_m` (at x = 0, slope `kerb_slope`) it lies `step_m` higher.

    `wall_m`: where something stands upright, left of the camera, up to its height. `light` tells
    the ground's brightness of x ahead and y left of the camera's foot.
    """

    kerb_m: float | None = None
    kerb_slope: float = 0.0
    step_m: float = 0.0
    wall_m: float | None = None
    wall_height_m: float = 1.2
    light: Callable[[Floats, Floats], Floats] = lambda x, y: np.full(x.shape, 90.0)
    seed: int = 1
    noise_px: float = 0.15

    def take(self) -> tuple[NDArray[np.uint8], UprightMaps]:
        """The left image and the disparities."""
        column, row = np.meshgrid(np.arange(RIG.width_px), np.arange(RIG.height_px))
        aside = -(column - RIG.cx_px) / RIG.focal_px  # left of the axis by metre of depth
        down = np.maximum((row - RIG.cy_px) / RIG.focal_px, 1e-6)
        height = RIG.vehicle_from_camera.z_m
        depth = height / down
        if self.kerb_m is not None:
            # the kerb's face stands where aside depth = kerb + slope depth
            face = self.kerb_m / np.where(aside > self.kerb_slope, aside - self.kerb_slope, np.nan)
            top = (height - self.step_m) / down
            on_top = top > face
            depth = np.where(on_top, top, np.where(depth > face, face, depth))
        if self.wall_m is not None:
            wall = self.wall_m / np.where(aside > 0.0, aside, np.nan)
            stands = (depth > wall) & (height - wall * (row - RIG.cy_px) / RIG.focal_px
                                       < self.wall_height_m)  # fmt: skip
            depth = np.where(stands, wall, depth)
        rng = np.random.default_rng(self.seed)
        disparity = RIG.focal_px * RIG.baseline_m / depth
        # a matcher's errors are alike in neighbours
        rough = rng.normal(0.0, self.noise_px, (RIG.height_px // 6 + 1, RIG.width_px // 6 + 1))
        disparity += np.kron(rough, np.ones((6, 6)))[: RIG.height_px, : RIG.width_px]
        disparity[disparity < _FAR_PX] = np.nan
        light = self.light(depth, aside * depth) + rng.normal(0.0, 2.0, depth.shape)
        image = np.clip(light, 0, 255).astype(np.uint8)
        left = disparity.astype(np.float32)
        return image, upright_maps(DisparityPair(left, left), 3)
