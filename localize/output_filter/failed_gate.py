"""What happens when poses fail the gate again and again: ignore, inflate, re-initialize.

A single pose that fails the gate is ignored. When all fail for a while, either the particle
filter is wrong or the output filter is. First the filter grants itself more uncertainty, up to a
bound that a pose far away still fails; at last it goes to where the poses say, if they agree among
themselves and with the odometry, and unless GNSS speaks for the filter. Each step is counted, and
a re-initialization is flagged in the output.
"""

from __future__ import annotations

from math import hypot, sqrt

import numpy as np
from numpy.typing import NDArray

from polemap.localize.gnss.outlier_mixture import GnssReceiver
from polemap.localize.output_filter.config import OutputConfig
from polemap.localize.output_filter.state import (
    NEVER,
    FilterState,
    GnssEvent,
    PoseEvent,
    PoseUpper,
    Rival,
)
from polemap.vehicle.kalman import normalized_error
from polemap.vehicle.packed import INDEX, SIZE, Pose, Upper, compose, inverse, pack, unpack, wrap

Floats = NDArray[np.float64]

INFLATE_AFTER_S = 0.5
"""Rejections in a row before the filter grants itself more uncertainty: ten poses at 22 Hz."""
# factor on the standard deviations of the pose at every rejection, and their bounds: so small that
# a pose 10 m off still fails (tested)
_INFLATE_FACTOR, _INFLATE_MAX_M, _INFLATE_MAX_RAD = 1.3, 0.5, 0.015
# mean log-likelihood by which GNSS must speak for the filter to veto a re-initialization: e to one
_GNSS_VETO = 1.0
# rows of the state, see `vehicle.packed`
_SCALE, _FIX = 5, 7
# of the error of a place that fixes show, what later fixes repeat; less than 1 keeps the covariance
# positive definite
_SHARED = 0.9
# what dead reckoning may be off by since the first rejected pose
_DRIFT_M, _DRIFT_SHARE, _DRIFT_RAD = 0.1, 0.02, 0.02


def reject(
    state: FilterState, event: PoseEvent, nis: float, limit: float, config: OutputConfig
) -> FilterState:
    """The state after a pose that failed the gate with the squared distance `nis`.

    Args:
        limit: of the gate, for a pose's three degrees of freedom.
    """
    counts = state.counts._replace(gate_rejections=state.counts.gate_rejections + 1)
    here = state.mean[:3]
    rival = state.rival or Rival(state.stamp_s, event.pose, here, state.stamp_s)
    if not _coherent(rival, event, here, limit):
        # poses that do not even move as the car does are no place to go to
        counts = counts._replace(incoherent=counts.incoherent + 1)
        rival = Rival(state.stamp_s, event.pose, here, rival.first_s, rival.rejected)
    rival = rival._replace(rejected=rival.rejected + 1)
    lasted = state.stamp_s - rival.since_s
    state = state._replace(counts=counts, rival=rival, nis=nis)
    if lasted < INFLATE_AFTER_S or config.failed_gate == "ignore":
        return state._replace(decision="ignored")
    if lasted < config.reinitialize_after_s:
        counts = counts._replace(inflations=counts.inflations + 1)
        upper = _inflated(state.upper)
        return state._replace(counts=counts, upper=upper, decision="inflated")
    # a filter that fixes alone have led has nothing else to speak for it, and fixes that poles have
    # shown to be wrong speak for nobody
    heard = state.last_pose_s != NEVER and not state.gnss_wrong
    if heard and rival.fixes and rival.evidence / rival.fixes > _GNSS_VETO:
        counts = counts._replace(gnss_vetoes=counts.gnss_vetoes + 1)
        return state._replace(counts=counts, decision="vetoed")
    counts = counts._replace(reinitializations=counts.reinitializations + 1)
    return reset_pose(reset_odometry(state), event.pose, event.upper)._replace(
        counts=counts, decision="reinitialized"
    )


def _coherent(rival: Rival, event: PoseEvent, here: Pose, limit: float) -> bool:
    """Whether a rejected pose stands where the first of them has got to by the car's own motion."""
    expected = _carried(rival, here)
    x, y, yaw = event.pose
    residual = np.array([x - expected[0], y - expected[1], wrap(yaw - expected[2])])
    way = hypot(here[0] - rival.filter_pose[0], here[1] - rival.filter_pose[1])
    a, b, c, d, e, f = event.upper
    # the first pose was as uncertain as this one, and its heading has led the way since
    spread = (_DRIFT_M + way * (_DRIFT_SHARE + sqrt(f))) ** 2
    covariance = 2.0 * np.array([[a, b, c], [b, d, e], [c, e, f]])
    covariance += np.diag([spread, spread, _DRIFT_RAD**2])
    return normalized_error(residual, covariance) <= limit


def _carried(rival: Rival, here: Pose) -> Pose:
    """The first rejected pose, moved as the filter has moved since."""
    return compose(rival.pose, compose(inverse(rival.filter_pose), here))


def reset_pose(state: FilterState, pose: Pose, upper: PoseUpper) -> FilterState:
    """The state put at a pose; speed and yaw rate stay, their ties to the old pose go."""
    a, b, c, d, e, f = upper
    none = (0.0,) * (SIZE - 3)
    return state._replace(
        mean=(*pose, *state.mean[3:]),
        upper=(a, b, c, *none, d, e, *none, f, *none, *state.upper[INDEX[3][3] :]),
        rival=None,
        gnss_rejected_since_s=float("inf"),
        gnss_rejected=0,
        last_pose_s=state.stamp_s,
    )


def reset_pose_by_fixes(state: FilterState, pose: Pose, upper: PoseUpper) -> FilterState:
    """The state put at a pose that fixes show: it is off by what they share, estimated as zero."""
    fix_m2 = state.upper[INDEX[_FIX][_FIX]]
    state = reset_pose(state, pose, upper)
    values = list(state.upper)
    for axis in (0, 1):
        values[INDEX[axis][_FIX + axis]] = -_SHARED * min(values[INDEX[axis][axis]], fix_m2)
    return state._replace(upper=tuple(values), last_pose_s=NEVER)


def reset_odometry(state: FilterState) -> FilterState:
    """The state without what it has learned of the odometry: a restart starts clean."""
    covariance = unpack(state.upper)
    covariance[_SCALE:_FIX, :] = covariance[:, _SCALE:_FIX] = 0.0
    covariance[_SCALE:_FIX, _SCALE:_FIX] = np.diag(state.odometry_prior)
    x, y, yaw, v, w, _, _, fix_e, fix_n = state.mean
    mean = (x, y, yaw, v, w, 0.0, 0.0, fix_e, fix_n)
    return state._replace(mean=mean, upper=pack(covariance))


def weigh_by_gnss(
    state: FilterState, rival: Rival, event: GnssEvent, receiver: GnssReceiver
) -> Rival:
    """Let a fix speak for the filter or for what the rejected poses say."""
    here = state.mean[:3]
    gain = receiver.evidence(here, *event)
    gain -= receiver.evidence(_carried(rival, here), *event)
    return rival._replace(fixes=rival.fixes + 1, evidence=rival.evidence + gain)


def _inflated(upper: Upper) -> Upper:
    """The pose's standard deviations times the factor, each up to its bound."""
    limits = (_INFLATE_MAX_M, _INFLATE_MAX_M, _INFLATE_MAX_RAD)
    factor = np.ones(SIZE)
    for i, limit in enumerate(limits):
        factor[i] = max(1.0, min(_INFLATE_FACTOR, limit / sqrt(upper[INDEX[i][i]])))
    return pack(unpack(upper) * factor[:, None] * factor[None, :])
