"""Robust rigid registration of pole sets: drives whose references disagree by a common shift."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from polemap.build.georeference import MapDetections
from polemap.build.traversals import TraversalLandmarks
from polemap.vehicle.pose import rotate, wrap_angle

Floats = NDArray[np.float64]

_MATCHES_MIN = 8
_CELL_M = 0.1
_ROTATION_MAX_RAD = 0.02


@dataclass(frozen=True, slots=True)
class Shift:
    """`p -> R(yaw) (p - centre) + centre + move`; the correction that aligns one set to another.

    `sd_m` is the standard error of `move` an axis, `matches` the poles that it rests on.
    """

    move_m: tuple[float, float]
    yaw_rad: float
    centre_m: tuple[float, float]
    sd_m: float
    matches: int

    @property
    def size_m(self) -> float:
        """How far it moves the middle."""
        return float(np.hypot(*self.move_m))

    @property
    def significant(self) -> bool:
        """More than the noise of the registration itself explains."""
        return self.matches >= _MATCHES_MIN and self.size_m > max(4.0 * self.sd_m, 0.05)

    def points(self, points_m: Floats) -> Floats:
        """The shift applied to points `(n, 2)`."""
        turned = rotate(points_m - np.array(self.centre_m), self.yaw_rad)
        return np.asarray(turned + np.array(self.centre_m) + np.array(self.move_m))


NO_SHIFT = Shift((0.0, 0.0), 0.0, (0.0, 0.0), float("inf"), 0)


def register(moving_m: Floats, fixed_m: Floats, most_m: float, inlier_m: float = 0.5) -> Shift:
    """The rigid motion that lays `moving_m` `(n, 2)` onto `fixed_m` `(m, 2)`.

    A vote over all pairs closer than `most_m` finds the shift, whatever part of the sets overlaps
    and however regular poles stand; robust least squares then finds shift and turn. With too few
    matches the result is `NO_SHIFT`.
    """
    if len(moving_m) < _MATCHES_MIN or len(fixed_m) < _MATCHES_MIN:
        return NO_SHIFT
    tree = scipy.spatial.KDTree(fixed_m)
    start = _vote(moving_m, fixed_m, tree, most_m)
    centre = moving_m.mean(axis=0)
    move, yaw = start, 0.0
    sd, matches = float("inf"), 0
    for limit in (2.0 * inlier_m, inlier_m, inlier_m, inlier_m / 2.0, inlier_m / 2.0):
        placed = Shift((move[0], move[1]), yaw, (centre[0], centre[1]), 0.0, 0).points(moving_m)
        found: tuple[Any, Any] = tree.query(placed, distance_upper_bound=limit)
        distance, row = found
        inlier = np.isfinite(distance)
        matches = int(np.count_nonzero(inlier))
        if matches < _MATCHES_MIN:
            return NO_SHIFT
        solution, sd = _least_squares(placed[inlier], fixed_m[row[inlier]], centre + move)
        move, yaw = move + solution[:2], yaw + float(solution[2])
        yaw = float(np.clip(yaw, -_ROTATION_MAX_RAD, _ROTATION_MAX_RAD))
    return Shift((float(move[0]), float(move[1])), yaw, (centre[0], centre[1]), sd, matches)


def _vote(moving: Floats, fixed: Floats, tree: scipy.spatial.KDTree, most_m: float) -> Floats:
    """The most frequent difference of two points, by a window that slides over all differences."""
    pairs: Any = tree.query_ball_point(moving, most_m)
    difference = np.concatenate(
        [fixed[rows] - point for rows, point in zip(pairs, moving, strict=True) if rows]
        or [np.zeros((1, 2))]
    )
    cells = int(np.ceil(2.0 * most_m / _CELL_M))
    edges = np.linspace(-most_m, most_m, cells + 1)
    count, _, _ = np.histogram2d(difference[:, 0], difference[:, 1], bins=(edges, edges))
    votes = scipy.ndimage.uniform_filter(count, size=5, mode="constant")
    middle = (edges[1:] + edges[:-1]) / 2.0
    east, north = np.meshgrid(middle, middle, indexing="ij")
    # where votes tie, the smaller shift is the likelier one
    order: Any = np.lexsort((np.hypot(east, north).ravel(), -np.round(votes, 6).ravel()))
    best = int(order[0])
    top = np.array([east.ravel()[best], north.ravel()[best]])
    near = np.linalg.norm(difference - top, axis=1) <= 2.5 * _CELL_M
    return np.asarray(np.median(difference[near], axis=0) if near.any() else np.zeros(2))


def _least_squares(placed: Floats, target: Floats, centre: Floats) -> tuple[Floats, float]:
    """Small motion (east, north, yaw about `centre`) of matched points, Huber weights."""
    offset = placed - centre
    n = len(placed)
    design = np.zeros((2 * n, 3))
    design[0::2, 0], design[1::2, 1] = 1.0, 1.0
    design[0::2, 2], design[1::2, 2] = -offset[:, 1], offset[:, 0]
    wanted = (target - placed).reshape(-1)
    # a weak prior keeps the turn at zero where the points do not tell it
    prior = np.diag([0.0, 0.0, 1.0 / 0.003**2])
    weight = np.ones(2 * n)
    solution: Floats = np.zeros(3)
    scale = 0.1
    covariance: Floats = np.eye(3)
    for _ in range(10):
        residual = wanted - design @ solution
        scale = max(1.4826 * float(np.median(np.abs(residual))), 0.01)
        weight = np.minimum(1.0, 1.5 * scale / np.maximum(np.abs(residual), 1e-9)) / scale**2
        covariance = np.asarray(
            np.linalg.inv(design.T @ (design * weight[:, None]) + prior), np.float64
        )
        solution = covariance @ (design.T @ (weight * wanted))
    return solution, float(np.sqrt((covariance[0, 0] + covariance[1, 1]) / 2.0))


def moved_detections(detections: MapDetections, shift: Shift) -> MapDetections:
    """All of a drive moved: poles, and the poses that they were seen from."""
    poses = np.column_stack(
        [
            shift.points(detections.views.poses[:, :2]),
            wrap_angle(detections.views.poses[:, 2] + shift.yaw_rad),
        ]
    )
    return replace(
        detections,
        views=replace(detections.views, poses=poses),
        points_m=shift.points(detections.points_m),
    )


def moved_landmarks(landmarks: TraversalLandmarks, shift: Shift) -> TraversalLandmarks:
    """Pass landmarks moved; a turn this small leaves their covariances as they are."""
    return replace(landmarks, points_m=shift.points(landmarks.points_m))
