"""GNSS into the output filter: evidence for or against it, and a bound while poses fail."""

from __future__ import annotations

from math import inf

import numpy as np

from polemap.localize.gnss.receiver import GnssReceiver
from polemap.localize.output_filter.rejection import weigh_by_gnss
from polemap.localize.output_filter.state import FilterState, GnssEvent
from polemap.vehicle.kalman import innovate, joseph_update
from polemap.vehicle.packed import SIZE, as_mean, pack, unpack
from polemap.vehicle.pose import reference_point_jacobian

_FOREVER = inf
# time without an accepted pose after which fixes bound the filter: dead reckoning has then lost
# about as much as poles would have known better
_AFTER_S = 5.0


def update_by_gnss(
    state: FilterState,
    event: GnssEvent,
    receiver: GnssReceiver,
    limit: float,
    *,
    gated: bool = True,
) -> FilterState:
    """The state after a fix at its stamp, to which it has been predicted.

    Args:
        limit: of the gate, on the squared distance of the position.
        gated: False takes every fix in.
    """
    interval = min(max(state.stamp_s - state.last_gnss_s, 0.05), 10.0)
    state = state._replace(last_gnss_s=state.stamp_s)
    if state.rival is not None:
        state = state._replace(rival=weigh_by_gnss(state, state.rival, event, receiver))
    if state.stamp_s - state.last_pose_s < _AFTER_S:
        return state._replace(gnss_rejected_since_s=_FOREVER)
    x, y, yaw = state.mean[:3]
    residual = np.array(receiver.residual((x, y, yaw), event.east_m, event.north_m))
    jacobian = np.zeros((2, SIZE))
    jacobian[:, :3] = reference_point_jacobian(yaw, *receiver.antenna_m)[:2]
    covariance, alone = unpack(state.upper), np.eye(2) * event.sd_m**2
    counts = state.counts
    if gated and innovate(residual, covariance, jacobian, alone).nis > limit:
        counts = counts._replace(gnss_rejections=counts.gnss_rejections + 1)
        since = min(state.gnss_rejected_since_s, state.stamp_s)
        return state._replace(counts=counts, gnss_rejected_since_s=since)
    # fixes that share their error must not be averaged as if they did not
    noise = alone * (1.0 + 2.0 * receiver.config.correlation_s / interval)
    innovation = innovate(residual, covariance, jacobian, noise)
    mean, updated = joseph_update(np.array(state.mean), covariance, innovation, jacobian, noise)
    return state._replace(
        mean=as_mean(mean),
        upper=pack(updated),
        counts=counts._replace(gnss_accepted=counts.gnss_accepted + 1),
        gnss_rejected_since_s=_FOREVER,
    )
