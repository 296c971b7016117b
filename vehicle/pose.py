"""Poses in the plane, SE(2), as one array type: `(..., 3)` metres east and north, yaw in radians.

A pose `map_from_vehicle` is the place and the yaw of the vehicle frame in the map, the yaw
counter-clockwise from the map's x axis. Every function takes leading dimensions, so one code serves
one pose and all particles. Composing and relating leave the yaw as it adds up, because dead
reckoning counts its turns; `wrap_angle` brings it to [-pi, pi). `Pose2D` is one row with names.
`packed` has the same for single poses in plain floats.

Source: Sola, Deray, Atchuthan, A micro Lie theory for state estimation in robotics,
arXiv:1812.01537, section IV and appendix A.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]


class Pose2D(NamedTuple):
    """One pose as a row with names; every function of this module takes it."""

    x_m: float
    y_m: float
    yaw_rad: float


def wrap_angle(angle_rad: Any) -> Any:
    """Wrap an angle, or an array of them, to [-pi, pi).

    >>> wrap_angle(np.pi) == -np.pi
    True
    """
    turned = angle_rad + np.pi
    # most angles need no remainder, which costs more than all else here
    if np.ndim(turned) and turned.size and turned.min() >= 0.0 and turned.max() < 2.0 * np.pi:
        return turned - np.pi
    return turned % (2.0 * np.pi) - np.pi


def rotation(yaw_rad: ArrayLike) -> Floats:
    """The matrices `(..., 2, 2)` `[[cos, -sin], [sin, cos]]` of yaws `(...)`."""
    turn = np.empty((*np.shape(yaw_rad), 2, 2))
    turn[..., 0, 0] = turn[..., 1, 1] = np.cos(yaw_rad)
    turn[..., 1, 0] = np.sin(yaw_rad)
    turn[..., 0, 1] = -turn[..., 1, 0]
    return turn


def pose_rotation(yaw_rad: ArrayLike) -> Floats:
    """`rotation` for errors of poses `(..., 3, 3)`: it turns the place and keeps the yaw."""
    turn = np.zeros((*np.shape(yaw_rad), 3, 3))
    turn[..., :2, :2] = rotation(yaw_rad)
    turn[..., 2, 2] = 1.0
    return turn


def rotate(vectors: ArrayLike, yaw_rad: ArrayLike) -> Floats:
    """Vectors `(..., 2)` of a frame turned by `yaw_rad` `(...)`, in the axes it is turned from."""
    v = np.asarray(vectors, dtype=np.float64)
    c, s = np.cos(yaw_rad), np.sin(yaw_rad)
    return np.stack([c * v[..., 0] - s * v[..., 1], s * v[..., 0] + c * v[..., 1]], axis=-1)


def rotate_back(vectors: ArrayLike, yaw_rad: ArrayLike) -> Floats:
    """The inverse of `rotate`: differences in the map `(..., 2)` along and across a heading."""
    v = np.asarray(vectors, dtype=np.float64)
    c, s = np.cos(yaw_rad), np.sin(yaw_rad)
    return np.stack([c * v[..., 0] + s * v[..., 1], -s * v[..., 0] + c * v[..., 1]], axis=-1)


def rotate_covariance(covariance: ArrayLike, yaw_rad: ArrayLike) -> Floats:
    """`R P R'` of covariances `(..., 2, 2)` of vectors, or `(..., 3, 3)` of poses."""
    p = np.asarray(covariance, dtype=np.float64)
    turn = rotation(yaw_rad) if p.shape[-1] == 2 else pose_rotation(yaw_rad)
    return np.asarray(turn @ p @ np.swapaxes(turn, -1, -2))


def compose(map_from_a: ArrayLike, a_from_b: ArrayLike) -> Floats:
    """`map_from_b` `(..., 3)`; the yaws are added, not wrapped."""
    a, b = np.asarray(map_from_a, dtype=np.float64), np.asarray(a_from_b, dtype=np.float64)
    x, y = _placed(a, b[..., 0], b[..., 1])
    return np.stack([x, y, a[..., 2] + b[..., 2]], axis=-1)


def _placed(pose: Floats, ahead_m: Floats, left_m: Floats) -> tuple[Floats, Floats]:
    x, y, c, s = pose[..., 0], pose[..., 1], np.cos(pose[..., 2]), np.sin(pose[..., 2])
    return x + c * ahead_m - s * left_m, y + s * ahead_m + c * left_m


def inverse(map_from_vehicle: ArrayLike) -> Floats:
    """`vehicle_from_map` `(..., 3)`."""
    p = np.asarray(map_from_vehicle, dtype=np.float64)
    return np.concatenate([-rotate_back(p[..., :2], p[..., 2]), -p[..., 2:]], axis=-1)


def relative(map_from_a: ArrayLike, map_from_b: ArrayLike) -> Floats:
    """`a_from_b` `(..., 3)`: how b lies seen from a, or the motion from a to b in the axes of a."""
    a, b = np.asarray(map_from_a, dtype=np.float64), np.asarray(map_from_b, dtype=np.float64)
    place = rotate_back(b[..., :2] - a[..., :2], a[..., 2])
    return np.concatenate([place, (b[..., 2] - a[..., 2])[..., np.newaxis]], axis=-1)


def transform_points(map_from_vehicle: ArrayLike, points_vehicle_m: ArrayLike) -> Floats:
    """Points in the frame that the pose is given in.

    Args:
        map_from_vehicle: `(3,)`, one for all points (one matrix product), or `(..., 3)`.
        points_vehicle_m: `(..., 2)`, broadcast against the poses.
    """
    pose = np.asarray(map_from_vehicle, dtype=np.float64)
    points = np.asarray(points_vehicle_m, dtype=np.float64)
    if pose.ndim == 1:
        return np.asarray(points @ rotation(pose[2]).T + pose[:2])
    return np.stack(_placed(pose, points[..., 0], points[..., 1]), axis=-1)


def inverse_transform_points(map_from_vehicle: ArrayLike, points_map_m: ArrayLike) -> Floats:
    """The inverse of `transform_points`: points `(..., 2)` of the map in the vehicle frame.

    The difference is taken before the turn, so that 1e6 m of northing cost no digits.
    """
    pose = np.asarray(map_from_vehicle, dtype=np.float64)
    offset = np.asarray(points_map_m, dtype=np.float64) - pose[..., :2]
    if pose.ndim == 1:
        return np.asarray(offset @ rotation(pose[2]))
    return rotate_back(offset, pose[..., 2])


def mean_way(before: Floats, after: Floats) -> Floats:
    """Mean way `(2,)` between poses `(n, 3)`, in the axes of each, turned by their mean yaw."""
    c, s = np.cos(before[:, 2]), np.sin(before[:, 2])
    east, north = after[:, 0] - before[:, 0], after[:, 1] - before[:, 1]
    ahead, left = float(c @ east + s @ north), float(c @ north - s @ east)
    yaw = float(np.arctan2(s.sum(), c.sum()))
    return rotate(np.array([ahead, left]) / len(before), yaw)


def move_reference_point(
    poses: ArrayLike, ahead_m: Floats | float, left_m: Floats | float = 0.0
) -> Floats:
    """Poses `(..., 3)` of another point of the same body, `ahead_m` before and `left_m` beside it.

    The wheelbase leads from the rear to the front axle.
    """
    moved = np.array(poses, dtype=np.float64)
    c, s = np.cos(moved[..., 2]), np.sin(moved[..., 2])
    moved[..., 0] += ahead_m * c - left_m * s
    moved[..., 1] += ahead_m * s + left_m * c
    return moved


def reference_point_jacobian(
    yaw_rad: ArrayLike, ahead_m: Floats | float, left_m: Floats | float = 0.0
) -> Floats:
    """Derivative `(..., 3, 3)` of `move_reference_point` by the pose."""
    c, s = np.cos(yaw_rad), np.sin(yaw_rad)
    jacobian = np.zeros((*np.broadcast_shapes(c.shape, np.shape(ahead_m), np.shape(left_m)), 3, 3))
    jacobian[..., :, :] = np.eye(3)
    jacobian[..., 0, 2] = -s * ahead_m - c * left_m
    jacobian[..., 1, 2] = c * ahead_m - s * left_m
    return jacobian


def rigid_fit(
    points_vehicle_m: ArrayLike, points_map_m: ArrayLike, weights: ArrayLike | None = None
) -> Floats:
    """`map_from_vehicle` `(..., 3)` that lays points onto their partners by least squares.

    Minimises `sum w |R p + t - q|^2` in closed form: the yaw is the direction of the summed
    products of the centred points, the place brings centroid onto centroid. Two points are
    enough; with fewer, or all in one place, the yaw is 0.

    Args:
        points_vehicle_m: p, `(..., n, 2)`.
        points_map_m: q, `(..., n, 2)`.
        weights: `(n,)`, not negative, their sum positive; all alike if left out.

    Source: Umeyama, Least-squares estimation of transformation parameters between two point
    patterns, IEEE TPAMI 13(4), 1991, in the plane.
    """
    p = np.asarray(points_vehicle_m, dtype=np.float64)
    q = np.asarray(points_map_m, dtype=np.float64)
    w = None if weights is None else np.asarray(weights, dtype=np.float64)
    p_mean = p.mean(axis=-2) if w is None else w @ p / w.sum()
    q_mean = q.mean(axis=-2) if w is None else w @ q / w.sum()
    one, two = p - p_mean[..., np.newaxis, :], q - q_mean[..., np.newaxis, :]
    cross = one[..., 0] * two[..., 1] - one[..., 1] * two[..., 0]
    if w is None:
        yaw = np.arctan2(cross.sum(axis=-1), (one * two).sum(axis=(-2, -1)))
        turned = rotate(p_mean, yaw)
    else:
        yaw = np.arctan2(cross @ w, (one[..., 0] * two[..., 0] + one[..., 1] * two[..., 1]) @ w)
        turned = (rotation(yaw) @ p_mean[..., np.newaxis])[..., 0]
    return np.concatenate([q_mean - turned, np.asarray(yaw)[..., np.newaxis]], axis=-1)
