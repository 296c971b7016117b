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

from polemap.build.config import MappingConfig
from polemap.build.robust_means import mean_of_sightings, median_and_sd
from polemap.build.sightings import Sightings
from polemap.vehicle.kalman import chi_square_quantile

Floats = NDArray[np.float64]
Whole = NDArray[np.int64]

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
        gain_m_per_px: `(n, 2)` how far an error of one pixel of disparity, the same in all looks,
            moves it.
        aligned_sd_m: `(n,)` what levelling of a drifting reference leaves, an axis; zero without.
        lever_m: `(n,)` mean range: what the reference's yaw acts on.
        direction_rad: `(n,)` mean direction from the car to the pole, from grid east.
        first_s, last_s: `(n,)` stamps of the first and last sighting.
        directions: `(n,)` bit field of the eighths of the circle it was seen from.
        range_min_m, range_max_m: `(n,)` from how near to how far it was seen.
        width_sd_m, height_sd_m: `(n,)` robust scatter of single sightings.
    """

    drive: NDArray[np.str_]
    start_s: Floats
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

    def __len__(self) -> int:
        return len(self.points_m)


def associate(sightings: Sightings, config: MappingConfig) -> Whole:
    """Number of the pass landmark that each sighting belongs to, `(n,)`.

    Each look is matched one-to-one with the landmarks that are in sight (optimal assignment on
    gated Mahalanobis distances), so that two poles beside each other stay two.
    """
    gate = chi_square_quantile(config.gate_probability, 2)
    numbers = np.full(len(sightings), -1, dtype=np.int64)
    book = _Book(len(sightings))
    starts = np.searchsorted(sightings.look, np.arange(len(sightings.looks) + 1))
    for look in np.unique(sightings.look):
        rows = np.arange(starts[look], starts[look + 1])
        points, covariance = sightings.points_m[rows], sightings.covariance_m2[rows]
        book.forget(float(sightings.looks.stamp_s[look]) - config.pass_gap_s)
        distance = book.distances(points, covariance, config.gate_slack_m)
        chosen = _assign(distance, gate)
        numbers[rows] = book.absorb(
            points, covariance, chosen, float(sightings.looks.stamp_s[look])
        )
    return numbers


def _assign(distance: Floats, gate: float) -> Whole:
    """Column for each row of the gated costs, -1 where none fits; optimal over the whole look."""
    chosen = np.full(len(distance), -1, dtype=np.int64)
    if not distance.shape[1]:
        return chosen
    inside = distance < gate
    rows, columns = np.flatnonzero(inside.any(axis=1)), np.flatnonzero(inside.any(axis=0))
    if not len(rows):
        return chosen
    cost = np.where(inside, distance, 10.0 * gate)[np.ix_(rows, columns)]
    first, second = linear_sum_assignment(cost)
    fits = cost[first, second] < gate
    chosen[rows[first[fits]]] = columns[second[fits]]
    return chosen


class _Book:
    """The landmarks of a drive while their passes go on, in information form."""

    def __init__(self, capacity: int) -> None:
        self._information = np.zeros((capacity, 3))  # ee, nn, en
        self._vector = np.zeros((capacity, 2))
        self._best = np.full((capacity, 3), np.inf)  # covariance of the best sighting
        self._last_s = np.full(capacity, -np.inf)
        self._active = np.empty(0, dtype=np.int64)
        self._count = 0

    def forget(self, before_s: float) -> None:
        """Close the passes of landmarks that were last seen before."""
        self._active = self._active[self._last_s[self._active] >= before_s]

    def distances(self, points: Floats, covariance: Floats, slack_m: float) -> Floats:
        """Squared Mahalanobis distances `(rows, active)` of a look's sightings."""
        info = self._information[self._active]
        det = info[:, 0] * info[:, 1] - info[:, 2] ** 2
        vector = self._vector[self._active]
        east = (info[:, 1] * vector[:, 0] - info[:, 2] * vector[:, 1]) / det
        north = (info[:, 0] * vector[:, 1] - info[:, 2] * vector[:, 0]) / det
        # neighbouring sightings err alike: a landmark is not trusted below half of its best one
        own = 0.25 * self._best[self._active] + np.array([slack_m**2, slack_m**2, 0.0])
        ee = covariance[:, None, 0, 0] + own[None, :, 0]
        nn = covariance[:, None, 1, 1] + own[None, :, 1]
        en = covariance[:, None, 0, 1] + own[None, :, 2]
        de, dn = points[:, None, 0] - east, points[:, None, 1] - north
        return np.asarray((de**2 * nn - 2.0 * de * dn * en + dn**2 * ee) / (ee * nn - en**2))

    def absorb(self, points: Floats, covariance: Floats, chosen: Whole, stamp_s: float) -> Whole:
        """Add a look's sightings to their landmarks, or begin new ones; their numbers."""
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
        # one sighting a landmark a look, so that plain indexing adds each of them
        self._information[numbers] += information
        self._vector[numbers] += np.stack([east, north], axis=1)
        better = ee + nn < self._best[numbers, 0] + self._best[numbers, 1]
        self._best[numbers[better]] = np.stack([ee, nn, en], axis=1)[better]
        self._last_s[numbers] = stamp_s
        return numbers


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
    point, covariance, weight, gain = mean_of_sightings(
        sightings.points_m, sightings.covariance_m2, sightings.gain_m_per_px, rows, n
    )
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
    width, width_sd = median_and_sd(sightings.width_m, rows, n)
    height, height_sd = median_and_sd(sightings.height_m, rows, n)
    first, last = np.full(n, np.inf), np.full(n, -np.inf)
    np.minimum.at(first, rows, sightings.stamp_s)
    np.maximum.at(last, rows, sightings.stamp_s)
    nearest, farthest = np.full(n, np.inf), np.zeros(n)
    np.minimum.at(nearest, rows, sightings.range_m)
    np.maximum.at(farthest, rows, sightings.range_m)
    landmarks = PassLandmarks(
        drive=np.full(n, sightings.drive),
        start_s=np.full(n, sightings.start_s),
        points_m=point,
        covariance_m2=covariance,
        reference_sd_m=np.bincount(rows, weight * sightings.reference_sd_m, n) / total,
        gain_m_per_px=gain,
        aligned_sd_m=np.zeros(n),
        lever_m=np.bincount(rows, weight * sightings.range_m, n) / total,
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
