"""The poles of the way driven, joined by the odometry, with what is wrong with both.

Scans are kept as they were seen. From them poles, their covariances and the lasting errors of the
odometry (scale of the way, curvature of a straight course, bias of the yaw rate) are estimated
together by linear least squares: a pole that comes nearer says how far the car has driven. What
stays unknown of these errors moves all poles in a known way and is kept beside them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from polemap.vehicle.pose import (
    relative,
    rotate,
    rotate_covariance,
    transform_points,
    wrap_angle,
)

Floats = NDArray[np.float64]
Whole = NDArray[np.int64]

_CORRELATED = 0.5  # share of a sighting's variance that stays with its pole
WANDER = 0.002
"""Error of the course that does not last, sd in radians: slip, and what no constant tells."""
DRIFT_SD = np.array([0.03, 0.001, 0.003])
"""Scale, curvature (rad/m), yaw rate (rad/s): what an odometry may lastingly be wrong by."""


@dataclass(frozen=True, slots=True)
class LocalMap:
    """Poles around the way driven, in the vehicle frame of the newest scan.

    Attributes:
        points_m: `(n, 2)`.
        covariance_m2: `(n, 2, 2)` without any errors of the odometry.
        wander_m2: `(n,)` variance by what does not last of these; neighbours share it.
        drift: `(n, 2, 3)` how poles move with these errors.
        drift_covariance: `(3, 3)` of them.
        sightings: `(n,)` scans that saw the pole.
        width_m: `(n,)`, NaN where unknown.
        looks: `(k, 3)` poses of the scans.
        ground: `(g, 3)` places that they looked at, and what a look at each counts.
    """

    points_m: Floats
    covariance_m2: Floats
    wander_m2: Floats
    drift: Floats
    drift_covariance: Floats
    sightings: Whole
    width_m: Floats
    looks: Floats
    ground: Floats

    def __len__(self) -> int:
        return len(self.points_m)

    @property
    def way_m(self) -> float:
        """Length of the way along its scans."""
        return float(np.hypot(*np.diff(self.looks[:, :2], axis=0).T).sum())

    def confirmed(self, least: int = 2) -> LocalMap:
        """The poles that so many scans saw."""
        rows = self.sightings >= least
        return replace(
            self,
            points_m=self.points_m[rows],
            covariance_m2=self.covariance_m2[rows],
            wander_m2=self.wander_m2[rows],
            drift=self.drift[rows],
            sightings=self.sightings[rows],
            width_m=self.width_m[rows],
        )

    def mirrored(self) -> LocalMap:
        """The mirror image: as regular as the true one, and nowhere in the world."""
        flip = np.array([1.0, -1.0])
        return replace(
            self,
            points_m=self.points_m * flip,
            covariance_m2=self.covariance_m2 * np.outer(flip, flip),
            drift=self.drift * flip[:, np.newaxis],
            looks=self.looks * np.array([1.0, -1.0, -1.0]),
            ground=self.ground * np.array([1.0, -1.0, 1.0]),
        )


@dataclass(frozen=True, slots=True)
class Look:
    """A scan of the way: what it saw, and the number of the pole that each sighting is of."""

    stamp_s: float
    odometry_pose: Floats
    ground: Floats
    points_m: Floats
    covariance_m2: Floats
    width_m: Floats
    pole: Whole


def joined(looks: list[Look], drift: Floats) -> tuple[LocalMap, Floats]:
    """Poles of the looks with given errors of the odometry, and better errors."""
    poses, by_drift = _course(looks, drift)
    look = np.repeat(np.arange(len(looks)), [len(one.pole) for one in looks])
    ray = rotate(np.concatenate([one.points_m for one in looks]), poses[look, 2])
    point = poses[look, :2] + ray
    aside = np.stack([-ray[:, 1], ray[:, 0]], axis=1)
    slope = by_drift[look, :2] + aside[:, :, np.newaxis] * by_drift[look, 2][:, np.newaxis]
    covariance = rotate_covariance(
        np.concatenate([one.covariance_m2 for one in looks]), poses[look, 2]
    )
    numbers, pole, count = np.unique(
        np.concatenate([one.pole for one in looks]), return_inverse=True, return_counts=True
    )
    weight = np.linalg.inv(covariance)
    sums = _Sums(pole, len(numbers))
    # a share of the errors of a pole's sightings stays alike: of the mean it leaves what its
    # weighted mean is, and the sharp sightings near the pole have the weight
    sharpness = np.sqrt(0.5 * np.trace(weight, axis1=1, axis2=2))
    alike = sums.of(sharpness) ** 2 / sums.of(sharpness**2)
    weight = weight / (1.0 + _CORRELATED * (alike - 1.0))[pole, None, None]
    information = sums.of(weight)
    vector = sums.of(np.einsum("sij,sj->si", weight, point))
    cross = sums.of(weight @ slope)
    spread = np.asarray(np.linalg.inv(information), dtype=np.float64)
    place = np.einsum("nij,nj->ni", spread, vector)
    moved = spread @ cross
    rest = point - place[pole]
    # of the sightings' own, less what the poles take up
    freedom = slope - moved[pole]
    own = np.einsum("sia,sij,sjb->ab", freedom, weight, freedom)
    pull = np.einsum("sia,sij,sj->a", freedom, weight, rest)
    prior = np.diag(DRIFT_SD**-2.0)
    drift_covariance = np.linalg.inv(own + prior)
    change = -drift_covariance @ (pull + prior @ drift)
    place = place + moved @ change
    away = place - place.mean(axis=0)
    wander: Floats = WANDER**2 * np.einsum("ni,ni->n", away, away)
    width = np.concatenate([one.width_m for one in looks])
    known = np.isfinite(width)
    seen = np.bincount(pole[known], minlength=len(numbers))
    total = np.bincount(pole[known], width[known], minlength=len(numbers))
    with np.errstate(invalid="ignore"):
        mean_width = np.where(seen > 0, total / np.maximum(seen, 1), np.nan)
    made = LocalMap(
        place, spread, wander, moved, drift_covariance, count, mean_width, poses,
        _ground_seen(looks, poses),
    )  # fmt: skip
    return made, drift + change


def _ground_seen(looks: list[Look], poses: Floats) -> Floats:
    look = np.repeat(np.arange(len(looks)), [len(one.ground) for one in looks])
    ground = np.concatenate([one.ground for one in looks])
    return np.column_stack([transform_points(poses[look], ground[:, :2]), ground[:, 2]])


class _Sums:
    """Sums of arrays `(s, ...)` over the sightings of each of n poles."""

    def __init__(self, pole: Whole, n: int) -> None:
        self._order = np.argsort(pole, kind="stable")
        self._first = np.searchsorted(pole[self._order], np.arange(n))

    def of(self, values: Floats) -> Floats:
        return np.asarray(np.add.reduceat(values[self._order], self._first, axis=0))


def _course(looks: list[Look], drift: Floats) -> tuple[Floats, Floats]:
    """Poses `(k, 3)` of the looks in the frame of the last, the errors taken out, and their
    derivatives `(k, 3, 3)` by these."""
    raw = np.array([look.odometry_pose for look in looks])
    stamp = np.array([look.stamp_s for look in looks])
    step = relative(raw[:-1], raw[1:])
    way = np.concatenate([[0.0], np.cumsum(np.hypot(step[:, 0], step[:, 1]))])
    scale, curvature, rate = drift
    bend = curvature * np.diff(way) + rate * np.diff(stamp)
    yaw = np.concatenate([[0.0], np.cumsum(step[:, 2] + bend)])
    moves = (1.0 + scale) * rotate(step[:, :2], yaw[:-1] + 0.5 * bend)
    place = np.concatenate([np.zeros((1, 2)), np.cumsum(moves, axis=0)])
    last = np.array([*place[-1], yaw[-1]])
    poses = relative(last, np.column_stack([place, yaw]))
    moves = rotate(moves, -yaw[-1])
    aside = np.stack([-moves[:, 1], moves[:, 0]], axis=1)
    slopes = np.zeros((len(looks), 3, 3))
    slopes[:, :2, 0] = poses[:, :2] / (1.0 + scale)
    for column, passed in ((1, way - way[-1]), (2, stamp - stamp[-1])):
        middle = 0.5 * (passed[1:] + passed[:-1])
        turned = middle[:, np.newaxis] * aside
        slopes[:-1, :2, column] = -np.cumsum(turned[::-1], axis=0)[::-1]
        slopes[:, 2, column] = passed
    poses[:, 2] = wrap_angle(poses[:, 2])
    return poses, slopes
