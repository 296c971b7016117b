"""Global re-localization: the poles around the car, found again as a constellation of the map.

Two poles at a known distance fix a pose up to the pairs of the map at that distance; each such
pose is judged by how many of the other poles then stand on map poles.

Source: the idea of matching local pole patterns is Brenner's (2009); the search is our own.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
import scipy
from numpy.typing import NDArray

from polemap.localize.particle_filter.recent_poles import REMEMBERED_M
from polemap.map.pole_map import PoleMap
from polemap.vehicle.pose import pose_rotation, rigid_fit, transform_points, wrap_angle

Floats = NDArray[np.float64]

_PAIR_SHORTEST_M = 3.0
_PAIR_LONGEST_M = 30.0
_MOST_PAIRS = 12
_MOST_CANDIDATES = 6000
# pairs are enumerated for so much more than is asked for: 6 s at 10 m/s until the next time
_WINDOW_MARGIN_M = 60.0
_SAME_M = 1.5
_SAME_RAD = 0.15

# error of a remembered pole: of its range, of its bearing, and in the map, m; errors of one scan
# stay with the next, so many scans make no better pole
_RANGE_SHARE, _BEARING_RAD, _MAP_M = 0.02, 0.003, 0.1

LOG_ODDS_A_POLE = 1.5
"""What one more pole that fits says for a pose."""


Against = Callable[[Floats], Floats]


@dataclass(frozen=True, slots=True)
class Candidates:
    """Poses `(k, 3)` of the rear axle, best first, with the number of poles that each explains.

    `score` is the sum over these poles of how well they fit, 0 to 1 each, less what else speaks
    against the pose. `covariance` `(k, 3, 3)` is that of the poles that it stands on; of poses that
    were only judged there is none.
    """

    poses: Floats
    matched: NDArray[np.int64]
    score: Floats
    covariance: Floats = field(default_factory=lambda: np.empty((0, 3, 3)))

    def __len__(self) -> int:
        return len(self.poses)

    def at(self, pose: Floats) -> NDArray[np.bool_]:
        """Which of them `(k,)` are nearly the pose `(3,)`."""
        return _same(self.poses, pose)


class ConstellationIndex:
    """Pairs of map poles that stand near each other, sorted by distance.

    Only the pairs around the place that is asked for are enumerated, and kept while the next place
    lies near it; all of them only where the whole map must be searched.
    """

    def __init__(self, pole_map: PoleMap) -> None:
        self._map = pole_map
        self._points = pole_map.points_m.reshape(-1, 2)
        self._centre_m = np.zeros(2)
        self._radius_m = -np.inf
        self._pairs = np.empty((0, 2), dtype=np.int64)
        self._length = np.empty(0)

    def _enumerate(self, centre_m: Floats | None, radius_m: float) -> None:
        """Have every pair whose first pole lies within `radius_m` of a place `(2,)`, or all."""
        if centre_m is None:
            centre_m, radius_m = self._centre_m, np.inf
        moved_m = float(np.hypot(*(centre_m - self._centre_m)))
        if moved_m + radius_m <= self._radius_m:
            return
        self._centre_m, self._radius_m = centre_m.copy(), radius_m + _WINDOW_MARGIN_M
        rows = np.arange(len(self._points))
        if np.isfinite(radius_m):
            rows = self._map.within(centre_m, self._radius_m + _PAIR_LONGEST_M)
        if len(rows) < 2:
            self._pairs, self._length = np.empty((0, 2), dtype=np.int64), np.empty(0)
            return
        tree = scipy.spatial.KDTree(self._points[rows])
        pairs = rows[tree.query_pairs(_PAIR_LONGEST_M, output_type="ndarray")]
        length = np.hypot(*(self._points[pairs[:, 0]] - self._points[pairs[:, 1]]).T)
        order = np.argsort(length, kind="stable")
        order = order[length[order] >= _PAIR_SHORTEST_M]
        self._pairs, self._length = pairs[order], length[order]

    def find(
        self,
        points_vehicle_m: Floats,
        *,
        tolerance_m: float,
        min_poles: int,
        rng: np.random.Generator,
        centre_m: Floats | None = None,
        reach_m: float = np.inf,
        against: Against | None = None,
        most: int = 12,
    ) -> Candidates:
        """Poses from which the map looks like the given poles.

        Args:
            points_vehicle_m: `(k, 2)`.
            tolerance_m: how far a pole may stand from its map pole.
            min_poles: a pose that explains fewer is not returned.
            rng: thins the candidates where a large map offers too many.
            centre_m: `(2,)`, search only poses within `reach_m` of it.
            against: what else speaks against poses, see `judge`.
        """
        points = np.asarray(points_vehicle_m, dtype=np.float64)
        empty = Candidates(np.empty((0, 3)), np.empty(0, dtype=np.int64), np.empty(0))
        if len(points) < min_poles:
            return empty
        poses = self._hypotheses(points, tolerance_m, rng, centre_m, reach_m)
        if len(poses) == 0:
            return empty
        first = self.judge(poses, points, tolerance_m, against)
        good = np.flatnonzero(first.matched >= min_poles)
        order = good[np.argsort(-first.score[good], kind="stable")]
        chosen = _distinct(poses, order, most)
        refined = np.array([self._refined(poses[i], points, tolerance_m) for i in chosen])
        if len(refined) == 0:
            return empty
        found = self.judge(refined, points, tolerance_m, against)
        order = np.argsort(-found.score, kind="stable")
        poses = found.poses[order]
        covariance = np.array([self._covariance(pose, points, tolerance_m) for pose in poses])
        return replace(
            found,
            poses=poses,
            matched=found.matched[order],
            score=found.score[order],
            covariance=covariance,
        )

    def _hypotheses(
        self,
        points: Floats,
        tolerance_m: float,
        rng: np.random.Generator,
        centre_m: Floats | None,
        reach_m: float,
    ) -> Floats:
        a, b = np.triu_indices(len(points), 1)
        baseline = np.hypot(*(points[a] - points[b]).T)
        usable = np.flatnonzero((baseline >= _PAIR_SHORTEST_M) & (baseline <= _PAIR_LONGEST_M))
        # long pairs give the best heading; but no pole may be in all of them
        usable = usable[np.argsort(-baseline[usable], kind="stable")]
        centred = centre_m is not None and np.isfinite(reach_m)
        radius_m = reach_m + REMEMBERED_M + _PAIR_LONGEST_M
        self._enumerate(centre_m if centred else None, radius_m)
        found: list[Floats] = []
        for pair in _spread(a, b, usable, _MOST_PAIRS):
            low, high = np.searchsorted(
                self._length, [baseline[pair] - tolerance_m, baseline[pair] + tolerance_m]
            )
            ends = self._pairs[low:high]
            if centre_m is not None and np.isfinite(reach_m):
                offset = self._points[ends[:, 0]] - centre_m
                ends = ends[np.hypot(*offset.T) < radius_m]
            if len(ends) > 2 * _MOST_CANDIDATES:
                ends = ends[np.sort(rng.choice(len(ends), 2 * _MOST_CANDIDATES, replace=False))]
            both = np.vstack([ends, ends[:, ::-1]])
            found.append(_align(points[a[pair]], points[b[pair]], self._points[both]))
        poses = np.vstack(found) if found else np.empty((0, 3))
        if centre_m is not None and np.isfinite(reach_m):
            poses = poses[np.hypot(*(poses[:, :2] - centre_m).T) <= reach_m]
        if len(poses) > _MOST_CANDIDATES:
            poses = poses[np.sort(rng.choice(len(poses), _MOST_CANDIDATES, replace=False))]
        return poses

    def judge(
        self, poses: Floats, points: Floats, tolerance_m: float, against: Against | None = None
    ) -> Candidates:
        """How many of the points `(k, 2)` in the vehicle frame each of the poses `(n, 3)` explains.

        Args:
            against: minus the log-likelihood `(n,)` that other senses give poses.
        """
        in_map = transform_points(poses[:, np.newaxis], points)
        distance, _ = self._nearest(in_map, tolerance_m)
        fit = np.where(distance < tolerance_m, 1.0 - (distance / tolerance_m) ** 2, 0.0)
        score = fit.sum(axis=1)
        if against is not None:
            score = score - against(poses) / LOG_ODDS_A_POLE
        return Candidates(poses, (distance < tolerance_m).sum(axis=1).astype(np.int64), score)

    def _nearest(self, points: Floats, tolerance_m: float) -> tuple[Floats, NDArray[np.int64]]:
        """Distance to and row of the nearest map pole; infinite beyond the tolerance."""
        distance, row = self._map.nearest(points, tolerance_m)
        return distance.reshape(points.shape[:-1]), row.reshape(points.shape[:-1])

    def _refined(self, pose: Floats, points: Floats, tolerance_m: float) -> Floats:
        """Least-squares pose over the poles that the candidate explains."""
        for _ in range(3):
            there = transform_points(pose, points)
            distance, row = self._nearest(there, tolerance_m)
            near = distance < tolerance_m
            if near.sum() < 2:
                break
            pose = rigid_fit(points[near], self._points[row[near]])
        return pose

    def _covariance(self, pose: Floats, points: Floats, tolerance_m: float) -> Floats:
        """Of a pose that stands on the poles that it explains, `(3, 3)` in the map.

        Two poles side by side far ahead leave the car a wide arc around them.
        """
        distance, _ = self._nearest(transform_points(pose, points), tolerance_m)
        near = points[distance < tolerance_m]
        ranges = np.maximum(np.hypot(*near.T), 1.0)
        ahead = near / ranges[:, None]
        axes = np.stack([ahead, np.stack([-ahead[:, 1], ahead[:, 0]], axis=1)], axis=1)
        # along and across the line of sight, for a step of the car ahead, aside, and a turn
        design = np.concatenate([axes, np.stack([0.0 * ranges, ranges], axis=1)[..., None]], axis=2)
        sd = np.stack([_RANGE_SHARE * ranges, _BEARING_RAD * ranges], axis=1)
        information = np.einsum("nai,na,naj->ij", design, 1.0 / (sd**2 + _MAP_M**2), design)
        turn = pose_rotation(pose[2])
        known = information + np.diag(1.0 / np.square([_SAME_M, _SAME_M, _SAME_RAD]))
        return np.asarray(turn @ np.linalg.inv(known) @ turn.T)


def _spread(
    a: NDArray[np.int64], b: NDArray[np.int64], order: NDArray[np.int64], most: int
) -> list[int]:
    """The first `most` pairs in which no pole stands more than three times."""
    uses: dict[int, int] = {}
    chosen: list[int] = []
    for pair in order:
        i, j = int(a[pair]), int(b[pair])
        if uses.get(i, 0) < 3 and uses.get(j, 0) < 3:
            uses[i], uses[j] = uses.get(i, 0) + 1, uses.get(j, 0) + 1
            chosen.append(int(pair))
            if len(chosen) == most:
                break
    return chosen


def _align(first: Floats, second: Floats, ends: Floats) -> Floats:
    """Poses `(k, 3)` that put two vehicle points onto pairs of map points `(k, 2, 2)`."""
    return rigid_fit([first, second], ends)


def _distinct(poses: Floats, order: NDArray[np.int64], most: int) -> list[int]:
    """Of the ordered poses the first `most` that are not nearly the same."""
    chosen: list[int] = []
    for i in order[:2000]:
        if chosen and _same(poses[chosen], poses[i]).any():
            continue
        chosen.append(int(i))
        if len(chosen) == most:
            break
    return chosen


def _same(poses: Floats, pose: Floats) -> NDArray[np.bool_]:
    offset = poses - pose
    near = np.hypot(offset[:, 0], offset[:, 1]) < _SAME_M
    return np.asarray(near & (np.abs(wrap_angle(offset[:, 2])) < _SAME_RAD))
