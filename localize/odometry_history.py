"""The recent odometry: exact arcs between any two moments, and dead reckoning.

Scans and fixes arrive late and between odometry samples, so the samples are kept for a while and
integrated from any stamp to any other. Through a hole the last rates hold on, and the arcs say how
much of them is blind. (The tracker, which stops at a hole, has `polemap.track.frame_motion`.)
"""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass
from itertools import pairwise
from math import inf, isfinite

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.odometry_window import OdometryWindow
from polemap.drivelog.samples import OdometrySample
from polemap.vehicle import packed

Floats = NDArray[np.float64]
_KEEP_S = 90.0
GAP_S = 0.5
"""A time without samples that is longer than this is a hole: 25 samples at 50 Hz."""


@dataclass(frozen=True, slots=True)
class Arc:
    """Motion at constant rates: duration, mean speed and yaw rate, and the part of the duration
    for which no odometry was near."""

    dt_s: float
    speed_mps: float
    yaw_rate_radps: float
    blind_s: float


class OdometryHistory:
    """Odometry of the last minute and a half, linear between its samples.

    Beyond the newest sample its speed and yaw rate hold on. Dead reckoning starts at the origin
    with the first sample; only differences of it mean anything.

    Attributes:
        slip_rad_per_mps2: the rear axle slips outward by this angle per lateral acceleration.
    """

    def __init__(self, slip_rad_per_mps2: float = 0.0, gap_s: float = GAP_S) -> None:
        self._gap_s = gap_s
        self.slip_rad_per_mps2 = slip_rad_per_mps2
        self._window = OdometryWindow(_KEEP_S, slack=1.5)
        self._stamps = self._window.stamps_s
        self._speeds = self._window.speeds_mps
        self._yaw_rates = self._window.yaw_rates_radps
        self._x: list[float] = []
        self._y: list[float] = []
        self._yaw: list[float] = []
        self._travelled: list[float] = []

    def __len__(self) -> int:
        return len(self._stamps)

    @property
    def newest_s(self) -> float:
        """Stamp of the newest sample, minus infinity before the first."""
        return self._window.newest_s

    def append(self, sample: OdometrySample) -> bool:
        """Append a sample; False if it is not newer than the last or not finite."""
        values = (sample.stamp_s, sample.speed_mps, sample.yaw_rate_radps)
        if not all(map(isfinite, values)) or sample.stamp_s <= self.newest_s:
            return False
        if self._stamps:
            self._integrate_to(*values)
        else:
            for track in (self._x, self._y, self._yaw, self._travelled):
                track.append(0.0)
        self._window.insert(sample)
        dropped = self._window.forget()
        if dropped:
            for track in (self._x, self._y, self._yaw, self._travelled):
                del track[:dropped]
        return True

    def _integrate_to(self, stamp_s: float, speed: float, yaw_rate: float) -> None:
        dt = stamp_s - self._stamps[-1]
        distance = 0.5 * (speed + self._speeds[-1]) * dt
        turn = 0.5 * (yaw_rate + self._yaw_rates[-1]) * dt
        east, north = packed.arc_displacement(
            self._yaw[-1], distance, turn, self._sideslip(speed, yaw_rate)
        )
        self._x.append(self._x[-1] + east)
        self._y.append(self._y[-1] + north)
        self._yaw.append(self._yaw[-1] + turn)
        self._travelled.append(self._travelled[-1] + abs(distance))

    def _sideslip(self, speed_mps: float, yaw_rate_radps: float) -> float:
        return -self.slip_rad_per_mps2 * speed_mps * yaw_rate_radps

    def rates_at(self, stamp_s: float) -> tuple[float, float]:
        """Speed and yaw rate at a stamp; zero before the first sample exists."""
        return self._window.rates_at(stamp_s)

    def arcs(self, start_s: float, end_s: float, longest_s: float) -> list[Arc]:
        """Arcs from `start_s` to `end_s`; neighbouring samples are joined up to `longest_s`."""
        if end_s <= start_s:
            return []
        low = bisect_right(self._stamps, start_s)
        high = bisect_right(self._stamps, end_s)
        knots = [start_s, *(t for t in self._stamps[low:high] if t < end_s), end_s]
        pieces: list[Arc] = []
        left = self.rates_at(start_s)
        dt = turn = distance = blind = 0.0
        for a, b in pairwise(knots):
            right = self.rates_at(b)
            step = b - a
            if dt > 0.0 and dt + step > longest_s + 1e-9:
                pieces.append(Arc(dt, distance / dt, turn / dt, blind))
                dt = turn = distance = blind = 0.0
            dt += step
            distance += 0.5 * (left[0] + right[0]) * step
            turn += 0.5 * (left[1] + right[1]) * step
            blind += self._blind(a, b)
            left = right
        pieces.append(Arc(dt, distance / dt, turn / dt, blind))
        return pieces

    def _blind(self, a: float, b: float) -> float:
        """The part of [a, b], which holds no sample inside, that lies in a gap of the odometry."""
        i = bisect_right(self._stamps, a)
        before = self._stamps[i - 1] if i > 0 else -inf
        after = self._stamps[i] if i < len(self._stamps) else inf
        if after - before <= self._gap_s:
            return 0.0
        # within the gap's length of a sample its value still holds
        known_until = before + self._gap_s
        return max(0.0, b - max(a, known_until))

    def odometry_pose(self, stamp_s: float) -> Floats:
        """Pose `(3,)` of the rear axle in the dead-reckoning frame, yaw not wrapped."""
        if not self._stamps:
            return np.zeros(3)
        i = max(bisect_right(self._stamps, stamp_s) - 1, 0)
        dt = stamp_s - self._stamps[i]
        speed, yaw_rate = self.rates_at(stamp_s)
        distance = 0.5 * (self._speeds[i] + speed) * dt
        turn = 0.5 * (self._yaw_rates[i] + yaw_rate) * dt
        east, north = packed.arc_displacement(
            self._yaw[i], distance, turn, self._sideslip(speed, yaw_rate)
        )
        return np.array([self._x[i] + east, self._y[i] + north, self._yaw[i] + turn])

    def travelled_m(self, stamp_s: float) -> float:
        """Length of the path up to a stamp, counted from the first sample."""
        if not self._stamps:
            return 0.0
        i = max(bisect_right(self._stamps, stamp_s) - 1, 0)
        speed, _ = self.rates_at(stamp_s)
        moved = 0.5 * (self._speeds[i] + speed) * (stamp_s - self._stamps[i])
        return self._travelled[i] + abs(moved)
