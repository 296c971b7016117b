"""A pose of the particle filter into the output filter: gated, and never counted twice.

The particle filter's error changes slowly (its poses 45 ms apart correlate by 0.99). Taken as
independent measurements they would make the output filter claim to know far more than the
particle filter does. Both have the same odometry, so what the output filter may know is bounded
by the covariance of the pose that it was given.
"""

from __future__ import annotations

from dataclasses import replace
from math import exp, nan

import numpy as np
from numpy.typing import NDArray

from polemap.localize.output_filter.config import OutputConfig
from polemap.localize.output_filter.failed_gate import reject, reset_pose
from polemap.localize.output_filter.gate import fails_gate
from polemap.localize.output_filter.state import NEVER, FilterState, PoseEvent, PoseUpper
from polemap.vehicle.kalman import angle_residual, innovate, joseph_update, symmetric
from polemap.vehicle.packed import SIZE, as_mean, pack, unpack

Floats = NDArray[np.float64]

_LEAST = 1e-6
_POSE_ROWS = np.eye(3, SIZE)
# time in which the output follows shared poses at least: seven poses at 22 Hz
_FOLLOW_S = 0.3
# spread beyond which the sine of a heading error is not its angle to a few per cent
_LOST_M, _LOST_RAD = 10.0, 0.5


def update_by_pose(
    state: FilterState, event: PoseEvent, config: OutputConfig, limit: float
) -> FilterState:
    """The state after a pose at its stamp, to which it has been predicted.

    Args:
        limit: of the gate, for a pose's three degrees of freedom.
    """
    counts = state.counts
    noise, covariance = _square(event.upper), unpack(state.upper)
    residual = angle_residual(np.array(event.pose), np.array(state.mean[:3]), angle_rows=(2,))
    innovation = innovate(residual, covariance, _POSE_ROWS, noise)
    lost = config.failed_gate == "recover" and _lost(covariance)
    if fails_gate(innovation.nis, limit) and not lost:
        return reject(state, event, innovation.nis, limit, config)
    if state.last_pose_s == NEVER or lost:
        # GNSS has started the filter, or it is lost: poles know better, and the first that fits,
        # or any where the filter is no longer a linear one, takes over
        counts = counts._replace(takeovers=counts.takeovers + 1)
        return reset_pose(state, event.pose, event.upper)._replace(
            counts=counts, decision="started", nis=nan, held_s=state.stamp_s
        )
    weight, shared = noise, config.pose_errors == "shared"
    if shared:
        least = 1.0 - exp((state.last_pose_s - state.stamp_s) / _FOLLOW_S)
        weight = decorrelated_noise(covariance[:3, :3], noise, least)
        gain = np.asarray(np.linalg.solve(covariance[:3, :3] + weight, covariance[:3]).T, float)
        innovation = replace(innovation, gain=gain)
    mean, updated = joseph_update(np.array(state.mean), covariance, innovation, _POSE_ROWS, weight)
    if shared:
        updated[:3, :3] += covariance_deficit(updated[:3, :3], noise)
    return state._replace(
        mean=as_mean(mean),
        upper=pack(updated),
        counts=counts._replace(poses_accepted=counts.poses_accepted + 1),
        rival=None,
        last_pose_s=state.stamp_s,
        held_s=state.stamp_s if event.held else state.held_s,
        decision="accepted",
        nis=innovation.nis,
    )


def _lost(covariance: Floats) -> bool:
    """Whether the filter knows so little that its linear gate means nothing."""
    position_m2 = covariance[0, 0] + covariance[1, 1]
    return bool(position_m2 > _LOST_M**2 or covariance[2, 2] > _LOST_RAD**2)


def decorrelated_noise(known: Floats, offered: Floats, least_gain: float) -> Floats:
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


def covariance_deficit(claimed: Floats, offered: Floats) -> Floats:
    """What must be added to `claimed` so that it is nowhere below `offered`; `(n, n)`, positive
    semi-definite.
    """
    root = np.linalg.cholesky(offered)
    inverse = np.linalg.inv(root)
    share, axes = np.linalg.eigh(symmetric(inverse @ claimed @ inverse.T))
    turned = root @ axes
    return symmetric((turned * np.maximum(1.0 - share, 0.0)) @ turned.T)


def _square(upper: PoseUpper) -> Floats:
    a, b, c, d, e, f = upper
    return np.array([[a, b, c], [b, d, e], [c, e, f]])
