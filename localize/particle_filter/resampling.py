"""Resampling: the low-variance sampler, and how many particles a cloud is worth."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from polemap.localize.config import LocalizeConfig
from polemap.vehicle.pose import wrap_angle

Floats = NDArray[np.float64]

_KERNEL = 0.1


def low_variance_indices(
    weights: Floats, count: int, rng: np.random.Generator
) -> NDArray[np.int64]:
    """Indices `(count,)` of the particles that live on, sorted.

    One random number places a comb of `count` equal teeth over the cumulated weights, so a
    particle of weight w survives floor(count w) or ceil(count w) times.

    Source: Thrun, Burgard, Fox (2005), table 4.4.
    """
    cumulated = np.cumsum(weights)
    teeth = (rng.random() + np.arange(count)) / count * cumulated[-1]
    indices = np.searchsorted(cumulated, teeth, side="right")
    return np.asarray(np.minimum(indices, len(weights) - 1), dtype=np.int64)


def jittered(values: Floats, rng: np.random.Generator) -> Floats:
    """A constant that every particle guesses `(n,)`, smoothed after resampling.

    Survivors of one particle guess alike; a kernel parts them again, and drawing all values towards
    their mean as much keeps the variance as it was.

    Source: Liu, West (2001), section 10.3.2, with a kernel of a tenth of the spread.
    """
    mean, sd = float(values.mean()), float(values.std())
    shrink = np.sqrt(1.0 - _KERNEL**2)
    noise = rng.standard_normal(len(values))
    return np.asarray(mean + shrink * (values - mean) + _KERNEL * sd * noise)


def particles_needed(poses: Floats, weights: Floats, config: LocalizeConfig) -> int:
    """The set number of particles, or what KLD sampling asks for where that is chosen."""
    if not config.kld.adaptive:
        return config.particles
    return kld_count(
        poses,
        weights,
        least=config.kld.particles_min,
        most=config.kld.particles_max,
    )


def kld_count(
    poses: Floats,
    weights: Floats,
    *,
    least: int,
    most: int,
    error: float = 0.05,
    quantile: float = 2.33,
    bin_m: float = 0.25,
    bin_rad: float = 0.05,
) -> int:
    """Particles needed so that the sampled cloud stays within `error` (Kullback-Leibler
    distance) of the true one, from the number of bins of (E, N, yaw) that hold weight.

    Source: Fox (2003), equation (7), with the Wilson-Hilferty quantile; Thrun et al., table 8.4.
    """
    scale = np.array([bin_m, bin_m, bin_rad])
    offset = poses - poses[0]
    offset[:, 2] = wrap_angle(offset[:, 2])
    # weightless particles will not be drawn, so their bins do not count
    alive = weights > 1e-3 / len(weights)
    occupied = len(np.unique(np.floor(offset[alive] / scale).astype(np.int64), axis=0))
    if occupied <= 1:
        return least
    k = occupied - 1.0
    tail = 2.0 / (9.0 * k)
    needed = k / (2.0 * error) * (1.0 - tail + np.sqrt(tail) * quantile) ** 3
    return int(np.clip(np.ceil(needed), least, most))
