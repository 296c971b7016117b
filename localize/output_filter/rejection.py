"""What happens when poses fail the gate again and again: ignore, inflate, re-initialize.

A single pose that fails the gate is ignored. When all fail for a while, either the particle
filter is wrong or the output filter is. First the filter grants itself more uncertainty, up to a
bound that a pose far away still fails; at last it goes to where the poses say, if they agree among
themselves and with the odometry, and unless GNSS speaks for the filter. Each step is counted, and
a re-initialization is flagged in the output.
"""

from __future__ import annotations

from math import cos, exp, hypot, log, sin, sqrt

import numpy as np
from numpy.typing import NDArray

from polemap.localize.output_filter.config import OutputConfig
from polemap.localize.output_filter.state import (
    FilterState,
    GnssEvent,
    PoseEvent,
    PoseUpper,
    Rival,
)
from polemap.vehicle.kalman import normalized_error
from polemap.vehicle.packed import INDEX, SIZE, Pose, Upper, compose, inverse, pack, unpack, wrap

Floats = NDArray[np.float64]

# share of GNSS fixes that say nothing: bounds what a single fix can say for either side
_OUTLIER = 0.02
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
    rival = state.rival or Rival(state.stamp_s, event.pose, here)
    if not _coherent(rival, event, here, limit):
        # poses that do not even move as the car does are no place to go to
        counts = counts._replace(incoherent=counts.incoherent + 1)
        rival = Rival(state.stamp_s, event.pose, here)
    lasted = state.stamp_s - rival.since_s
    state = state._replace(counts=counts, rival=rival, nis=nis)
    if lasted < config.inflate_after_s:
        return state._replace(decision="ignored")
    if lasted < config.reinitialize_after_s:
        counts = counts._replace(inflations=counts.inflations + 1)
        upper = _inflated(state.upper, config)
        return state._replace(counts=counts, upper=upper, decision="inflated")
    if rival.fixes and rival.evidence / rival.fixes > config.gnss_veto:
        counts = counts._replace(gnss_vetoes=counts.gnss_vetoes + 1)
        return state._replace(counts=counts, decision="vetoed")
    counts = counts._replace(reinitializations=counts.reinitializations + 1)
    return moved(state, event.pose, event.upper)._replace(counts=counts, decision="reinitialized")


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


def moved(state: FilterState, pose: Pose, upper: PoseUpper) -> FilterState:
    """The state put at a pose; speed and yaw rate stay, their ties to the old pose go."""
    a, b, c, d, e, f = upper
    none = (0.0, 0.0, 0.0, 0.0)
    return state._replace(
        mean=(*pose, *state.mean[3:]),
        upper=(a, b, c, *none, d, e, *none, f, *none, *state.upper[18:]),
        rival=None,
        gnss_rejected_since_s=float("inf"),
        last_pose_s=state.stamp_s,
    )


def weigh(
    state: FilterState, rival: Rival, event: GnssEvent, antenna_m: tuple[float, float]
) -> Rival:
    """Let a fix speak for the filter or for what the rejected poses say."""
    here = state.mean[:3]
    gain = _log_likelihood(here, event, antenna_m)
    gain -= _log_likelihood(_carried(rival, here), event, antenna_m)
    return rival._replace(fixes=rival.fixes + 1, evidence=rival.evidence + gain)


def antenna_residual(
    pose: Pose, event: GnssEvent, antenna_m: tuple[float, float]
) -> tuple[float, float]:
    """A fix against the antenna of a rear-axle pose, east and north."""
    x, y, yaw = pose
    c, s = cos(yaw), sin(yaw)
    ax, ay = antenna_m
    return (event.east_m - x - c * ax + s * ay, event.north_m - y - s * ax - c * ay)


def _log_likelihood(pose: Pose, event: GnssEvent, antenna_m: tuple[float, float]) -> float:
    east, north = antenna_residual(pose, event, antenna_m)
    return log(exp(-(east * east + north * north) / (2.0 * event.sd_m**2)) + _OUTLIER)


def _inflated(upper: Upper, config: OutputConfig) -> Upper:
    """The pose's standard deviations times the factor, each up to its bound."""
    limits = (config.inflate_max_m, config.inflate_max_m, config.inflate_max_rad)
    factor = np.ones(SIZE)
    for i, limit in enumerate(limits):
        factor[i] = max(1.0, min(config.inflate_factor, limit / sqrt(upper[INDEX[i][i]])))
    return pack(unpack(upper) * factor[:, None] * factor[None, :])
