"""What a drive along a path came to: errors, steering, oscillation."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

STEER_S, SETTLE_S = 0.01, 3.0
SWING_M, SWING_S, SWINGS = 0.1, 2.0, 4
"""An oscillation: at least four successive swings of the lateral error of 0.1 m or more, each
within 2 s. The road's own bends take longer."""


@dataclass(frozen=True, slots=True)
class FollowRun:
    """A drive at 100 Hz; arrays `(n,)`, lateral errors of the front axle, left positive.

    `engaged_s` is when the car was handed over, nan if never; `driver_share` the share of the time
    since in which the localizer was not sure and the driver steered. `pose_error` `(n, 3)` is that
    of the pose to steer by, along the car, to its left, and in yaw; nan where there was none.
    """

    stamp_s: Floats
    lateral_m: Floats
    steer_rad: Floats
    engaged_s: float
    driver_share: float
    left_road: bool
    pose_error: Floats

    def scored(self) -> NDArray[np.bool_]:
        """From three seconds after the handover on."""
        return np.asarray(self.stamp_s >= self.engaged_s + SETTLE_S)

    def rms_m(self) -> float:
        """RMS of the lateral error."""
        return float(np.sqrt(np.mean(self.lateral_m[self.scored()] ** 2)))

    def largest_m(self) -> float:
        """Largest lateral error."""
        return float(np.abs(self.lateral_m[self.scored()]).max())

    def swings(self) -> int:
        """Longest row of successive quick swings; see `SWINGS`."""
        late = self.scored()
        return longest_swinging(self.stamp_s[late], self.lateral_m[late])

    def pose_jump_m(self) -> float:
        """Largest change of the pose's error from one hundredth of a second to the next."""
        steps = np.hypot(*np.diff(self.pose_error[self.scored(), :2], axis=0).T)
        return float(np.nanmax(steps, initial=0.0))

    def pose_rms_m(self) -> tuple[float, float]:
        """RMS of the pose's error, along and lateral."""
        error = self.pose_error[self.scored(), :2]
        along, lateral = np.sqrt(np.nanmean(error**2, axis=0)).tolist()
        return along, lateral

    def steer_rate_rms_radps(self) -> float:
        """How restless the wheel is."""
        rate = np.diff(self.steer_rad) / STEER_S
        return float(np.sqrt(np.mean(rate[self.scored()[1:]] ** 2)))


def longest_swinging(stamps_s: Floats, values: Floats) -> int:
    """Length of the longest row of swings of `SWING_M` or more that take `SWING_S` or less each."""
    turns: list[tuple[float, float]] = []
    best, worst = 0, 0
    low = high = (float(stamps_s[0]), float(values[0]))
    way = 0
    for stamp, value in zip(stamps_s.tolist(), values.tolist(), strict=True):
        if value > high[1]:
            high = (stamp, value)
        if value < low[1]:
            low = (stamp, value)
        if way >= 0 and high[1] - value >= SWING_M:
            turns.append(high)
            way, low = -1, (stamp, value)
        elif way <= 0 and value - low[1] >= SWING_M:
            turns.append(low)
            way, high = 1, (stamp, value)
    for (begin, _), (end, _) in pairwise(turns):
        worst = worst + 1 if end - begin <= SWING_S else 0
        best = max(best, worst)
    return best
