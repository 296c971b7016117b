"""The detections of one drive to traversal landmarks: robust means, a row a pole a traversal.

Within a traversal (a stretch in which a pole stays in sight) the reference hardly changes its
error, so that the detections agree better with each other than with the truth. Their scatter
therefore says how well the detector works; what the reference adds is kept apart until traversals
are merged.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from polemap.build.config import MappingConfig
from polemap.build.constants import GATE_PROBABILITY, GATE_SLACK_M, TRAVERSAL_GAP_S
from polemap.build.georeference import MapDetections
from polemap.build.robust_means import mean_of_detections, median_and_sd
from polemap.drivelog.columns import Columns
from polemap.vehicle.kalman import chi_square_quantile

Floats = NDArray[np.float64]
Whole = NDArray[np.int64]

_LAGS = 30


@dataclass(frozen=True, slots=True)
class TraversalLandmarks(Columns):
    """What one drive says about each pole it passed; every array has a row a landmark.

    Attributes:
        drive: `(n,)` name of the drive.
        start_s: `(n,)` first stamp of that drive: the order of drives.
        kind: `(n,)` a `LandmarkKind`.
        points_m: `(n, 2)`.
        covariance_m2: `(n, 2, 2)` of the detector alone.
        reference_sd_m: `(n,)` as the reference states it.
        gain_m_per_px: `(n, 2)` how far an error of one pixel of disparity, the same in all scans,
            moves it.
        aligned_sd_m: `(n,)` what levelling of a drifting reference leaves, an axis; zero without.
        lever_m: `(n,)` mean range: what the reference's yaw acts on.
        direction_rad: `(n,)` mean direction from the car to the pole, from grid east.
        first_s, last_s: `(n,)` stamps of the first and last detection.
        directions: `(n,)` bit field of the eighths of the circle it was seen from.
        range_min_m, range_max_m: `(n,)` from how near to how far it was seen.
        width_sd_m, height_sd_m: `(n,)` robust scatter of single detections.
    """

    drive: NDArray[np.str_]
    start_s: Floats
    kind: NDArray[np.int8]
    points_m: Floats
    covariance_m2: Floats
    reference_sd_m: Floats
    gain_m_per_px: Floats
    aligned_sd_m: Floats
    lever_m: Floats
    direction_rad: Floats
    width_m: Floats
    width_sd_m: Floats
    height_m: Floats
    height_sd_m: Floats
    observations: Whole
    first_s: Floats
    last_s: Floats
    directions: Whole
    range_min_m: Floats
    range_max_m: Floats


def associate(detections: MapDetections, config: MappingConfig) -> Whole:
    """Number of the traversal landmark that each detection belongs to, `(n,)`.

    Each scan is matched one-to-one with the landmarks that are in sight (optimal assignment on
    gated Mahalanobis distances within a kind), so that two poles beside each other stay two.
    """
    gate = chi_square_quantile(GATE_PROBABILITY, 2)
    numbers = np.full(len(detections), -1, dtype=np.int64)
    open_landmarks = _OpenLandmarks(len(detections))
    starts = np.searchsorted(detections.scan, np.arange(len(detections.views) + 1))
    for scan in np.unique(detections.scan):
        rows = np.arange(starts[scan], starts[scan + 1])
        points, covariance = detections.points_m[rows], detections.covariance_m2[rows]
        kind = detections.kind[rows]
        open_landmarks.close_before(float(detections.views.stamp_s[scan]) - TRAVERSAL_GAP_S)
        distance = open_landmarks.distances(points, covariance, kind, GATE_SLACK_M)
        chosen = _assign(distance, gate)
        numbers[rows] = open_landmarks.fuse_scan(
            points, covariance, kind, chosen, float(detections.views.stamp_s[scan])
        )
    return numbers


def _assign(distance: Floats, gate: float) -> Whole:
    """Column for each row of the gated costs, -1 where none fits; optimal over the whole scan."""
    chosen = np.full(len(distance), -1, dtype=np.int64)
    if not distance.shape[1]:
        return chosen
    inside = distance < gate
    rows, columns = np.flatnonzero(inside.any(axis=1)), np.flatnonzero(inside.any(axis=0))
    if not len(rows):
        return chosen
    cost = np.where(inside, distance, 10.0 * gate)[np.ix_(rows, columns)]
    first, second = scipy.optimize.linear_sum_assignment(cost)
    fits = cost[first, second] < gate
    chosen[rows[first[fits]]] = columns[second[fits]]
    return chosen


class _OpenLandmarks:
    """The landmarks of a drive while their traversals go on, in information form."""

    def __init__(self, capacity: int) -> None:
        self._information = np.zeros((capacity, 3))  # ee, nn, en
        self._vector = np.zeros((capacity, 2))
        self._best = np.full((capacity, 3), np.inf)  # covariance of the best detection
        self._kind = np.zeros(capacity, dtype=np.int8)
        self._last_s = np.full(capacity, -np.inf)
        self._active = np.empty(0, dtype=np.int64)
        self._count = 0

    def close_before(self, before_s: float) -> None:
        """Close the traversals of landmarks that were last seen before."""
        self._active = self._active[self._last_s[self._active] >= before_s]

    def distances(
        self, points: Floats, covariance: Floats, kind: NDArray[np.int8], slack_m: float
    ) -> Floats:
        """Squared Mahalanobis distances `(rows, active)` of a scan's detections, or infinity."""
        info = self._information[self._active]
        det = info[:, 0] * info[:, 1] - info[:, 2] ** 2
        vector = self._vector[self._active]
        east = (info[:, 1] * vector[:, 0] - info[:, 2] * vector[:, 1]) / det
        north = (info[:, 0] * vector[:, 1] - info[:, 2] * vector[:, 0]) / det
        # neighbouring detections err alike: a landmark is not trusted below half of its best one
        own = 0.25 * self._best[self._active] + np.array([slack_m**2, slack_m**2, 0.0])
        ee = covariance[:, None, 0, 0] + own[None, :, 0]
        nn = covariance[:, None, 1, 1] + own[None, :, 1]
        en = covariance[:, None, 0, 1] + own[None, :, 2]
        de, dn = points[:, None, 0] - east, points[:, None, 1] - north
        squared = (de**2 * nn - 2.0 * de * dn * en + dn**2 * ee) / (ee * nn - en**2)
        return np.where(kind[:, None] == self._kind[self._active], squared, np.inf)

    def fuse_scan(
        self,
        points: Floats,
        covariance: Floats,
        kind: NDArray[np.int8],
        chosen: Whole,
        stamp_s: float,
    ) -> Whole:
        """Add a scan's detections to their landmarks, or begin new ones; their numbers."""
        fresh = np.flatnonzero(chosen < 0)
        numbers = np.empty(len(points), dtype=np.int64)
        numbers[chosen >= 0] = self._active[chosen[chosen >= 0]]
        numbers[fresh] = self._count + np.arange(len(fresh))
        self._count += len(fresh)
        self._active = np.concatenate([self._active, numbers[fresh]])
        ee, nn, en = covariance[:, 0, 0], covariance[:, 1, 1], covariance[:, 0, 1]
        det = ee * nn - en**2
        information = np.stack([nn / det, ee / det, -en / det], axis=1)
        east = information[:, 0] * points[:, 0] + information[:, 2] * points[:, 1]
        north = information[:, 2] * points[:, 0] + information[:, 1] * points[:, 1]
        # one detection a landmark a scan, so that plain indexing adds each of them
        self._information[numbers] += information
        self._vector[numbers] += np.stack([east, north], axis=1)
        better = ee + nn < self._best[numbers, 0] + self._best[numbers, 1]
        self._best[numbers[better]] = np.stack([ee, nn, en], axis=1)[better]
        self._kind[numbers] = kind
        self._last_s[numbers] = stamp_s
        return numbers


def correlation_length(detections: MapDetections, numbers: Whole, points_m: Floats) -> float:
    """In how many successive detections the detector's error repeats: 1 for white noise.

    The integrated autocorrelation, `1 + 2 sum rho_k` up to the first lag without correlation, of
    the detections' distances from their landmark, pooled over all landmarks.
    """
    residual = detections.points_m - points_m[numbers]
    order = np.lexsort((detections.scan, numbers))
    residual, owner = residual[order], numbers[order]
    scale = np.sqrt(np.trace(detections.covariance_m2[order], axis1=1, axis2=2) / 2.0)
    residual = residual / scale[:, None]
    size = np.linalg.norm(residual, axis=1)
    residual = residual * np.minimum(1.0, 3.0 / np.maximum(size, 1e-12))[:, None]
    power = float(np.mean(residual**2)) if len(residual) else 0.0
    total = 1.0
    for lag in range(1, _LAGS):
        same = owner[lag:] == owner[:-lag]
        if np.count_nonzero(same) < 50 or power == 0.0:
            break
        rho = float(np.mean((residual[lag:] * residual[:-lag])[same])) / power
        if rho <= 0.05:
            break
        total += 2.0 * rho
    return total


def average_traversals(
    detections: MapDetections, numbers: Whole
) -> tuple[TraversalLandmarks, Whole]:
    """Robust mean of the detections of every traversal landmark.

    Returns:
        The landmarks, and for each detection the row of its landmark `(n,)`.
    """
    present, rows = np.unique(numbers, return_inverse=True)
    n = len(present)
    point, covariance, weight, gain = mean_of_detections(
        detections.points_m, detections.covariance_m2, detections.gain_m_per_px, rows, n
    )
    repeats = correlation_length(detections, rows, point)
    count = np.bincount(rows, minlength=n).astype(np.float64)
    # n detections are worth n / repeats independent ones, but never less than one
    covariance = covariance * np.minimum(repeats, count)[:, None, None]
    direction = np.arctan2(
        np.bincount(rows, weight * np.sin(detections.direction_rad), n),
        np.bincount(rows, weight * np.cos(detections.direction_rad), n),
    )
    eighth = np.floor((detections.direction_rad + np.pi) / (np.pi / 4.0)).astype(np.int64) % 8
    directions = np.zeros(n, dtype=np.int64)
    np.bitwise_or.at(directions, rows, 1 << eighth)
    total = np.bincount(rows, weight, n)
    width, width_sd = median_and_sd(detections.width_m, rows, n)
    height, height_sd = median_and_sd(detections.height_m, rows, n)
    kind = np.zeros(n, dtype=np.int8)
    kind[rows] = detections.kind
    first, last = np.full(n, np.inf), np.full(n, -np.inf)
    np.minimum.at(first, rows, detections.stamp_s)
    np.maximum.at(last, rows, detections.stamp_s)
    nearest, farthest = np.full(n, np.inf), np.zeros(n)
    np.minimum.at(nearest, rows, detections.range_m)
    np.maximum.at(farthest, rows, detections.range_m)
    landmarks = TraversalLandmarks(
        drive=np.full(n, detections.drive),
        start_s=np.full(n, detections.start_s),
        kind=kind,
        points_m=point,
        covariance_m2=covariance,
        reference_sd_m=np.bincount(rows, weight * detections.reference_sd_m, n) / total,
        gain_m_per_px=gain,
        aligned_sd_m=np.zeros(n),
        lever_m=np.bincount(rows, weight * detections.range_m, n) / total,
        direction_rad=direction,
        width_m=width,
        width_sd_m=width_sd,
        height_m=height,
        height_sd_m=height_sd,
        observations=count.astype(np.int64),
        first_s=first,
        last_s=last,
        directions=directions,
        range_min_m=nearest,
        range_max_m=farthest,
    )
    return landmarks, rows.astype(np.int64)


def cannot_link_pairs(rows: Whole, scan: Whole, n: int) -> NDArray[np.int64]:
    """Pairs `(k, 2)`, smaller row first, of landmarks that were seen in one scan at least twice.

    Two things seen at the same time are two things, however near they stand.
    """
    order = np.argsort(scan, kind="stable")
    pairs: list[Whole] = []
    sorted_rows, sorted_scan = rows[order], scan[order]
    most = int(np.bincount(scan).max()) if len(scan) else 0
    for step in range(1, most):
        same = sorted_scan[step:] == sorted_scan[:-step]
        if not same.any():
            break
        pair = np.stack([sorted_rows[step:][same], sorted_rows[:-step][same]], axis=1)
        pairs.append(np.sort(pair, axis=1))
    if not pairs:
        return np.empty((0, 2), dtype=np.int64)
    keys = np.concatenate(pairs)
    keys = keys[keys[:, 0] != keys[:, 1]]
    code, count = np.unique(keys[:, 0] * n + keys[:, 1], return_counts=True)
    code = code[count >= 2]
    return np.stack([code // n, code % n], axis=1)
