"""Poses of a filter carry the same news again and again.

The particle filter's error changes slowly (its poses 45 ms apart correlate by 0.99). Taken as
independent measurements they would make the output filter claim to know far more than the
particle filter does. Both have the same odometry, so what the output filter may know is bounded
by the covariance of the pose that it was given.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from polemap.vehicle.kalman import symmetric

Floats = NDArray[np.float64]

_LEAST = 1e-6


def news(known: Floats, offered: Floats, least_gain: float) -> Floats:
    """Noise `(n, n)` that lets an update add only what a pose knows beyond the state.

    `inv(R) = inv(offered) - inv(known)`: the update ends at the covariance `offered`. Where that
    would give a gain below `least_gain`, R is what gives this gain, so that the two estimates of
    one thing do not part.

    Args:
        known: covariance `(n, n)` of the state.
        offered: covariance of the pose.
        least_gain: between 0 and 1.
    """
    root = np.linalg.cholesky(known)
    inverse = np.linalg.inv(root)
    share, axes = np.linalg.eigh(symmetric(inverse @ offered @ inverse.T))
    share = np.clip(share, _LEAST, 1.0 - min(max(least_gain, _LEAST), 1.0 - _LEAST))
    turned = root @ axes
    return symmetric((turned * (share / (1.0 - share))) @ turned.T)


def missing(claimed: Floats, offered: Floats) -> Floats:
    """What must be added to `claimed` so that it is nowhere below `offered`; `(n, n)`, positive
    semi-definite.
    """
    root = np.linalg.cholesky(offered)
    inverse = np.linalg.inv(root)
    share, axes = np.linalg.eigh(symmetric(inverse @ claimed @ inverse.T))
    turned = root @ axes
    return symmetric((turned * np.maximum(1.0 - share, 0.0)) @ turned.T)
