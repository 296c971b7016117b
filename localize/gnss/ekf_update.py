"""GNSS into the output filter: evidence for or against it, and a bound while poses fail.

The receiver's error is part of the state: while poles hold the pose it is learned, and where they
end it is what keeps fixes from being averaged as if each were news.
"""

from __future__ import annotations

from math import inf

import numpy as np

from polemap.localize.gnss.outlier_mixture import GnssReceiver
from polemap.localize.output_filter.failed_gate import weigh_by_gnss
from polemap.localize.output_filter.gate import fails_gate
from polemap.localize.output_filter.state import FilterState, GnssEvent
from polemap.vehicle.ctrv import update_by_pair
from polemap.vehicle.packed import Mean, pack, unpack
from polemap.vehicle.pose import reference_point_jacobian

_FOREVER = inf
# of a fix's standard deviation, what is its own; the rest wanders with the receiver's error
_OWN_SHARE = 0.2
# row of the state that holds the error that fixes share, see `vehicle.packed`
_FIX = 7
# how long all fixes must fail until their shared error is taken for another one
_RENEWED_AFTER_S = 2.0
HELD_S, WRONG_FIXES = 1.0, 3
"""Fixes that fail so often in a row, while a pole held the pose not longer ago, are wrong."""
# ... until so many in a row have passed
_RIGHT_FIXES = 10


def update_by_gnss(
    state: FilterState,
    event: GnssEvent,
    receiver: GnssReceiver,
    limit: float,
) -> FilterState:
    """The state after a fix at its stamp, to which it has been predicted.

    Args:
        limit: of the gate, on the squared distance of the position.
    """
    state = state._replace(last_gnss_s=state.stamp_s)
    if state.rival is not None:
        state = state._replace(rival=weigh_by_gnss(state, state.rival, event, receiver))
    x, y, yaw = state.mean[:3]
    ratio = event.sd_m / receiver.config.sd_m
    east_m, north_m = receiver.residual((x, y, yaw), event.east_m, event.north_m)
    # fixes share an error that wanders slowly, and each has a smaller one of its own
    by_yaw = reference_point_jacobian(yaw, *receiver.antenna_m)[:2, 2]
    east_by_yaw, north_by_yaw = by_yaw.tolist()
    rows = (
        (1.0, 0.0, east_by_yaw, 0.0, 0.0, 0.0, 0.0, ratio, 0.0),
        (0.0, 1.0, north_by_yaw, 0.0, 0.0, 0.0, 0.0, 0.0, ratio),
    )
    variance, counts = (_OWN_SHARE * event.sd_m) ** 2, state.counts
    shared_e, shared_n = state.mean[_FIX:]
    off = east_m - ratio * shared_e, north_m - ratio * shared_n
    nis, mean, upper = update_by_pair(state.mean, state.upper, *rows, *off, variance)
    since = min(state.gnss_rejected_since_s, state.stamp_s)
    if fails_gate(nis, limit) and state.stamp_s - since >= _RENEWED_AFTER_S:
        # has the error of the fixes changed? Other satellites have another one
        covariance = unpack(state.upper)
        covariance[_FIX:, :] = covariance[:, _FIX:] = 0.0
        covariance[_FIX:, _FIX:] = np.eye(2) * receiver.config.sd_m**2
        known = state.mean
        anew: Mean = (
            known[0], known[1], known[2], known[3], known[4], known[5], known[6], 0.0, 0.0,
        )  # fmt: skip
        nis, mean, upper = update_by_pair(anew, pack(covariance), *rows, east_m, north_m, variance)
        counts = counts._replace(gnss_renewals=counts.gnss_renewals + (not fails_gate(nis, limit)))
    if fails_gate(nis, limit):
        counts = counts._replace(gnss_rejections=counts.gnss_rejections + 1)
        rejected = state.gnss_rejected + 1
        held = state.stamp_s - state.held_s <= HELD_S
        return state._replace(
            counts=counts,
            gnss_rejected=rejected,
            gnss_rejected_since_s=since,
            gnss_wrong=state.gnss_wrong or (held and rejected >= WRONG_FIXES),
            gnss_passed=0,
        )
    passed = state.gnss_passed + 1
    return state._replace(
        mean=mean,
        upper=upper,
        counts=counts._replace(gnss_accepted=counts.gnss_accepted + 1),
        gnss_rejected=0,
        gnss_rejected_since_s=_FOREVER,
        gnss_wrong=state.gnss_wrong and passed < _RIGHT_FIXES,
        gnss_passed=passed,
    )
