"""What poles and corners share: errors along and across the line of sight, and doubles."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from polemap.stereo.rig import StereoRig

Floats = NDArray[np.float64]


def sight_covariance(
    points_vehicle_m: Floats, sd_range_m: Floats, sd_across_m: Floats, rig: StereoRig
) -> Floats:
    """Covariance `(n, 2, 2)` of points `(n, 2)` whose errors lie along and across the sight line.

    Args:
        sd_range_m, sd_across_m: `(n,)`.
    """
    camera = np.array([rig.vehicle_from_camera.x_m, rig.vehicle_from_camera.y_m])
    ray = points_vehicle_m - camera
    ray = ray / np.maximum(np.hypot(ray[:, 0], ray[:, 1]), 1e-6)[:, None]
    across = np.stack([-ray[:, 1], ray[:, 0]], axis=1)
    return np.asarray(
        sd_range_m[:, None, None] ** 2 * ray[:, :, None] * ray[:, None, :]
        + sd_across_m[:, None, None] ** 2 * across[:, :, None] * across[:, None, :]
    )


def first_of_each(same: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Which rows `(n,)` stay where each one drops those after it that are the same thing.

    Args:
        same: `(n, n)`, rows best first.
    """
    keep = np.ones(len(same), dtype=bool)
    for row in range(len(same)):
        if keep[row]:
            keep[row + 1 :] &= ~same[row, row + 1 :]
    return keep
