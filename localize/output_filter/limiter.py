"""The pose that goes out: never moves further in a tick than a car can, unless it says so.

The filter's pose steps when a late pose corrects it. Between two ticks the output moves as the
filter's speed and yaw rate say and approaches the filter's pose at a bounded rate; what is
outstanding is added to its covariance, so that it stays honest.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import hypot

import numpy as np
from numpy.typing import NDArray

from polemap.localize.output_filter.state import FilterState
from polemap.vehicle.packed import Pose, ctrv_step, unpack, wrap

Floats = NDArray[np.float64]

CORRECTION_MPS, CORRECTION_RADPS = 1.5, 0.4
"""Fastest corrections: 15 mm and 0.23 degrees a tick of 100 Hz."""
RECOVERED_M = 1.0
"""What is outstanding beyond this is no correction: the output was lost, and says it is back.

With a larger bound what is less is approached all the same, a filter that started anew included.
"""


@dataclass(frozen=True, slots=True)
class OutputPose:
    """The localizer's answer for one moment.

    Attributes:
        pose: east, north, yaw of the rear axle.
        covariance: `(3, 3)`.
        flag: "" in normal operation; "started", "reinitialized" or "recovered" where the pose may
            have jumped.
        jump_m: how far the position was moved at the flag.
        pose_age_s: time since the last pole-based pose that was taken in, infinite before any.
        distrust: why the pose may not be trusted, "" where it may; see `health.distrust`.
    """

    stamp_s: float
    pose: Pose
    covariance: Floats
    speed_mps: float
    yaw_rate_radps: float
    flag: str
    jump_m: float
    pose_age_s: float
    distrust: str = ""

    @property
    def healthy(self) -> bool:
        """Whether the pose may be trusted within three times its stated deviation."""
        return not self.distrust


class OutputLimiter:
    """Turns the filter's states at rising stamps into the output.

    Args:
        limited: off, every correction comes at once.
        step_beyond_m: what is outstanding beyond this comes at once too.
    """

    def __init__(self, *, limited: bool = True, step_beyond_m: float = RECOVERED_M) -> None:
        self._limited = limited
        self._step_beyond_m = step_beyond_m
        self._last: tuple[float, Pose] | None = None
        self._jumps = 0

    @property
    def last_stamp_s(self) -> float:
        """Stamp of the last output, minus infinity before any."""
        return self._last[0] if self._last else float("-inf")

    def limit(self, state: FilterState) -> OutputPose:
        """The output for `state`, the filter's prediction to a stamp after the last one."""
        x, y, yaw = state.mean[:3]
        counts = state.counts
        jumps = counts.reinitializations + counts.takeovers + counts.gnss_restarts
        flag, jump = "", 0.0
        if self._last is None:
            pose, flag = (x, y, yaw), "started"
        elif jumps != self._jumps and not self._approaches(state):
            pose, flag = (x, y, yaw), "reinitialized"
            moved = self._carried(state)
            jump = hypot(x - moved[0], y - moved[1])
        else:
            pose = self._approach(state)
            if hypot(x - pose[0], y - pose[1]) > self._step_beyond_m:
                moved = self._carried(state)
                pose, flag = (x, y, yaw), "recovered"
                jump = hypot(x - moved[0], y - moved[1])
        self._jumps = jumps
        self._last = (state.stamp_s, pose)
        return self._answer(state, pose, flag, jump)

    def unlimited(self, state: FilterState) -> OutputPose:
        """The filter's own pose; does not touch the limiter."""
        x, y, yaw = state.mean[:3]
        return self._answer(state, (x, y, yaw), "", 0.0)

    def _carried(self, state: FilterState) -> Pose:
        """The last output moved on by the filter's speed and yaw rate."""
        stamp, pose = self._last or (state.stamp_s, (0.0, 0.0, 0.0))
        dt = state.stamp_s - stamp
        x, y, yaw = ctrv_step(pose, state.mean[3], state.mean[4], dt, state.slip_rad_per_mps2)
        return x, y, yaw

    def _approaches(self, state: FilterState) -> bool:
        """Whether a filter that started anew is so near that the output goes to it gradually."""
        x, y, _ = self._carried(state)
        off_m = hypot(state.mean[0] - x, state.mean[1] - y)
        return self._limited and self._step_beyond_m > RECOVERED_M and off_m <= self._step_beyond_m

    def _approach(self, state: FilterState) -> Pose:
        if not self._limited:
            return state.mean[:3]
        x, y, yaw = self._carried(state)
        dt = state.stamp_s - self.last_stamp_s
        dx, dy = state.mean[0] - x, state.mean[1] - y
        dyaw = wrap(state.mean[2] - yaw)
        distance, reach = hypot(dx, dy), CORRECTION_MPS * dt
        share = 1.0 if distance <= reach else reach / distance
        turn = CORRECTION_RADPS * dt
        return (x + share * dx, y + share * dy, wrap(yaw + min(max(dyaw, -turn), turn)))

    def _answer(self, state: FilterState, pose: Pose, flag: str, jump_m: float) -> OutputPose:
        covariance = unpack(state.upper)[:3, :3].copy()
        rest = np.array(
            [state.mean[0] - pose[0], state.mean[1] - pose[1], wrap(state.mean[2] - pose[2])]
        )
        if rest.any():
            covariance += np.outer(rest, rest)
        return OutputPose(
            state.stamp_s,
            pose,
            covariance,
            state.mean[3],
            state.mean[4],
            flag,
            jump_m,
            state.stamp_s - state.last_pose_s,
        )
