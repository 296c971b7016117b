"""The sightings of one drive to pass landmarks: one row a pole a pass, robustly averaged.

Within a pass (a stretch in which a pole stays in sight) the reference hardly changes its error, so
that the sightings agree better with each other than with the truth. Their scatter therefore
says how well the detector works; what the reference adds is kept apart until passes are merged.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment
from scipy.stats import chi2

from polemap.mapping_config import MappingConfig
from polemap.sightings import Sightings

Floats = NDArray[np.float64]
Whole = NDArray[np.int64]

_HUBER = 2.0  # Mahalanobis distance from which a sighting loses weight
_LAGS = 30


@dataclass(frozen=True, slots=True)
class PassLandmarks:
    """What one drive says about each pole it passed; every array has a row a landmark.

    Attributes:
        drive: `(n,)` name of the drive.
        start_s: `(n,)` first stamp of that drive: the order of drives.
        points_m: `(n, 2)`.
        covariance_m2: `(n, 2, 2)` of the detector alone.
        reference_sd_m: `(n,)` as the reference states it.
        lever_m: `(n,)` mean range: what the reference's yaw acts on.
        direction_rad: `(n,)` mean direction from the car to the pole, from grid east.
        first_s, last_s: `(n,)` stamps of the first and last sighting.
        directions: `(n,)` bit field of the eighths of the circle it was seen from.
        range_min_m: `(n,)`.
    """

    drive: NDArray[np.str_]
    start_s: Floats
    points_m: Floats
    covariance_m2: Floats
    reference_sd_m: Floats
    lever_m: Floats
    direction_rad: Floats
    width_m: Floats
    width_sd_m: Floats
    height_m: Floats
    observations: Whole
    first_s: Floats
    last_s: Floats
    directions: Whole
    range_min_m: Floats

    def __len__(self) -> int:
        return len(self.points_m)


@dataclass(slots=True)
class _Open:
    """A landmark while its pass goes on; information form."""

    number: int
    information: Floats
    vector: Floats
    best_m2: Floats
    last_s: float

    @property
    def point(self) -> Floats:
        return np.asarray(np.linalg.solve(self.information, self.vector))


def associate(sightings: Sightings, config: MappingConfig) -> Whole:
    """Number of the pass landmark that each sighting belongs to, `(n,)`.

    Each look is matched one-to-one with the landmarks that are in sight (optimal assignment on
    gated Mahalanobis distances), so that two poles beside each other stay two.
    """
    gate = float(chi2.ppf(config.gate_probability, 2))
    slack = np.eye(2) * config.gate_slack_m**2
    numbers = np.full(len(sightings), -1, dtype=np.int64)
    open_landmarks: list[_Open] = []
    count = 0
    starts = np.searchsorted(sightings.look, np.arange(len(sightings.looks) + 1))
    for look in np.unique(sightings.look):
        rows = np.arange(starts[look], starts[look + 1])
        stamp = float(sightings.looks.stamp_s[look])
        open_landmarks = [o for o in open_landmarks if stamp - o.last_s <= config.pass_gap_s]
        for row, landmark in _match(sightings, rows, open_landmarks, gate, slack):
            if landmark is None:
                zero = np.zeros((2, 2))
                landmark = _Open(count, zero, np.zeros(2), sightings.covariance_m2[row], stamp)
                open_landmarks.append(landmark)
                count += 1
            _absorb(landmark, sightings.points_m[row], sightings.covariance_m2[row], stamp)
            numbers[row] = landmark.number
    return numbers


def _absorb(landmark: _Open, point: Floats, covariance: Floats, stamp: float) -> None:
    information = np.linalg.inv(covariance)
    landmark.information = landmark.information + information
    landmark.vector = landmark.vector + information @ point
    landmark.last_s = stamp
    if np.trace(covariance) < np.trace(landmark.best_m2):
        landmark.best_m2 = covariance


def _match(
    sightings: Sightings, rows: Whole, landmarks: list[_Open], gate: float, slack: Floats
) -> list[tuple[int, _Open | None]]:
    """Each row of a look with its landmark, or with None where a new one begins."""
    if not landmarks:
        return [(int(row), None) for row in rows]
    points = np.stack([landmark.point for landmark in landmarks])
    # neighbouring sightings err alike: a landmark is not trusted below half of its best one
    own = np.stack([landmark.best_m2 for landmark in landmarks]) * 0.25
    offset = sightings.points_m[rows][:, None] - points[None]
    spread = sightings.covariance_m2[rows][:, None] + own[None] + slack
    distance = np.einsum("ijk,ijk->ij", offset, np.linalg.solve(spread, offset[..., None])[..., 0])
    cost = np.where(distance < gate, distance, 10.0 * gate)
    chosen = dict(zip(*(side.tolist() for side in linear_sum_assignment(cost)), strict=True))
    return [
        (int(row), landmarks[chosen[i]] if i in chosen and cost[i, chosen[i]] < gate else None)
        for i, row in enumerate(rows)
    ]


def correlation_length(sightings: Sightings, numbers: Whole, points_m: Floats) -> float:
    """In how many successive sightings the detector's error repeats: 1 for white noise.

    The integrated autocorrelation, `1 + 2 sum rho_k` up to the first lag without correlation, of
    the sightings' distances from their landmark, pooled over all landmarks.
    """
    residual = sightings.points_m - points_m[numbers]
    order = np.lexsort((sightings.look, numbers))
    residual, owner = residual[order], numbers[order]
    scale = np.sqrt(np.trace(sightings.covariance_m2[order], axis1=1, axis2=2) / 2.0)
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


def average_passes(sightings: Sightings, numbers: Whole) -> tuple[PassLandmarks, Whole]:
    """Robust mean of the sightings of every pass landmark.

    Returns:
        The landmarks, and for each sighting the row of its landmark `(n,)`.
    """
    present, rows = np.unique(numbers, return_inverse=True)
    n = len(present)
    point, covariance, weight = _robust_mean(sightings, rows, n)
    repeats = correlation_length(sightings, rows, point)
    count = np.bincount(rows, minlength=n).astype(np.float64)
    # n sightings are worth n / repeats independent ones, but never less than one
    covariance = covariance * np.minimum(repeats, count)[:, None, None]
    direction = np.arctan2(
        np.bincount(rows, weight * np.sin(sightings.direction_rad), n),
        np.bincount(rows, weight * np.cos(sightings.direction_rad), n),
    )
    eighth = np.floor((sightings.direction_rad + np.pi) / (np.pi / 4.0)).astype(np.int64) % 8
    directions = np.zeros(n, dtype=np.int64)
    np.bitwise_or.at(directions, rows, 1 << eighth)
    total = np.bincount(rows, weight, n)
    width, width_sd = _median_and_sd(sightings.width_m, rows, n)
    first, last = np.full(n, np.inf), np.full(n, -np.inf)
    np.minimum.at(first, rows, sightings.stamp_s)
    np.maximum.at(last, rows, sightings.stamp_s)
    nearest = np.full(n, np.inf)
    np.minimum.at(nearest, rows, sightings.range_m)
    landmarks = PassLandmarks(
        drive=np.full(n, sightings.drive),
        start_s=np.full(n, sightings.start_s),
        points_m=point,
        covariance_m2=covariance,
        reference_sd_m=np.bincount(rows, weight * sightings.reference_sd_m, n) / total,
        lever_m=np.bincount(rows, weight * sightings.range_m, n) / total,
        direction_rad=direction,
        width_m=width,
        width_sd_m=width_sd,
        height_m=_median_and_sd(sightings.height_m, rows, n)[0],
        observations=count.astype(np.int64),
        first_s=first,
        last_s=last,
        directions=directions,
        range_min_m=nearest,
    )
    return landmarks, rows.astype(np.int64)


def _robust_mean(sightings: Sightings, rows: Whole, n: int) -> tuple[Floats, Floats, Floats]:
    """Iteratively reweighted mean (Huber) of points with covariances, for all landmarks at once.

    Returns:
        Points `(n, 2)`, covariances `(n, 2, 2)` as if sightings were independent, scaled up where
        they scatter more than they claim, and the weight of each sighting `(len(rows),)`.
    """
    information = np.linalg.inv(sightings.covariance_m2)
    point = (
        np.stack([np.bincount(rows, sightings.points_m[:, axis], n) for axis in (0, 1)], axis=1)
        / np.bincount(rows, minlength=n)[:, None]
    )
    weight = np.ones(len(rows))
    total = np.zeros((n, 2, 2))
    distance = np.zeros(len(rows))
    for _ in range(8):
        total = np.zeros((n, 2, 2))
        vector = np.zeros((n, 2))
        weighted = weight[:, None, None] * information
        np.add.at(total, rows, weighted)
        np.add.at(vector, rows, np.einsum("nij,nj->ni", weighted, sightings.points_m))
        point = np.asarray(np.linalg.solve(total, vector[..., None])[..., 0], dtype=np.float64)
        offset = sightings.points_m - point[rows]
        distance = np.sqrt(np.einsum("ni,nij,nj->n", offset, information, offset))
        weight = np.minimum(1.0, _HUBER / np.maximum(distance, 1e-12))
    count = np.bincount(rows, minlength=n)
    excess = np.bincount(rows, weight * distance**2, n) / np.maximum(2.0 * (count - 1), 1.0)
    covariance = np.linalg.inv(total) * np.maximum(1.0, excess)[:, None, None]
    return point, covariance, weight * np.sqrt(np.linalg.det(information))


def _median_and_sd(values: Floats, rows: Whole, n: int) -> tuple[Floats, Floats]:
    """Median and robust standard deviation of the finite values of each landmark, NaN without."""
    median, sd = np.full(n, np.nan), np.full(n, np.nan)
    finite = np.isfinite(values)
    order = np.lexsort((values[finite], rows[finite]))
    sorted_values, owners = values[finite][order], rows[finite][order]
    present, start, count = np.unique(owners, return_index=True, return_counts=True)
    middle = (sorted_values[start + (count - 1) // 2] + sorted_values[start + count // 2]) / 2.0
    median[present] = middle
    low = sorted_values[start + (0.16 * (count - 1)).astype(np.int64)]
    high = sorted_values[start + np.ceil(0.84 * (count - 1)).astype(np.int64)]
    sd[present] = (high - low) / 2.0
    return median, sd


def together(rows: Whole, look: Whole, n: int) -> NDArray[np.int64]:
    """Pairs `(k, 2)`, smaller row first, of landmarks that were seen in one look at least twice.

    Two things seen at the same time are two things, however near they stand.
    """
    order = np.argsort(look, kind="stable")
    pairs: list[Whole] = []
    sorted_rows, sorted_look = rows[order], look[order]
    most = int(np.bincount(look).max()) if len(look) else 0
    for step in range(1, most):
        same = sorted_look[step:] == sorted_look[:-step]
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
