"""How well poses explain the local map: all its poles, and those of the map that should be in it.

For each seen pole the likelihood of standing where it was seen, as the pose has it, is held against
that of standing there by chance: `log(u + (1 - u) N(r; 0, S) / density)`, with r the distance to
the nearest map pole after the pose and the odometry's lasting errors have been fitted, S the
covariance of both, u the share of seen poles that a map lacks (false poles, ageing), and the
density of poles beside streets. A map pole that was in view m times and not seen costs `log(a + (1
- a) (1 - p)^m)`, with p the chance of seeing it and a that it is gone or hidden.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from polemap.localize.place.coverage import Coverage
from polemap.localize.place.local_map import LocalMap
from polemap.localize.place.regularity import chance_density
from polemap.map.pattern_index.index import PatternIndex
from polemap.vehicle.pose import (
    inverse_transform_points,
    rotate,
    rotate_covariance,
)

Floats = NDArray[np.float64]
Whole = NDArray[np.int64]

_LACKING = 0.2
_DENSITY_PER_M2 = 0.02  # of poles beside streets
_HIDDEN = 0.2
_SEEN = 0.5
_LOOKS_MOST = 4.0  # looks from nearly one place tell the same
_GATES_M = (2.0, 1.2, 0.8)  # of seen and mapped poles, fit by fit
_JUDGED_M = 1.2  # beyond, no covariance makes them the same
_FLOOR_M = 0.05  # of the distance of a seen and a mapped pole
_WIDTH_SD_M = 0.12
_OTHER_WIDTH = 0.2  # share of widths that say nothing: trunks are measured at another height
_WIDTH_RATIO_MOST = 5.0
_WIDTHS = 256  # of the map's, for how common a width is


@dataclass(frozen=True, slots=True)
class Judged:
    """Poses after their fit, and what speaks for them.

    Attributes:
        poses: `(m, 3)` of the vehicle in the map.
        covariance: `(m, 3, 3)` of them.
        log_ratio: `(m,)` log-likelihood ratio against chance.
        matched: `(m,)` seen poles that stand on map poles.
        rows: `(m, n)` map pole of each seen pole, -1 for none.
    """

    poses: Floats
    covariance: Floats
    log_ratio: Floats
    matched: Whole
    rows: Whole

    def __len__(self) -> int:
        return len(self.poses)

    def take(self, rows: Whole | NDArray[np.bool_]) -> Judged:
        """Some of them."""
        return Judged(
            self.poses[rows], self.covariance[rows], self.log_ratio[rows], self.matched[rows],
            self.rows[rows],
        )  # fmt: skip


def judge(index: PatternIndex, local: LocalMap, poses: Floats, most: int = 60) -> Judged:
    """Fit poses `(m, 3)` to the poles of a local map and weigh them by the poles that are seen.

    Args:
        most: only so many, the best after a first fit, are weighed.
    """
    drift = np.zeros((len(poses), 3))
    hessian = np.empty((len(poses), 6, 6))
    for gate in _GATES_M:
        step, hessian, support = _normal_step(index, local, poses, drift, gate)
        poses, drift = poses + step[:, :3], drift + step[:, 3:]
        if len(poses) > most:
            best = np.sort(np.argsort(-support, kind="stable")[:most])
            poses, drift, hessian = poses[best], drift[best], hessian[best]
    world, _, spread = _placed(index, local, poses, drift)
    _, row = index.nearest(world, _JUDGED_M)
    near = row >= 0
    rest = np.where(near[..., None], index.points_m[row] - world, 0.0)
    spread = spread + _map_variance(index, row)
    squared, determinant = _squared(spread, rest)
    density = np.exp(-0.5 * squared) / (2.0 * np.pi * np.sqrt(determinant))
    density /= chance_density(local.points_m, _DENSITY_PER_M2)
    density *= _width_ratio(index, local.width_m, row)
    ratio: Floats = np.log(_LACKING + np.where(near, (1.0 - _LACKING) * density, 0.0))
    row = np.where(ratio > 0.0, row, -1)
    ratio, row = _one_to_one(ratio, row)
    covariance = np.asarray(np.linalg.inv(hessian)[:, :3, :3], dtype=np.float64)
    matched = (row >= 0).sum(axis=1).astype(np.int64)
    return Judged(poses, covariance, ratio.sum(axis=1), matched, row)


def _width_ratio(index: PatternIndex, seen: Floats, row: Whole) -> Floats:
    """Likelihood ratio `(m, n)` of the widths `(n,)` that were seen, against those of any pole of
    the map; one where one of them is unknown."""
    every = index.widths_m(_WIDTHS)
    mapped = index.width_m[row].astype(np.float64)
    if not len(every):
        return np.ones(mapped.shape)
    likely = np.exp(-0.5 * ((mapped - seen) / _WIDTH_SD_M) ** 2)
    by_chance = np.exp(-0.5 * ((every[:, np.newaxis] - seen) / _WIDTH_SD_M) ** 2).mean(axis=0)
    ratio = _OTHER_WIDTH + (1.0 - _OTHER_WIDTH) * likely / np.maximum(by_chance, 1e-9)
    return np.where(np.isfinite(ratio), np.minimum(ratio, _WIDTH_RATIO_MOST), 1.0)


def _placed(
    index: PatternIndex, local: LocalMap, poses: Floats, drift: Floats
) -> tuple[Floats, Floats, Floats]:
    """Seen poles `(m, n, 2)` in the map, derivatives `(m, n, 2, 6)`, covariances `(m, n, 2, 2)`."""
    there = local.points_m + np.einsum("nia,ma->mni", local.drift, drift)
    turned = rotate(there, poses[:, np.newaxis, 2])
    slope = np.zeros((*turned.shape, 6))
    slope[..., 0, 0] = slope[..., 1, 1] = 1.0
    slope[..., 0, 2], slope[..., 1, 2] = -turned[..., 1], turned[..., 0]
    for column in range(3):
        slope[..., 3 + column] = rotate(local.drift[..., column], poses[:, np.newaxis, 2])
    own = local.covariance_m2 + local.wander_m2[:, np.newaxis, np.newaxis] * np.eye(2)
    spread = rotate_covariance(own, np.broadcast_to(poses[:, 2:], turned.shape[:2]))
    return poses[:, np.newaxis, :2] + turned, slope, spread


def _map_variance(index: PatternIndex, row: Whole) -> Floats:
    variance = np.asarray(index.sd_m, dtype=np.float64)[row] ** 2 + _FLOOR_M**2
    return variance[..., np.newaxis, np.newaxis] * np.eye(2)


def _squared(spread: Floats, rest: Floats) -> tuple[Floats, Floats]:
    """Squared Mahalanobis distances, and determinants of the covariances."""
    determinant: Floats = spread[..., 0, 0] * spread[..., 1, 1] - spread[..., 0, 1] ** 2
    x, y = rest[..., 0], rest[..., 1]
    squared = spread[..., 1, 1] * x**2 - 2.0 * spread[..., 0, 1] * x * y + spread[..., 0, 0] * y**2
    return squared / determinant, determinant


def _normal_step(
    index: PatternIndex, local: LocalMap, poses: Floats, drift: Floats, gate_m: float
) -> tuple[Floats, Floats, Floats]:
    """Change `(m, 6)` of poses and errors of the odometry, the normal matrix `(m, 6, 6)`, and how
    many poles `(m,)` are near one of the map, the farther the less."""
    world, slope, spread = _placed(index, local, poses, drift)
    _, row = index.nearest(world, gate_m)
    near = row >= 0
    rest = np.where(near[..., None], index.points_m[row] - world, 0.0)
    spread = spread + _map_variance(index, row)
    squared, _ = _squared(spread, rest)
    share = near / (1.0 + squared / 9.0)
    weight = np.linalg.inv(spread) * share[..., None, None]
    weighted = weight @ slope
    hessian = np.einsum("mnia,mnib->mab", slope, weighted)
    hessian[:, 3:, 3:] += np.linalg.inv(local.drift_covariance)
    hessian[:, range(3), range(3)] += (1e-2, 1e-2, 1.0)  # a pose without poles stays
    pull = np.einsum("mnia,mni->ma", weighted, rest)
    pull[:, 3:] -= drift @ np.linalg.inv(local.drift_covariance)
    step = np.linalg.solve(hessian, pull[..., np.newaxis])[..., 0]
    return step, hessian, share.sum(axis=1)


def _one_to_one(ratio: Floats, row: Whole) -> tuple[Floats, Whole]:
    """Leave a map pole to the seen pole that fits it best."""
    m, n = row.shape
    pose = np.repeat(np.arange(m), n)
    flat, value = row.reshape(-1), ratio.reshape(-1)
    order = np.lexsort((-value, flat, pose))
    repeated = np.zeros(m * n, dtype=bool)
    same = (pose[order][1:] == pose[order][:-1]) & (flat[order][1:] == flat[order][:-1])
    repeated[order[1:]] = same & (flat[order][1:] >= 0)
    value = np.where(repeated, np.log(_LACKING), value)
    flat = np.where(repeated, -1, flat)
    return value.reshape(m, n), flat.reshape(m, n)


def misses(index: PatternIndex, local: LocalMap, judged: Judged) -> Floats:
    """What map poles that should have been seen and were not say against each pose `(m,)`."""
    against = np.zeros(len(judged))
    coverage = Coverage.of(local.ground)
    if coverage is None:
        return against
    for number, pose in enumerate(judged.poses):
        middle = pose[:2] + rotate(coverage.middle_m, pose[2])
        rows = np.setdiff1d(index.within(middle, coverage.radius_m), judged.rows[number])
        points = inverse_transform_points(pose, index.points_m[rows])
        looks = np.minimum(coverage.looks_at(points), _LOOKS_MOST)
        against[number] = np.log(_HIDDEN + (1.0 - _HIDDEN) * (1.0 - _SEEN) ** looks).sum()
    return against
