"""The odometry of the last seconds, and how the vehicle moved from one frame to the next.

Tracks would rather be dropped than moved by a guess, so a hole in the odometry is told, and samples
that come late still count. A localizer's dead reckoning, which goes on through holes, is another
matter.
"""

from __future__ import annotations

from collections import deque

import numpy as np

from polemap.drivelog.samples import OdometrySample
from polemap.track.tracks import Motion
from polemap.vehicle.motion import move_along_arc


class OdometryWindow:
    """Keeps samples sorted by stamp; late and doubled ones find their place."""

    def __init__(self, keep_s: float = 10.0, gap_max_s: float = 1.0) -> None:
        self._samples: deque[tuple[float, float, float]] = deque()
        self._keep_s = keep_s
        self._gap_max_s = gap_max_s

    def push(self, sample: OdometrySample) -> None:
        """Take a sample; one with a value that is not finite is left out."""
        row = (sample.stamp_s, sample.speed_mps, sample.yaw_rate_radps)
        if not np.isfinite(row).all():
            return
        late = []
        while self._samples and self._samples[-1][0] >= row[0]:
            late.append(self._samples.pop())
        self._samples.append(row)
        self._samples.extend(other for other in reversed(late) if other[0] > row[0])
        while self._samples[-1][0] - self._samples[0][0] > self._keep_s:
            self._samples.popleft()

    def between(self, start_s: float, end_s: float) -> Motion | None:
        """The motion from `start_s` to `end_s`; None where the odometry does not cover it.

        Speed and yaw rate are linear between samples and held beyond the first and the last one.
        """
        if not self._samples or end_s < start_s:
            return None
        recent = []
        for row in reversed(self._samples):
            recent.append(row)
            if row[0] <= start_s:  # what came before says nothing about the time from here on
                break
        stamp, speed, rate = np.array(recent[::-1]).T
        near = (stamp > start_s - self._gap_max_s) & (stamp < end_s + self._gap_max_s)
        inside = stamp[near]
        if not len(inside) or np.diff(np.r_[start_s, inside, end_s]).max() > self._gap_max_s:
            return None
        knots = np.r_[start_s, stamp[(stamp > start_s) & (stamp < end_s)], end_s]
        dt = np.diff(knots)
        middle = 0.5 * (knots[1:] + knots[:-1])
        distance = np.interp(middle, stamp, speed) * dt
        turn = np.interp(middle, stamp, rate) * dt
        # every arc on its own, from the origin in the direction that those before it led to
        begin = np.zeros((len(turn), 3))
        begin[1:, 2] = np.cumsum(turn[:-1])
        arcs = move_along_arc(begin, distance, turn)
        return Motion(
            dt_s=end_s - start_s,
            forward_m=float(arcs[:, 0].sum()),
            left_m=float(arcs[:, 1].sum()),
            turn_rad=float(turn.sum()),
            distance_m=float(np.abs(distance).sum()),
        )
