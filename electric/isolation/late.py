"""What camera and GPS told, beside the motion at the moments they measured."""

from __future__ import annotations

from collections import deque
from math import exp
from typing import NamedTuple

import numpy as np

from polemap.electric.isolation.motion import LONGEST_S, Moment

_SAME_VALUES = 5
# silence: so many periods, and this at least
_SILENT_PERIODS, _SILENT_S = 5.0, 1.0
_NOISE_VALUES, _NOISY, _LEARN_RATE = 10, 5.0, 0.03


class Event(NamedTuple):
    """A late value: angle (rad), the other number, and the motion at its capture.

    `way` is the sum of angle times distance (camera): what the heading moves the car aside, m.
    `sd_rad` is what the value states of its angle, 0 where it does not.
    """

    moment: Moment
    angle_rad: float
    other: float
    way: float
    sd_rad: float = 0.0


class LateSensor:
    """Events of one late sensor over the last seconds.

    Args:
        sd_rad: of its angle as configured.
        in_lane: whether its angle is counted from the lane (camera) or from the earth (GPS).
        least_rad: what its angle may change by from value to value beside the gyro's turn.
    """

    def __init__(self, sd_rad: float, least_rad: float, *, in_lane: bool) -> None:
        self._in_lane = in_lane
        self._least_rad = least_rad
        self.events: deque[Event] = deque(maxlen=600)
        self._captured: dict[float, Moment] = {}
        self._arrived_s = float("nan")
        self._periods: deque[float] = deque(maxlen=9)
        self._base = 1.5 * sd_rad
        self._off: deque[float] = deque(maxlen=_NOISE_VALUES)

    def captured(self, moment: Moment) -> None:
        """The sensor measures at `moment`."""
        self._captured[moment.stamp_s] = moment
        if len(self._captured) > 64:
            del self._captured[next(iter(self._captured))]

    def arrived(
        self, stamp_s: float, angle_rad: float, other: float, arrival_s: float, sd_rad: float = 0.0
    ) -> bool:
        """A value of the capture at `stamp_s`; whether it could be placed."""
        self._arrived_s = arrival_s
        moment = self._captured.pop(stamp_s, None)
        if moment is None:
            return False
        way = 0.0
        if self.events:
            last = self.events[-1]
            if moment.stamp_s <= last.moment.stamp_s:
                return False
            self._periods.append(moment.stamp_s - last.moment.stamp_s)
            angle_rad = last.angle_rad + _wrapped(angle_rad - last.angle_rad)
            gone = moment.distance - last.moment.distance
            way = last.way + 0.5 * (angle_rad + last.angle_rad) * gone
            turned = moment.gyro - last.moment.gyro
            if self._in_lane:
                turned -= moment.lane - last.moment.lane
            self._off.append(abs(angle_rad - last.angle_rad - turned))
        self.events.append(Event(moment, angle_rad, other, way, sd_rad))
        while self.events[0].moment.stamp_s < moment.stamp_s - LONGEST_S - 1.0:
            self.events.popleft()
        return True

    def before(self, window_s: float) -> Event | None:
        """The event nearest before `window_s` ago, none where there is none within half as much."""
        wanted = self.events[-1].moment.stamp_s - window_s
        for event in reversed(self.events):
            if event.moment.stamp_s <= wanted + 1e-6:
                return event if event.moment.stamp_s > wanted - 0.5 * window_s else None
        return None

    def ahead_since(self, stamp_s: float) -> float:
        """What the newest angle is ahead of the last before `stamp_s` and the gyro's turn since."""
        sound = [event for event in self.events if event.moment.stamp_s < stamp_s]
        if not sound:
            return 0.0
        last, then = self.events[-1], sound[-1]
        return last.angle_rad - then.angle_rad - (last.moment.gyro - then.moment.gyro)

    def constant(self) -> bool:
        """Whether the last values are all the same to the last digit."""
        if len(self.events) < _SAME_VALUES:
            return False
        last = self.events[-1]
        recent = [self.events[-1 - k] for k in range(_SAME_VALUES)]
        return all(e.angle_rad == last.angle_rad and e.other == last.other for e in recent)

    def noisy(self, sd_rad: float) -> bool:
        """Whether its angle scatters about the gyro's turn by many times what it used to.

        `sd_rad` is what it states for now.
        """
        if len(self._off) < _NOISE_VALUES:
            return False
        spread = sorted(self._off)[_NOISE_VALUES // 2]
        self._base *= exp(_LEARN_RATE * float(np.sign(spread - self._base)))
        self._base = max(self._base, 1e-3)
        return spread > max(_NOISY * max(self._base, sd_rad), self._least_rad)

    def together_s(self) -> float:
        """Values within so long of each other are neighbours."""
        return 2.5 * sorted(self._periods)[len(self._periods) // 2] if self._periods else 0.0

    def silent(self, stamp_s: float) -> bool:
        """Whether nothing has come for many times its period."""
        if len(self._periods) < 3:
            return False
        limit = max(_SILENT_S, _SILENT_PERIODS * float(np.median(self._periods)))
        return stamp_s - self._arrived_s > limit


def _wrapped(angle_rad: float) -> float:
    return float(np.arctan2(np.sin(angle_rad), np.cos(angle_rad)))
