"""How noisy the detections and the fixes of these drives are, from what the graph leaves."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from polemap.build.slam.config import SlamConfig
from polemap.build.slam.fix_noise import FixNoise, stated_fixes, white_of
from polemap.build.slam.problem import Problem, Solution
from polemap.vehicle.pose import transform_points

Floats = NDArray[np.float64]
Whole = NDArray[np.int64]

_LAGS = 30
_SEEN_PRIOR = 200.0  # independent residuals that the settings count as
_SEEN_FACTOR = (0.25, 10.0)
_FIX_PRIOR = 2.0  # correlation times that they count as
_SQUARE_MOST = 9.0  # an outlier must not decide
_FIX_FACTOR = (0.2, 3.0)
_CORRELATION_S = (2.0, 120.0)


@dataclass(frozen=True, slots=True)
class Noise:
    """What the errors are multiplied by.

    Attributes:
        seen_variance: on the covariance of detections, with what repeats of it.
        fix: errors of fixes.
    """

    seen_variance: float
    fix: FixNoise


def stated_noise(config: SlamConfig) -> Noise:
    """The noise before anything is solved."""
    return Noise(1.0, stated_fixes(config))


def seen_residuals(problem: Problem, solution: Solution) -> Floats:
    """Residuals `(b, 2)` of the detections in the map's axes."""
    placed = transform_points(solution.poses[problem.seen_from], problem.seen_m)
    return np.asarray(placed - solution.points_m[problem.seen])


def measure_noise(
    problem: Problem,
    solution: Solution,
    before: Noise,
    fix_s: Floats,
    hdop: Floats,
    config: SlamConfig,
) -> Noise:
    """The noise that explains the residuals of a solution; `fix_s`, `hdop` `(c,)` of its fixes."""
    return Noise(
        _seen(problem, solution, before.seen_variance),
        _fixes(problem, solution, fix_s, hdop, config),
    )


def _seen(problem: Problem, solution: Solution, factor: float) -> float:
    if not len(problem.seen):
        return factor
    sd = np.sqrt(np.trace(problem.seen_covariance_m2, axis1=1, axis2=2) / 2.0 / factor)
    z = seen_residuals(problem, solution) / sd[:, None]
    size = np.linalg.norm(z, axis=1)
    z = z * np.minimum(1.0, 3.0 / np.maximum(size, 1e-12))[:, None]
    order = np.lexsort((problem.seen_from, problem.seen))
    total = _integrated(z[order], problem.seen[order])
    # residuals lack what their landmark took up: two numbers each
    free = max(1.0 - len(np.unique(problem.seen)) / len(z), 0.2)
    power = float(np.mean(z**2)) / free
    count = len(z) / total
    mean = (count * power * total + _SEEN_PRIOR) / (count + _SEEN_PRIOR)
    return float(np.clip(mean, *_SEEN_FACTOR))


def _fixes(
    problem: Problem, solution: Solution, fix_s: Floats, hdop: Floats, config: SlamConfig
) -> FixNoise:
    if not len(fix_s):
        return stated_fixes(config)
    poses = solution.poses[problem.fix_from]
    antenna = transform_points(poses, problem.fix_antenna_m)
    z = (problem.fix_m - antenna) / hdop[:, None] / config.gnss_sd_m
    good = np.sum(z**2, axis=1) < 2.0 * _SQUARE_MOST
    z, times = z[good], fix_s[good]
    if len(z) < 3:
        return stated_fixes(config)
    step = float(np.median(np.diff(np.sort(times))))
    lasts = 0.5 * step * _integrated(z, problem.fix_bias[good] * 0)
    # what lasts as long as the drive is in its poses, not in the residuals
    span = step * len(z)
    trust = span / (span + _FIX_PRIOR * config.gnss_correlation_s)
    # the median, as outliers are in it: of a squared normal it is 0.455
    variance = trust * float(np.median(z**2)) / 0.455 + 1.0 - trust
    lasting = trust * lasts + (1.0 - trust) * config.gnss_correlation_s
    sd_m = float(config.gnss_sd_m * np.clip(np.sqrt(variance), *_FIX_FACTOR))
    return FixNoise(sd_m, white_of(sd_m), float(np.clip(lasting, *_CORRELATION_S)))


def _integrated(z: Floats, owner: Whole) -> float:
    """`1 + 2 sum rho_k` of rows in order, within owners, to the first lag without correlation."""
    power = float(np.mean(z**2))
    total = 1.0
    for lag in range(1, _LAGS):
        same = owner[lag:] == owner[:-lag]
        if np.count_nonzero(same) < 50 or power <= 0.0:
            break
        rho = float(np.mean((z[lag:] * z[:-lag])[same])) / power
        if rho <= 0.05:
            break
        total += 2.0 * rho
    return total
