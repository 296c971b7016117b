"""The parabola that most of the paint agrees with, by random samples."""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil, log

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
BATCH, MOST_TRIALS = 64, 640
MISSED = 1e-3  # chance that all samples so far held an outlier, at which the search ends


@dataclass(frozen=True, slots=True)
class Agreement:
    """The points `(n,)` that agree with the best sample, and how many samples were taken."""

    inliers: NDArray[np.bool_]
    trials: int


def needed_trials(inlier_share: float, size: int = 3, missed: float = MISSED) -> float:
    """Samples of `size` after which all held an outlier with probability `missed` only.

    Source: Fischler and Bolles, CACM 1981, section II.B.
    """
    clean = inlier_share**size
    if clean <= 0.0:
        return float("inf")
    return 1.0 if clean >= 1.0 else max(1.0, ceil(log(missed) / log(1.0 - clean)))


def agree_on_parabola(
    points_m: Floats,
    weights: Floats,
    *,
    tolerance_m: float,
    slope: tuple[float, float],
    curvature_per_m: tuple[float, float],
    rng: np.random.Generator,
) -> Agreement | None:
    """`y = a + b x + c x^2` through three points `(n, 2)`, as often as the share of inliers asks.

    Of two samples that with the larger sum of weights is better, a point's weight counting up to
    three times the median. Slope at the middle of the points and curvature stay within their
    bounds (low, high). None where no three points lie on a possible marking.
    """
    x, y = points_m[:, 0], points_m[:, 1]
    capped = np.minimum(weights, 3.0 * np.median(weights))
    middle = 0.5 * float(x.min() + x.max())
    apart = 0.15 * float(np.ptp(x))
    best, score, trials, wanted = None, -1.0, 0, float(MOST_TRIALS)
    while trials < min(wanted, MOST_TRIALS):
        trials += BATCH
        three = np.sort(rng.integers(0, len(x), size=(BATCH, 3)), axis=1)
        x0, x1, x2 = x[three].T
        y0, y1, y2 = y[three].T
        d01, d12, d02 = x1 - x0, x2 - x1, x2 - x0
        spread = (np.abs(d01) > apart) & (np.abs(d12) > apart) & (np.abs(d02) > apart)
        d01, d12, d02 = (np.where(spread, d, 1.0) for d in (d01, d12, d02))
        first = (y1 - y0) / d01
        c = ((y2 - y1) / d12 - first) / d02
        b = first - c * (x0 + x1)
        a = y0 - b * x0 - c * x0 * x0
        middle_slope, bent = b + 2.0 * c * middle, 2.0 * c
        good = spread & (middle_slope > slope[0]) & (middle_slope < slope[1])
        good &= (bent > curvature_per_m[0]) & (bent < curvature_per_m[1])
        if not good.any():
            continue
        a, b, c = a[good, None], b[good, None], c[good, None]
        near = np.abs(y - a - b * x - c * x * x) < tolerance_m
        sums = near @ capped
        at = int(np.argmax(sums))
        if sums[at] > score:
            best, score = near[at], float(sums[at])
            wanted = needed_trials(float(best.mean()))
    return None if best is None else Agreement(best, trials)
