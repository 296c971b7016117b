"""Traversal landmarks of all drives to poles: clustering, and fusion with honest covariances.

Errors are kept apart by what shares them: the detector's (white within a traversal), the
reference's that a traversal shares, and the one that a whole drive shares. How large the latter two
are is measured where traversals or drives meet, and taken as the reference states it where they do
not. A stereo camera's disparity errs too: by a part that all scans of one traversal share at a
pole, and by one (calibration) that everything shares. It moves a pole by its gain, along the mean
ray; the common part is carried through all means as a parameter that is considered but not
estimated (Schmidt), so that two traversals from opposite sides cancel it and two from one side do
not.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from polemap.build.config import MappingConfig
from polemap.build.constants import (
    DISPARITY_COMMON_SD_PX,
    DISPARITY_TRAVERSAL_SD_PX,
    MERGE_PROBABILITY,
    MERGE_SLACK_M,
    SYSTEMATIC_SD_M,
)
from polemap.build.robust_means import weighted_mean
from polemap.build.traversals import TraversalLandmarks
from polemap.vehicle.kalman import chi_square_gate
from polemap.vehicle.pose import rotate

Floats = NDArray[np.float64]
Whole = NDArray[np.int64]

_PAIRS_MIN = 20  # fewer pairs do not measure an error


@dataclass(frozen=True, slots=True)
class ReferenceError:
    """Standard deviations an axis that traversals and drives share; `pairs` that measured them."""

    traversal_sd_m: float | None
    drive_sd_m: float
    traversal_pairs: int
    drive_pairs: int


@dataclass(frozen=True, slots=True)
class Merged:
    """Poles from clusters of traversal landmarks; `owner` `(n,)` is the pole of each landmark."""

    points_m: Floats
    covariance_m2: Floats
    owner: Whole
    reference_error: ReferenceError

    def __len__(self) -> int:
        return len(self.points_m)


def shared_covariance(
    landmarks: TraversalLandmarks, config: MappingConfig, traversal_sd_m: float | None
) -> Floats:
    """Reference and systematic errors `(n, 2, 2)` that all detections of a traversal share."""
    sd = (
        landmarks.reference_sd_m
        if traversal_sd_m is None
        else np.full(len(landmarks), traversal_sd_m)
    )
    across = rotate([0.0, 1.0], landmarks.direction_rad)
    turn = (config.reference_yaw_sd_rad * landmarks.lever_m)[:, None, None] ** 2
    plain = (sd**2 + SYSTEMATIC_SD_M**2)[:, None, None] * np.eye(2)
    gain = landmarks.gain_m_per_px
    along = DISPARITY_TRAVERSAL_SD_PX**2 * gain[:, :, None] * gain[:, None, :]
    return np.asarray(plain + turn * across[:, :, None] * across[:, None, :] + along)


def _common(gain_m_per_px: Floats) -> Floats:
    """Covariance `(n, 2, 2)` from the disparity error that everything shares."""
    one = DISPARITY_COMMON_SD_PX * gain_m_per_px
    return np.asarray(one[:, :, None] * one[:, None, :])


def shared_sd(offset_m: Floats, covariance_m2: Floats, most_m: float) -> float:
    """The sd an axis that has to be added to `covariance_m2` `(k, 2, 2)` to explain offsets.

    From the median of the squared Mahalanobis distances, so that wrong pairs hardly matter.
    """

    def median(sd: float) -> float:
        spread = covariance_m2 + np.eye(2) * sd**2
        solved = np.linalg.solve(spread, offset_m[..., None])[..., 0]
        return float(np.median(np.sum(offset_m * solved, axis=1)))

    low, high, honest = 0.0, most_m, chi_square_gate(0.5, 2)
    if median(low) <= honest:
        return 0.0
    for _ in range(40):
        middle = (low + high) / 2.0
        low, high = (middle, high) if median(middle) > honest else (low, middle)
    return (low + high) / 2.0


def close_pairs(points_m: Floats, most_m: float) -> Whole:
    """Pairs `(k, 2)` of points no farther apart, smaller row first.

    Each distance is compared by itself: whole branches of the tree are accepted by their bounds,
    which may round otherwise where other points stand in it.
    """
    if len(points_m) < 2:
        return np.empty((0, 2), dtype=np.int64)
    pairs = scipy.spatial.KDTree(points_m).query_pairs(1.000001 * most_m, output_type="ndarray")
    pairs = np.sort(pairs.reshape(-1, 2).astype(np.int64), axis=1)
    offset = points_m[pairs[:, 0]] - points_m[pairs[:, 1]]
    return np.asarray(pairs[np.hypot(offset[:, 0], offset[:, 1]) <= most_m])


def _of_one_kind(pairs: Whole, landmarks: TraversalLandmarks) -> Whole:
    return np.asarray(pairs[landmarks.kind[pairs[:, 0]] == landmarks.kind[pairs[:, 1]]])


def revisit_pairs(
    landmarks: TraversalLandmarks, config: MappingConfig, cannot_link: Whole
) -> Whole:
    """Pairs `(k, 2)` of landmarks that are each other's nearest and may be one pole."""
    solid = np.flatnonzero(landmarks.observations >= config.observations_min)
    if len(solid) < 2:
        return np.empty((0, 2), dtype=np.int64)
    pairs = _of_one_kind(
        solid[close_pairs(landmarks.points_m[solid], config.merge_max_m)], landmarks
    )
    pairs = pairs[~_listed(pairs, cannot_link, len(landmarks))]
    length = np.linalg.norm(
        landmarks.points_m[pairs[:, 0]] - landmarks.points_m[pairs[:, 1]], axis=1
    )
    nearest = np.full(len(landmarks), np.inf)
    for side in (0, 1):
        np.minimum.at(nearest, pairs[:, side], length)
    mutual = (length <= nearest[pairs[:, 0]]) & (length <= nearest[pairs[:, 1]])
    return np.asarray(pairs[mutual])


def _listed(pairs: Whole, listed: Whole, n: int) -> NDArray[np.bool_]:
    if not len(pairs) or not len(listed):
        return np.zeros(len(pairs), dtype=bool)
    low, high = pairs.min(axis=1), pairs.max(axis=1)
    return np.isin(low * n + high, listed[:, 0] * n + listed[:, 1])


def measure_reference(
    landmarks: TraversalLandmarks, config: MappingConfig, pairs: Whole
) -> ReferenceError:
    """How far traversals of a drive, and drives, disagree about the same poles.

    Args:
        landmarks: of all drives.
        config: settings.
        pairs: its `revisit_pairs` `(k, 2)`.
    """
    first, second = pairs[:, 0], pairs[:, 1]
    offset = landmarks.points_m[first] - landmarks.points_m[second]
    own = landmarks.covariance_m2[first] + landmarks.covariance_m2[second]
    rest = shared_covariance(landmarks, config, 0.0)
    own = own + rest[first] + rest[second]
    # what everything shares moves both: only the difference of their gains tells them apart
    own = own + _common(landmarks.gain_m_per_px[first] - landmarks.gain_m_per_px[second])
    same = landmarks.drive[first] == landmarks.drive[second]
    traversal_sd = None
    if np.count_nonzero(same) >= _PAIRS_MIN:
        traversal_sd = shared_sd(offset[same], own[same], config.merge_max_m) / np.sqrt(2.0)
    drive_sd, other = 0.0, ~same
    if np.count_nonzero(other) >= _PAIRS_MIN:
        with_traversal = own[other]
        if traversal_sd is not None:
            with_traversal = with_traversal + np.eye(2) * 2.0 * traversal_sd**2
            drive_sd = shared_sd(offset[other], with_traversal, config.merge_max_m) / np.sqrt(2.0)
        else:
            # no traversal meets another of its drive: all disagreement is the traversals' own
            traversal_sd = shared_sd(offset[other], with_traversal, config.merge_max_m) / np.sqrt(
                2.0
            )
    return ReferenceError(
        traversal_sd, drive_sd, int(np.count_nonzero(same)), int(np.count_nonzero(other))
    )


def cluster(
    landmarks: TraversalLandmarks, config: MappingConfig, cannot_link: Whole, error: ReferenceError
) -> Whole:
    """Cluster number of each landmark `(n,)`, numbered from south to north.

    Pairs are joined from the most to the least alike, as long as the clusters' means stay within
    `merge_max_m` and the gate, and no two of their members were seen side by side.
    """
    n = len(landmarks)
    if not n:
        return np.empty(0, dtype=np.int64)
    spread = landmarks.covariance_m2 + shared_covariance(landmarks, config, error.traversal_sd_m)
    spread = spread + np.eye(2) * (error.drive_sd_m**2 + MERGE_SLACK_M**2)
    spread = spread + _common(landmarks.gain_m_per_px)
    pairs = _of_one_kind(close_pairs(landmarks.points_m, config.merge_max_m), landmarks)
    offset = landmarks.points_m[pairs[:, 0]] - landmarks.points_m[pairs[:, 1]]
    both = spread[pairs[:, 0]] + spread[pairs[:, 1]]
    likeness = np.sum(offset * np.linalg.solve(both, offset[..., None])[..., 0], axis=1)
    gate = chi_square_gate(MERGE_PROBABILITY, 2)
    usable = (likeness <= gate) & ~_listed(pairs, cannot_link, n)
    pairs, likeness = pairs[usable], likeness[usable]
    # ties are broken by place, never by row: the order in which drives come must not matter
    middle = (landmarks.points_m[pairs[:, 0]] + landmarks.points_m[pairs[:, 1]]) / 2.0
    order = np.lexsort((middle[:, 0], middle[:, 1], likeness))
    joiner = _Joiner(landmarks.points_m, spread, cannot_link, gate, config.merge_max_m)
    for first, second in pairs[order].tolist():
        joiner.join(first, second)
    return number_from_south(joiner.roots(), landmarks.points_m)


def number_from_south(root: Whole, points: Floats) -> Whole:
    """Clusters renumbered by the place of their southernmost member."""
    if not len(root):
        return np.empty(0, dtype=np.int64)
    order = np.lexsort((points[:, 0], points[:, 1]))
    _, first = np.unique(root[order], return_index=True)
    ranked = root[order][np.sort(first)]
    number = np.empty(int(root.max()) + 1, dtype=np.int64)
    number[ranked] = np.arange(len(ranked))
    return number[root]


class _Joiner:
    """Union-find that keeps each cluster's mean, and refuses to join what must not be linked."""

    def __init__(
        self, points: Floats, spread: Floats, cannot_link: Whole, gate: float, most_m: float
    ) -> None:
        self._parent = list(range(len(points)))
        self._information = list(np.linalg.inv(spread))
        self._vector = [a @ b for a, b in zip(self._information, points, strict=True)]
        self._gate, self._most_m = gate, most_m
        self._forbidden: dict[int, set[int]] = {}
        for first, second in cannot_link.tolist():
            self._forbidden.setdefault(first, set()).add(second)
            self._forbidden.setdefault(second, set()).add(first)

    def _find(self, row: int) -> int:
        while self._parent[row] != row:
            self._parent[row] = self._parent[self._parent[row]]
            row = self._parent[row]
        return row

    def join(self, first: int, second: int) -> None:
        a, b = self._find(first), self._find(second)
        if a == b or b in self._forbidden.get(a, ()):
            return
        covariance_a, covariance_b = (np.linalg.inv(self._information[k]) for k in (a, b))
        offset = covariance_a @ self._vector[a] - covariance_b @ self._vector[b]
        distance = float(offset @ np.linalg.solve(covariance_a + covariance_b, offset))
        if distance > self._gate or float(np.hypot(*offset)) > self._most_m:
            return
        self._parent[b] = a
        self._information[a] = self._information[a] + self._information[b]
        self._vector[a] = self._vector[a] + self._vector[b]
        for other in self._forbidden.pop(b, set()):
            self._forbidden[other].discard(b)
            self._forbidden[other].add(a)
            self._forbidden.setdefault(a, set()).add(other)

    def roots(self) -> Whole:
        return np.array([self._find(row) for row in range(len(self._parent))], dtype=np.int64)


def fuse(
    landmarks: TraversalLandmarks, owner: Whole, config: MappingConfig, error: ReferenceError
) -> tuple[Floats, Floats]:
    """Means `(m, 2)` and covariances `(m, 2, 2)` of the clusters.

    Traversals of one drive are averaged first, each with its own and its shared error; then the
    drives, each with the drive's shared error.
    """
    own = landmarks.covariance_m2 + shared_covariance(landmarks, config, error.traversal_sd_m)
    names, drive = np.unique(landmarks.drive, return_inverse=True)
    groups, group = np.unique(owner * len(names) + drive, return_inverse=True)
    point, covariance, gain = weighted_mean(
        landmarks.points_m, own, group, len(groups), landmarks.gain_m_per_px
    )
    covariance = covariance + np.eye(2) * error.drive_sd_m**2
    poles = groups // len(names)
    clusters = int(owner.max()) + 1 if len(owner) else 0
    point, covariance, gain = weighted_mean(point, covariance, poles, clusters, gain)
    # no repetition averages away what the detector does wrong each time
    covariance = covariance + np.eye(2) * SYSTEMATIC_SD_M**2 + _common(gain)
    # traversals that were laid onto each other are off together
    number = np.maximum(np.bincount(owner, minlength=clusters), 1)
    off = np.bincount(owner, landmarks.aligned_sd_m**2, clusters) / number
    return point, covariance + off[:, None, None] * np.eye(2)
