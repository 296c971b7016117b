"""What happens when poses fail the gate again and again: ignore, inflate, re-initialize.

A single pose that fails the gate is ignored. When all fail for a while, either the particle
filter is wrong or the output filter is. First the filter grants itself more uncertainty, up to a
bound that a pose far away still fails; at last it goes to where the poses say, unless GNSS speaks
for the filter. Each step is counted, and a re-initialization is flagged in the output.
"""

from __future__ import annotations

from math import cos, exp, log, sin, sqrt

import numpy as np
from numpy.typing import NDArray

from localize.ctrv_kernel import INDEX, SIZE, Upper, pack, unpack, wrap
from localize.output_config import OutputConfig
from localize.output_state import FilterState, GnssEvent, Pose, PoseEvent, PoseUpper, Rival

Floats = NDArray[np.float64]

# share of GNSS fixes that say nothing: bounds what a single fix can say for either side
_OUTLIER = 0.02


def reject(
    state: FilterState, event: PoseEvent, residual: Floats, nis: float, config: OutputConfig
) -> FilterState:
    """The state after a pose that failed the gate by `residual` `(3,)`, map frame."""
    counts = state.counts._replace(gate_rejections=state.counts.gate_rejections + 1)
    c, s = cos(state.mean[2]), sin(state.mean[2])
    dx, dy, dyaw = residual.tolist()
    offset = (c * dx + s * dy, -s * dx + c * dy, dyaw)
    rival = (state.rival or Rival(state.stamp_s, offset))._replace(offset=offset)
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
    x, y, yaw = state.mean[:3]
    c, s = cos(yaw), sin(yaw)
    dx, dy, dyaw = rival.offset
    other = (x + c * dx - s * dy, y + s * dx + c * dy, wrap(yaw + dyaw))
    gain = _log_likelihood((x, y, yaw), event, antenna_m) - _log_likelihood(other, event, antenna_m)
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
