"""Means that outliers hardly pull, of many landmarks at once: of sightings, and of passes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Whole = NDArray[np.int64]

# Mahalanobis distances from which a sighting, and a whole pass, lose weight
_SIGHTING_HUBER, _PASS_HUBER = 2.0, 2.5


def mean_of_sightings(
    points_m: Floats, covariance_m2: Floats, gain_m_per_px: Floats, rows: Whole, n: int
) -> tuple[Floats, Floats, Floats, Floats]:
    """Iteratively reweighted mean (Huber) of points with covariances, for all landmarks at once.

    Returns:
        Points `(n, 2)`, covariances `(n, 2, 2)` as if sightings were independent, scaled up where
        they scatter more than they claim, the weight of each sighting `(len(rows),)`, and what the
        same mean makes of the sightings' gains `(n, 2)`.
    """
    information = np.linalg.inv(covariance_m2)
    point = (
        np.stack([np.bincount(rows, points_m[:, axis], n) for axis in (0, 1)], axis=1)
        / np.bincount(rows, minlength=n)[:, None]
    )
    weight = np.ones(len(rows))
    total, weighted = np.zeros((n, 2, 2)), information
    distance = np.zeros(len(rows))
    for _ in range(8):
        total = np.zeros((n, 2, 2))
        vector = np.zeros((n, 2))
        weighted = weight[:, None, None] * information
        np.add.at(total, rows, weighted)
        np.add.at(vector, rows, np.einsum("nij,nj->ni", weighted, points_m))
        point = np.asarray(np.linalg.solve(total, vector[..., None])[..., 0], dtype=np.float64)
        offset = points_m - point[rows]
        distance = np.sqrt(np.einsum("ni,nij,nj->n", offset, information, offset))
        weight = np.minimum(1.0, _SIGHTING_HUBER / np.maximum(distance, 1e-12))
    carried = np.zeros((n, 2))
    np.add.at(carried, rows, np.einsum("nij,nj->ni", weighted, gain_m_per_px))
    gain = np.asarray(np.linalg.solve(total, carried[..., None])[..., 0], dtype=np.float64)
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
    information = np.linalg.inv(covariance)
    weight = np.ones(len(points))
    mean: Floats = np.zeros((n, 2))
    total: Floats = np.zeros((n, 2, 2))
    count = np.bincount(group, minlength=n)
    weighted = information
    for _ in range(6):
        total, vector = np.zeros((n, 2, 2)), np.zeros((n, 2))
        weighted = weight[:, None, None] * information
        np.add.at(total, group, weighted)
        np.add.at(vector, group, np.einsum("nij,nj->ni", weighted, points))
        mean = np.asarray(np.linalg.solve(total, vector[..., None])[..., 0], dtype=np.float64)
        offset = points - mean[group]
        distance = np.sqrt(np.einsum("ni,nij,nj->n", offset, information, offset))
        # two cannot outvote each other
        weight = np.where(
            count[group] >= 3, np.minimum(1.0, _PASS_HUBER / np.maximum(distance, 1e-12)), 1.0
        )
    carried = np.zeros((n, 2))
    np.add.at(carried, group, np.einsum("nij,nj->ni", weighted, gain))
    carried = np.asarray(np.linalg.solve(total, carried[..., None])[..., 0], dtype=np.float64)
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
