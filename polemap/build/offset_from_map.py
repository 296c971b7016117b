"""By how much a camera's disparities are off, told by a known map: for labels, not while driving.

A camera out of true by hundredths of a degree places far poles metres beside the map's, and they
would be taken for other things. While driving, `track/disparity_offset.py` learns it without a map.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from polemap.map.pole_map import PoleMap
from polemap.stereo.rig import StereoRig
from polemap.vehicle.pose import inverse_transform_points

Floats = NDArray[np.float64]

_ASIDE_PX = 5.0
_WINDOWS_PX = (1.2, 0.6, 0.4)  # about the median
# gaps; even spread evenly over the last window, so many have a median that is good to 0.07 px
_LEAST = 30


def offset_from_map(
    scans: Sequence[tuple[Floats, Floats]], pole_map: PoleMap, rig: StereoRig
) -> float:
    """What all disparities of a drive lack, in pixels: the median over what lies on a pole's ray.

    The window closes around the median, so that other things on the ray hardly pull it. 0 where
    there is too little.

    Args:
        scans: pose `(3,)` of the vehicle in the map, and what was seen from there `(n, 2)`,
            vehicle frame.
        pole_map: known poles.
        rig: the camera.
    """
    lacking = [np.empty(0)]
    for pose, seen in scans:
        mapped = inverse_transform_points(pose, pole_map.points_m)
        mapped = _disparity(mapped[_disparity(mapped, rig)[:, 0] > 0.0], rig)
        gap = mapped[:, None] - _disparity(seen, rig)
        near = (np.abs(gap[..., 1]) <= _ASIDE_PX) & (np.abs(gap[..., 0]) <= _WINDOWS_PX[0])
        lacking.append(gap[..., 0][near])
    gaps, middle = np.concatenate(lacking), 0.0
    for width in _WINDOWS_PX:
        chosen = gaps[np.abs(gaps - middle) <= width]
        if len(chosen) < _LEAST:
            return 0.0
        middle = float(np.median(chosen))
    return middle


def _disparity(points_vehicle_m: Floats, rig: StereoRig) -> Floats:
    """Disparity and column `(n, 2)` of points on the ground."""
    u, _, d = rig.project(np.column_stack([points_vehicle_m, np.zeros(len(points_vehicle_m))])).T
    return np.column_stack([d, u])
