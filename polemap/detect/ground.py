"""The road surface of one frame as a plane in disparity space.

A plane in space is affine in (column, row, disparity): d = c0 + c1 u + c2 v. It is fitted to the
disparities that lie near the plane which the mounting predicts, in shrinking bands of height, so
that pitch and roll of the car and the slope of the road are followed.

Source: R. Labayrade et al., v-disparity, IV 2002, for the road as a line in (v, d); here with roll.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from polemap.stereo.depth_edges import UprightMaps
from polemap.stereo.rig import StereoRig

Floats = NDArray[np.float64]

_BANDS_M = (0.6, 0.45, 0.3, 0.2, 0.15)  # half widths of the band of heights, shrinking
_MIN_POINTS = 60
_COLUMN_STEP = 8
_ROLL_PULL_PX2 = 30.0  # as if the columns spread by so much less
_LEAST_CAMERA_HEIGHT_M = 0.2


@dataclass(frozen=True, slots=True)
class Ground:
    """d = offset + per_column u + per_row v; `fitted` is False where only the mounting spoke."""

    offset: float
    per_column: float
    per_row: float
    fitted: bool

    def row_px(self, column_px: Floats, disparity_px: Floats) -> Floats:
        """The image row in which an object of this column and disparity meets the ground."""
        rows = (disparity_px - self.offset - self.per_column * np.asarray(column_px)) / self.per_row
        return np.asarray(rows)


@lru_cache(maxsize=64)
def ground_from_mounting(rig: StereoRig) -> Ground:
    """The plane that a level car on a flat road would see."""
    # height of a camera point above the ground: r . point + z_mount = 0, times focal length / depth
    r_x, r_y, r_z = (float(value) for value in rig.vehicle_from_camera.rotation()[2])
    height_m = max(rig.vehicle_from_camera.z_m, _LEAST_CAMERA_HEIGHT_M)
    scale = -rig.baseline_m / height_m
    return Ground(
        offset=scale * (r_z * rig.focal_px - r_x * rig.cx_px - r_y * rig.cy_px),
        per_column=scale * r_x,
        per_row=scale * r_y,
        fitted=False,
    )


def fit_ground(maps: UprightMaps, rig: StereoRig) -> Ground:
    """The road plane in the left view; the mounting's plane where it shows none."""
    ground = ground_from_mounting(rig)
    step = maps.row_step_px
    thin = max(1, 4 // step)
    first = maps.left.shape[0] // 2
    grid = np.ascontiguousarray(maps.left[first::thin, ::_COLUMN_STEP])
    at = np.flatnonzero(grid > 0)
    at_row = at // grid.shape[1]
    u = (at - at_row * grid.shape[1]) * float(_COLUMN_STEP)
    v = at_row * float(thin * step) + float(first * step)
    d = grid.ravel().take(at).astype(np.float64)
    ones = np.ones_like(d)
    design = np.concatenate([ones, u, v, d]).reshape(4, len(d))
    prior = np.array([ground.offset, ground.per_column, ground.per_row])
    pull = np.diag([0.0, _ROLL_PULL_PX2, 0.0])
    coefficients = prior
    height_m = max(rig.vehicle_from_camera.z_m, _LEAST_CAMERA_HEIGHT_M)
    # at equal depth a disparity residual r is a height of about r / d times the camera height
    per_px = height_m / d
    precision = per_px * per_px
    weighted = np.empty((3, len(d)))
    for band_m in _BANDS_M:
        expected = coefficients @ design[:3]
        weight = d - expected
        weight *= per_px  # the height above the plane
        weight *= weight
        weight *= -1.0 / band_m**2
        weight += 1.0
        np.maximum(weight, 0.0, out=weight)
        weight *= weight
        weight *= precision
        weight *= expected > 1.0
        if np.count_nonzero(weight) < _MIN_POINTS:
            return ground
        np.multiply(design[:3], weight, out=weighted)
        sums = weighted @ design.T
        # a weak pull towards the mounting keeps the roll in place where the road is narrow
        hold = pull * sums[0, 0]
        coefficients = np.linalg.solve(sums[:, :3] + hold, sums[:, 3] + hold @ prior)
    if coefficients[2] <= 0.3 * prior[2]:
        return ground
    return Ground(
        float(coefficients[0]), float(coefficients[1]), float(coefficients[2]), fitted=True
    )
