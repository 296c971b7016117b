"""Robust least squares whose standard deviations hold for errors that stay alike within blocks.

Matches of one picture, and steps of one street, share their errors: the sum of the scores of a
block stands for one observation.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

# of Huber's loss: 95 % efficient with normal errors
_HUBER = 1.345
_ROUNDS = 30
LEAST_BLOCKS = 3


@dataclass(frozen=True, slots=True)
class Fit:
    """Coefficients `(k,)` with covariance `(k, k)`, and the residuals `(n,)`.

    Attributes:
        blocks: how many independent groups of observations stand behind them.
    """

    values: Floats
    covariance: Floats
    residuals: Floats
    blocks: int

    @property
    def sd(self) -> Floats:
        """Standard deviations `(k,)`; infinite with fewer than three blocks."""
        return np.sqrt(np.maximum(np.diag(self.covariance), 0.0))


def spread(values: Floats) -> float:
    """1.4826 times the median absolute deviation from the median."""
    return 1.4826 * float(np.median(np.abs(values - np.median(values)))) if len(values) else 0.0


def fit(design: Floats, target: Floats, block: Integers) -> Fit:
    """`design` `(n, k)` times the coefficients is `target` `(n,)`, under Huber's loss.

    The covariance is the sandwich of clustered scores with the correction for few clusters.

    Source: Huber, Robust Statistics, chapter 7; Liang and Zeger, Biometrika 1986, equation 9.
    """
    k = design.shape[1]
    weight = np.ones(len(target))
    values, rest = np.zeros(k), target
    for _ in range(_ROUNDS):
        root = np.sqrt(weight)[:, None]
        new = np.asarray(np.linalg.lstsq(design * root, target * root[:, 0], rcond=None)[0])
        rest = target - design @ new
        scale = 1.4826 * float(np.median(np.abs(rest))) + 1e-12
        weight = np.minimum(1.0, _HUBER * scale / np.maximum(np.abs(rest), 1e-300))
        done = np.allclose(new, values, rtol=1e-9, atol=1e-12)
        values = new
        if done:
            break
    bread = np.linalg.pinv(design.T @ (design * weight[:, None]))
    groups, index = np.unique(block, return_inverse=True)
    scores = np.zeros((len(groups), k))
    np.add.at(scores, index, design * (weight * rest)[:, None])
    covariance = np.full((k, k), np.inf)
    if len(groups) >= LEAST_BLOCKS:
        few = len(groups) / max(len(groups) - k, 1)
        covariance = few * bread @ (scores.T @ scores) @ bread
    return Fit(values, covariance, rest, len(groups))


def mean(values: Floats, block: Integers) -> tuple[float, float]:
    """Huber's mean of `(n,)` and its standard deviation."""
    found = fit(np.ones((len(values), 1)), values, block)
    return float(found.values[0]), float(found.sd[0])


def blocks_of(stamps_s: Floats, length_s: float) -> Integers:
    """Numbers `(n,)` of the stretches in which stamps lie: of `length_s`, or a tenth if short."""
    if not len(stamps_s):
        return np.empty(0, dtype=np.int64)
    # a little more, so that the last stamp has no block of its own
    length_s = min(length_s, max(float(np.ptp(stamps_s)) / 9.999, 1e-3))
    return np.asarray(np.floor((stamps_s - stamps_s.min()) / length_s), dtype=np.int64)
