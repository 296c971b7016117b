"""Places that particles hold possible where lines lead them: ridges along the street, lanes beside.

Lines say nothing along the street, so particles without poles form a ridge that is many metres long
and decimetres wide. That is one place that is not known along, and no row of places; two ridges
with nothing between them, a lane's width apart, are two.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from polemap.localize.particle_filter.estimate import Mode, find_modes, position_sd
from polemap.vehicle.pose import wrap_angle

Floats = NDArray[np.float64]

# a lane beside that holds a hundredth of the weight is not ruled out
_SHARE_MIN = 0.01
_RADIUS_M, _RADIUS_RAD = 1.2, 0.35
_MOST = 24
# a set as narrow as this has no room for a second lane of a hundredth of the weight
_NARROW_M, _NARROW_RAD = 0.25, 0.14
# between the middles of two clusters of one ridge no stretch of this length is empty: it holds this
# share of what the emptier one of both ends does; along the street the ends of a ridge are sparse
_STRETCH_M, _ASIDE_M, _LEAST = 0.6, 0.8, 0.1
_ALONG, _STRETCH_ALONG_M, _LEAST_ALONG = 0.9, 2.5, 0.01


def ridge_modes(rear: Floats, weights: Floats, mean: Floats, covariance: Floats) -> list[Mode]:
    """Modes of particles `(n, 3)` with known mean and covariance, heaviest first."""
    major, _ = position_sd(covariance)
    if major < _NARROW_M and covariance[2, 2] < _NARROW_RAD**2:
        return [Mode(1.0, mean, covariance)]
    found = find_modes(
        rear, weights, radius_m=_RADIUS_M, radius_rad=_RADIUS_RAD, share_min=_SHARE_MIN, most=_MOST
    )
    if len(found) < 2:
        return found
    group = np.arange(len(found))
    for i in range(len(found)):
        for j in range(i):
            if group[i] != group[j] and _one_ridge(rear, weights, found[i].mean, found[j].mean):
                group[group == group[i]] = group[j]
    ridges = [[found[i] for i in np.flatnonzero(group == g)] for g in np.unique(group)]
    if len(ridges) == 1:
        return [Mode(1.0, mean, covariance)]
    return sorted((_joined(modes) for modes in ridges), key=lambda mode: -mode.share)


def _one_ridge(rear: Floats, weights: Floats, first: Floats, second: Floats) -> bool:
    """Whether particles lead from one place `(3,)` to the other without a gap."""
    way = second[:2] - first[:2]
    length = float(np.hypot(*way))
    if abs(wrap_angle(second[2] - first[2])) > _RADIUS_RAD:
        return False
    ahead = np.array([np.cos(first[2]), np.sin(first[2])])
    along_street = abs(float(way @ ahead)) >= _ALONG * length
    stretches = int(np.ceil(length / (_STRETCH_ALONG_M if along_street else _STRETCH_M)))
    if stretches < 2:
        return True
    offset = rear[:, :2] - first[:2]
    along = offset @ way / length
    aside = np.abs(offset[:, 0] * way[1] - offset[:, 1] * way[0]) / length
    rows = (aside <= _ASIDE_M) & (np.abs(wrap_angle(rear[:, 2] - first[2])) <= 2.0 * _RADIUS_RAD)
    half = 0.5 * length / stretches
    edges = np.linspace(-half, length + half, stretches + 2)
    held = np.histogram(along[rows], edges, weights=weights[rows])[0]
    least = _LEAST_ALONG if along_street else _LEAST
    return bool(held.min() >= least * min(held[0], held[-1]))


def _joined(modes: list[Mode]) -> Mode:
    """One mode of several: the moments of their mixture."""
    share = sum(mode.share for mode in modes)
    heaviest = max(modes, key=lambda mode: mode.share).mean
    offset = np.array([mode.mean - heaviest for mode in modes])
    offset[:, 2] = wrap_angle(offset[:, 2])
    part = np.array([mode.share for mode in modes]) / share
    middle = part @ offset
    away = offset - middle
    inside = np.einsum("m,mij->ij", part, np.array([mode.covariance for mode in modes]))
    mean = heaviest + middle
    mean[2] = wrap_angle(mean[2])
    return Mode(share, mean, inside + (away * part[:, None]).T @ away)
