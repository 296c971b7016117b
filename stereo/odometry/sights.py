"""Points as they are seen: `(u, v, u')`, column and row in the left view and column in the right.

In these coordinates the noise of a corner is the same at every distance, which it is not in metres:
a far point's place has a long tail away from the camera.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from polemap.stereo.rig import StereoRig

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

_NEAREST_M = 0.5
_DISPARITY_MIN_PX = 0.05


def project(rig: StereoRig, points_m: Floats) -> Floats:
    """Sights `(n, 3)` of camera points `(n, 3)`."""
    inverse = 1.0 / points_m[:, 2]
    u = rig.focal_px * points_m[:, 0] * inverse + rig.cx_px
    v = rig.focal_px * points_m[:, 1] * inverse + rig.cy_px
    return np.column_stack([u, v, u - rig.focal_px * rig.baseline_m * inverse])


def points_of(rig: StereoRig, sights_px: Floats) -> Floats:
    """Camera points `(n, 3)` of sights `(n, 3)`."""
    disparity = np.maximum(sights_px[:, 0] - sights_px[:, 2], _DISPARITY_MIN_PX)
    points = sights_px - (rig.cx_px, rig.cy_px, 0.0)
    points[:, 2] = rig.focal_px
    return np.asarray(points * (rig.baseline_m / disparity)[:, None])


def move(transform: Floats, points_m: Floats) -> Floats:
    """Points `(n, 3)` under a rigid motion `(4, 4)`."""
    return np.asarray(points_m @ transform[:3, :3].T + transform[:3, 3])


def in_front(transform: Floats, points_m: Floats) -> Floats:
    """The same, none nearer than can be seen."""
    moved = move(transform, points_m)
    moved[:, 2] = np.maximum(moved[:, 2], _NEAREST_M)
    return moved


def by_point(rig: StereoRig, points_m: Floats) -> Floats:
    """`(n, 3, 3)`: derivative of sights by points."""
    f, inverse = rig.focal_px, 1.0 / points_m[:, 2]
    jacobian = np.zeros((len(points_m), 3, 3))
    jacobian[:, 0, 0] = jacobian[:, 1, 1] = jacobian[:, 2, 0] = f * inverse
    jacobian[:, 0, 2] = -f * points_m[:, 0] * inverse**2
    jacobian[:, 1, 2] = -f * points_m[:, 1] * inverse**2
    jacobian[:, 2, 2] = -f * (points_m[:, 0] - rig.baseline_m) * inverse**2
    return jacobian


def by_sight(rig: StereoRig, points_m: Floats) -> Floats:
    """`(n, 3, 3)`: derivative of points by sights, the inverse of `by_point`."""
    # a disparity one pixel larger draws a point nearer by this share of itself
    nearer = points_m * (points_m[:, 2] / (rig.focal_px * rig.baseline_m))[:, None]
    jacobian = np.zeros((len(points_m), 3, 3))
    jacobian[:, :, 0], jacobian[:, :, 2] = -nearer, nearer
    jacobian[:, 0, 0] += points_m[:, 2] / rig.focal_px
    jacobian[:, 1, 1] = points_m[:, 2] / rig.focal_px
    return jacobian


def by_motion(rig: StereoRig, points_m: Floats) -> Floats:
    """`(n, 3, 6)`: derivative of sights by a translation and a rotation vector of the points."""
    f, inverse = rig.focal_px, 1.0 / points_m[:, 2]
    x, y = points_m[:, 0] * inverse, points_m[:, 1] * inverse
    right = x - rig.baseline_m * inverse
    jacobian = np.zeros((len(points_m), 3, 6))
    jacobian[:, 0, 0] = jacobian[:, 1, 1] = jacobian[:, 2, 0] = inverse
    for row, tangent in enumerate((x, y, right)):
        jacobian[:, row, 2] = -tangent * inverse
        jacobian[:, row, 3] = -tangent * y
        jacobian[:, row, 4] = tangent * x
    jacobian[:, 1, 3] -= 1.0
    jacobian[:, 0, 4] += 1.0
    jacobian[:, 2, 4] += 1.0
    jacobian[:, 0, 5] = jacobian[:, 2, 5] = -y
    jacobian[:, 1, 5] = x
    return np.asarray(f * jacobian)
