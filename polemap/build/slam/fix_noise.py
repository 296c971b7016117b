"""How large and how lasting the errors of the fixes are: restricted maximum likelihood, averaged.

Against the solved poses p a fix z reads, axis by axis,

    z = p + H t + b + w,   b Gauss-Markov (s, T),   w white,

where t is what the fixes themselves decided: the place, turn and scale of all drives together. Of
an error that lasts a minute, a quarter of an hour shows fifteen, so that the variance of the
residuals, and still more their correlation, come out too small if t is forgotten. It is therefore
integrated out (flat prior), and s and T are averaged over their posterior, with the settings as a
broad prior. What is averaged is s^2 and s^2 T: the latter is what a mean of many fixes is off by.

This is what is stated of a solved map. While it is being solved the plain moments serve (`noise`):
what the odometry still bends looks like an error of the fixes that lasts, and fixes that are
believed to err slowly would be followed in every detail.

Source: Patterson and Thompson, Recovery of inter-block information when block sizes are unequal,
Biometrika 58(3), 1971; Harville, Bayesian inference for variance components using only error
contrasts, Biometrika 61(2), 1974.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from polemap.build.slam.config import SlamConfig
from polemap.build.slam.constants import GNSS_WHITE_M
from polemap.build.slam.problem import Problem, Solution, seen_once
from polemap.vehicle.pose import transform_points

Floats = NDArray[np.float64]

_FIRM_MIN = 30  # fixes at poles of several passes; with fewer of them all are asked
_FACTOR = np.geomspace(0.2, 3.0, 10)  # of the stated sd
_LASTS_S = np.geomspace(2.0, 300.0, 10)
_WHITE_M = np.geomspace(0.1, 1.0, 6)
_WHITE_MOST = 0.7  # of the whole
_PRIOR_LOG_SD = 0.7  # of each against the settings
_WEIGHT_LEAST = 1e-3
_COLLINEAR = 1e-3


@dataclass(frozen=True, slots=True)
class FixNoise:
    """Errors of fixes at HDOP 1, an axis.

    Attributes:
        sd_m: of all; white_m: of the part that does not last.
        correlation_s: for how long the rest lasts.
    """

    sd_m: float
    white_m: float
    correlation_s: float

    @property
    def lasting_m(self) -> float:
        """Deviation of what lasts."""
        return float(np.sqrt(self.sd_m**2 - self.white_m**2))


def white_of(sd_m: float) -> float:
    """The part of a fix's error that does not last, as far as nothing is known; most of it does."""
    return min(GNSS_WHITE_M, 0.5 * sd_m)


def stated_fixes(config: SlamConfig) -> FixNoise:
    """What the settings say."""
    return FixNoise(config.gnss_sd_m, white_of(config.gnss_sd_m), config.gnss_correlation_s)


def measure_fixes(
    problem: Problem, solution: Solution, fix_s: Floats, hdop: Floats, config: SlamConfig
) -> FixNoise:
    """The noise of the fixes, from what the graph leaves; `fix_s`, `hdop` `(c,)` are theirs."""
    stated = stated_fixes(config)
    firm = ~seen_once(problem)[problem.fix_from]
    if np.count_nonzero(firm) < _FIRM_MIN:
        firm = np.ones(len(fix_s), dtype=np.bool_)
    if np.count_nonzero(firm) < 3:
        return stated
    drive = np.cumsum(problem.bias_share == 0.0)[firm]
    place = transform_points(solution.poses[problem.fix_from], problem.fix_antenna_m)[firm]
    data = _Residuals(
        off=(problem.fix_m[firm] - place) / hdop[firm, None],
        free=_free(place) / hdop[firm, None],
        weight=np.maximum(solution.fix_weight[firm], _WEIGHT_LEAST),
        gap_s=np.where(np.diff(drive) == 0, np.diff(fix_s[firm]), np.inf),
    )
    tried = [
        FixNoise(factor * config.gnss_sd_m, white, lasts)
        for factor in _FACTOR.tolist()
        for lasts in _LASTS_S.tolist()
        for white in _WHITE_M.tolist()
        if white <= _WHITE_MOST * factor * config.gnss_sd_m
    ]
    table = np.array([[one.sd_m, one.white_m, one.correlation_s] for one in tried])
    prior = np.log(table / [stated.sd_m, stated.white_m, stated.correlation_s]) / _PRIOR_LOG_SD
    log_posterior = np.array([_log_likelihood(data, one) for one in tried])
    log_posterior -= 0.5 * np.sum(prior**2, axis=1)
    share = np.exp(log_posterior - log_posterior.max())
    share /= share.sum()
    white2 = float(share @ table[:, 1] ** 2)
    lasting2 = table[:, 0] ** 2 - table[:, 1] ** 2
    mean2 = float(share @ lasting2)
    correlation_s = float(share @ (lasting2 * table[:, 2])) / mean2
    return FixNoise(float(np.sqrt(mean2 + white2)), float(np.sqrt(white2)), correlation_s)


@dataclass(frozen=True, slots=True)
class _Residuals:
    """`off` `(n, 2)` of fixes, `free` `(n, k)` what may move them, `weight` `(n,)`, and `gap_s`."""

    off: Floats
    free: Floats
    weight: Floats
    gap_s: Floats


def _free(place_m: Floats) -> Floats:
    """Orthonormal columns `(n, 1 to 3)`, affine in the place: what fixes decide of one axis."""
    far = place_m - place_m.mean(axis=0)
    far = far / max(float(np.abs(far).max()), 1.0)
    columns = np.column_stack([np.ones(len(far)), far])
    left, size, _ = np.linalg.svd(columns, full_matrices=False)
    return np.asarray(left[:, size > _COLLINEAR * size[0]])


def _log_likelihood(data: _Residuals, noise: FixNoise) -> float:
    """Of the residuals, what may move them being integrated out; the information of b is banded."""
    lasting2 = noise.lasting_m**2
    share = np.exp(-data.gap_s / noise.correlation_s)
    rest = 1.0 - share**2
    band = np.zeros((2, len(data.off)))
    band[1] = 1.0
    band[1, 1:] += share**2 / rest
    band[1, :-1] += share**2 / rest
    band[0, 1:] = -share / rest
    band /= lasting2
    seen = data.weight / noise.white_m**2
    band[1] += seen
    upper = scipy.linalg.cholesky_banded(band)
    both = np.column_stack([data.off, data.free]) * seen[:, None]
    inside = both - seen[:, None] * scipy.linalg.cho_solve_banded((upper, False), both)
    determinant = 2.0 * np.log(upper[1]).sum() + np.log(rest).sum()
    determinant += len(seen) * np.log(lasting2) - np.log(seen).sum()
    free = data.free.T @ inside[:, 2:]
    cross = data.free.T @ inside[:, :2]
    squares = np.sum(data.off * inside[:, :2]) - np.sum(cross * np.linalg.solve(free, cross))
    return -float(determinant + np.linalg.slogdet(free)[1] + 0.5 * squares)
