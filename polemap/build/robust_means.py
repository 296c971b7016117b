"""Means that outliers hardly pull, of many landmarks at once: of detections, and of traversals."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Whole = NDArray[np.int64]

# Mahalanobis distances from which a detection, and a whole traversal, lose weight
_DETECTION_HUBER, _TRAVERSAL_HUBER = 2.0, 2.5


def mean_of_detections(
    points_m: Floats, covariance_m2: Floats, gain_m_per_px: Floats, rows: Whole, n: int
) -> tuple[Floats, Floats, Floats, Floats]:
    """Iteratively reweighted mean (Huber) of points with covariances, for all landmarks at once.

    Returns:
        Points `(n, 2)`, covariances `(n, 2, 2)` as if detections were independent, scaled up where
        they scatter more than they claim, the weight of each detection `(len(rows),)`, and what the
        same mean makes of the detections' gains `(n, 2)`.
    """
    information: Floats = np.linalg.inv(covariance_m2).astype(np.float64, copy=False)
    point, total = np.zeros((n, 2)), np.zeros((n, 2, 2))
    weight, distance, weighted = np.ones(len(rows)), np.zeros(len(rows)), information
    for _ in range(8):
        weighted = weight[:, None, None] * information
        total = _sums(weighted, rows, n)
        point = _means(total, weighted, points_m, rows)
        distance = _distances(points_m - point[rows], information)
        weight = _huber(distance, _DETECTION_HUBER)
    gain = _means(total, weighted, gain_m_per_px, rows)
    count = np.bincount(rows, minlength=n)
    excess = np.bincount(rows, weight * distance**2, n) / np.maximum(2.0 * (count - 1), 1.0)
    covariance = np.linalg.inv(total) * np.maximum(1.0, excess)[:, None, None]
    return point, covariance, weight * np.sqrt(np.linalg.det(information)), gain


def weighted_mean(
    points: Floats, covariance: Floats, group: Whole, n: int, gain: Floats
) -> tuple[Floats, Floats, Floats]:
    """Robust information-weighted mean of each group: `(n, 2)`, `(n, 2, 2)`.

    The third is what the same mean makes of `gain`, `(len(points), 2)`.
    """
    information: Floats = np.linalg.inv(covariance).astype(np.float64, copy=False)
    mean, total = np.zeros((n, 2)), np.zeros((n, 2, 2))
    weight, weighted = np.ones(len(points)), information
    enough = np.bincount(group, minlength=n)[group] >= 3  # two cannot outvote each other
    for _ in range(6):
        weighted = weight[:, None, None] * information
        total = _sums(weighted, group, n)
        mean = _means(total, weighted, points, group)
        distance = _distances(points - mean[group], information)
        weight = np.where(enough, _huber(distance, _TRAVERSAL_HUBER), 1.0)
    carried = _means(total, weighted, gain, group)
    return mean, np.asarray(np.linalg.inv(total), dtype=np.float64), carried


def median_and_sd(values: Floats, rows: Whole, n: int) -> tuple[Floats, Floats]:
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


def _sums(weighted: Floats, group: Whole, n: int) -> Floats:
    """Information `(n, 2, 2)` of each group."""
    total = np.zeros((n, 2, 2))
    np.add.at(total, group, weighted)
    return total


def _means(total: Floats, weighted: Floats, values: Floats, group: Whole) -> Floats:
    """Mean `(n, 2)` of the values `(m, 2)` of each group, by their information `(m, 2, 2)`."""
    vector = np.zeros((len(total), 2))
    np.add.at(vector, group, np.einsum("nij,nj->ni", weighted, values))
    return np.asarray(np.linalg.solve(total, vector[..., None])[..., 0], dtype=np.float64)


def _distances(offset: Floats, information: Floats) -> Floats:
    """Mahalanobis distances `(m,)`."""
    return np.asarray(np.sqrt(np.einsum("ni,nij,nj->n", offset, information, offset)))


def _huber(distance: Floats, limit: float) -> Floats:
    """Weights `(m,)`: one within the limit, less beyond (Huber 1964)."""
    return np.asarray(np.minimum(1.0, limit / np.maximum(distance, 1e-12)))
