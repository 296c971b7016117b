"""The poles of the way driven, joined by the odometry, with what is wrong with both.

Scans are kept as they were seen. From them poles, their covariances and the lasting errors of the
odometry (scale of the way, curvature of a straight course, bias of the yaw rate) are estimated
together by linear least squares: a pole that comes nearer says how far the car has driven. What
stays unknown of these errors moves all poles in a known way and is kept beside them.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.detections import Detections, VisibleRegion
from polemap.localize.place.coverage import seen_ground
from polemap.vehicle.pose import (
    relative,
    rotate,
    rotate_covariance,
    transform_points,
    wrap_angle,
)

Floats = NDArray[np.float64]
Whole = NDArray[np.int64]

WINDOW_M = 150.0
"""Way after which scans are forgotten."""
_STEP_M = 0.8  # between scans that are kept: their errors are hardly new before
_FLOOR_M = 0.05  # of every sighting: what detectors do not state, trunks that are no lines
_CORRELATED = 0.5  # share of a sighting's variance that stays with its pole
_SAME_GATE = 9.0  # squared Mahalanobis distance of sightings of one pole
_SAME_M = 1.5
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
class _Look:
    stamp_s: float
    odometry_pose: Floats
    travelled_m: float
    ground: Floats
    points_m: Floats
    covariance_m2: Floats
    width_m: Floats
    pole: Whole


class LocalMapBuilder:
    """Keeps the scans of the last metres and which of their poles are the same."""

    def __init__(self, window_m: float = WINDOW_M) -> None:
        self._window_m = window_m
        self._looks: deque[_Look] = deque()
        self._last_m = np.empty((0, 2))
        self._last_covariance = np.empty((0, 2, 2))
        self._last_look_m = np.empty(0)
        self._numbers = np.empty(0, dtype=np.int64)
        self._next = 0
        self._drift = np.zeros(3)
        self._view: VisibleRegion | None = None
        self._seen = np.empty((0, 3))

    @property
    def odometry_pose(self) -> Floats:
        """The dead-reckoned pose `(3,)` of the newest scan that was kept."""
        return self._looks[-1].odometry_pose.copy() if self._looks else np.zeros(3)

    def add_scan(self, scan: Detections, odometry_pose: Floats, travelled_m: float) -> bool:
        """Take in a scan from a dead-reckoned pose `(3,)`; False if the car has hardly moved."""
        if self._looks and abs(travelled_m - self._looks[-1].travelled_m) < _STEP_M:
            return False
        points = scan.points_vehicle_m.reshape(-1, 2)
        covariance = scan.covariance_m2.reshape(-1, 2, 2) + _FLOOR_M**2 * np.eye(2)
        pole = self._same(
            transform_points(odometry_pose, points),
            rotate_covariance(covariance, odometry_pose[2]),
            travelled_m,
        )
        look = _Look(
            scan.stamp_s, np.array(odometry_pose), travelled_m, self._ground(scan.view), points,
            covariance, scan.width_m, pole,
        )  # fmt: skip
        self._looks.append(look)
        while self._looks[0].travelled_m < travelled_m - self._window_m:
            self._looks.popleft()
        return True

    def _ground(self, view: VisibleRegion | None) -> Floats:
        if view is None:
            return np.empty((0, 3))
        if view is not self._view:
            self._view, self._seen = view, seen_ground(view)
        return self._seen

    def _same(self, points: Floats, covariance: Floats, travelled_m: float) -> Whole:
        """Numbers `(z,)` of the poles that points `(z, 2)` in the dead-reckoning frame are of."""
        recent = self._last_look_m > travelled_m - self._window_m
        self._last_m, self._last_covariance = self._last_m[recent], self._last_covariance[recent]
        self._last_look_m, self._numbers = self._last_look_m[recent], self._numbers[recent]
        offset = points[:, np.newaxis] - self._last_m
        spread = covariance[:, np.newaxis] + self._last_covariance
        # the way since the last sighting may be wrong by some hundredths
        gone = 0.03 * np.abs(travelled_m - self._last_look_m)
        spread = spread + (gone**2)[:, np.newaxis, np.newaxis] * np.eye(2)
        squared = np.einsum(
            "zni,zni->zn", offset, np.linalg.solve(spread, offset[..., None])[..., 0]
        )
        distance = np.hypot(offset[..., 0], offset[..., 1])
        squared = np.where(distance < _SAME_M, squared, np.inf)
        number = np.full(len(points), -1, dtype=np.int64)
        row = np.full(len(points), -1, dtype=np.int64)
        while squared.size and squared.min() < _SAME_GATE:
            seen, known = np.unravel_index(int(squared.argmin()), squared.shape)
            number[seen], row[seen] = self._numbers[known], known
            squared[seen], squared[:, known] = np.inf, np.inf
        old = row >= 0
        self._last_m[row[old]], self._last_covariance[row[old]] = points[old], covariance[old]
        self._last_look_m[row[old]] = travelled_m
        new = np.flatnonzero(~old)
        number[new] = self._next + np.arange(len(new))
        self._next += len(new)
        self._last_m = np.concatenate([self._last_m, points[new]])
        self._last_covariance = np.concatenate([self._last_covariance, covariance[new]])
        self._last_look_m = np.append(self._last_look_m, np.full(len(new), travelled_m))
        self._numbers = np.append(self._numbers, number[new])
        return number

    def local_map(self) -> LocalMap | None:
        """What the scans of the window say together; None before the first pole."""
        looks = list(self._looks)
        if not looks or not sum(len(look.pole) for look in looks):
            return None
        made, drift = _joined(looks, self._drift)
        # what the scans so far have taught of the odometry is taken out of the next map
        self._drift = np.clip(drift, -4.0 * DRIFT_SD, 4.0 * DRIFT_SD)
        return made


def _joined(looks: list[_Look], drift: Floats) -> tuple[LocalMap, Floats]:
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


def _ground_seen(looks: list[_Look], poses: Floats) -> Floats:
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


def _course(looks: list[_Look], drift: Floats) -> tuple[Floats, Floats]:
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
