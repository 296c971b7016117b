"""Which speed is believed: wheels that leap, wheels and GPS that differ, and what stands in."""

from __future__ import annotations

from polemap.electric.isolation.alone import FORWARD, GYRO, LATERAL, STEERING, WHEEL_SPEED
from polemap.electric.isolation.families import CAMERA, GPS, Families
from polemap.electric.isolation.late import LateSensor
from polemap.electric.isolation.motion import SLOW_MPS, Motion
from polemap.electric.isolation.speed import TrustedSpeed
from polemap.electric.isolation.suspicion import Suspicions

_TURNING_RADPS = 0.12
_FRESH_S = 1.0
DIFFER_S = 2.0
"""Window of the evidence that wheels and GPS tell different speeds."""


class SpeedWatch:
    """Keeps the speed to be believed, and says what speaks against those who tell one.

    Args:
        heard: names of the sensors that have spoken; grows.
        gps: what the receiver told.

    Attributes:
        speed: the wheels', or what stands in for it.
        heard: names of the sensors that have spoken.
    """

    def __init__(
        self,
        speed_mps: float,
        motion: Motion,
        suspicions: Suspicions,
        heard: set[str],
        gps: LateSensor,
    ) -> None:
        self._motion, self._suspicions, self.heard, self._gps = motion, suspicions, heard, gps
        self._faulty = suspicions.faulty
        self.speed = TrustedSpeed(speed_mps, motion)

    def by_ax(self) -> bool:
        """Whether the accelerometer ahead tells what the car gains."""
        return FORWARD in self.heard and FORWARD not in self._faulty

    def follow(self, wheel_mps: float, now_s: float) -> str | None:
        """Take in the wheels' speed of now; what speaks against them."""
        last = self._motion.now
        if WHEEL_SPEED in self._faulty:
            self.speed.carry(by_ax=self.by_ax())
            return None
        gone = self.speed.leaps(wheel_mps, now_s - last.stamp_s)
        known = WHEEL_SPEED in self.heard and self._motion.before(1.0) is not None
        if gone and known and self.speed.mps > SLOW_MPS:
            return f"leaps by {wheel_mps - self.speed.mps:.2g} m/s"
        self.speed.follow(wheel_mps)
        return None

    def doubt(self, now_s: float, window_s: float) -> None:
        """Take the speed from before the wheels lied, and begin anew what rests on it."""
        before = self._motion.before(max(2.0 * window_s, 0.5)) or self._motion.moments[0]
        fix = self._gps.events[-1] if self.fresh_fix() else None
        self.speed.from_before(before, fix, by_ax=self.by_ax())
        self.changed(now_s)

    def changed(self, now_s: float) -> None:
        """Another speed is believed from now on: what rests on it is compared anew."""
        self._suspicions.compare_from((LATERAL, STEERING, FORWARD, CAMERA), now_s)

    def fresh_fix(self) -> bool:
        """Whether a receiver that is believed has just told a speed."""
        events = self._gps.events
        return (
            bool(events)
            and GPS not in self._faulty
            and self._motion.now.stamp_s - events[-1].moment.stamp_s < _FRESH_S
        )

    def compare(self, families: Families, now_s: float) -> tuple[str, str] | None:
        """Wheel and GPS speeds that differ all the time: which of them the turning car denies.

        Returns:
            Its name and the evidence; None where they agree, or where one is faulty already.
        """
        last = self._gps.events[-1]
        if WHEEL_SPEED not in self.heard:
            return None
        differ = not families.same_speed(last)
        if WHEEL_SPEED in self._faulty:
            if differ:
                self._suspicions.still_against(WHEEL_SPEED, now_s, DIFFER_S)
            if GPS not in self._faulty:
                self.speed.toward(last, by_ax=self.by_ax())
            return None
        if not differ:
            return None
        if GPS in self._faulty:
            self._suspicions.still_against(GPS, now_s, DIFFER_S)
            return None
        first = self._gps.before(DIFFER_S)
        if first is None:
            return None
        start, end = first.moment, last.moment
        guilty, t = WHEEL_SPEED, end.stamp_s - start.stamp_s
        turned = end.gyro - start.gyro
        if {LATERAL, GYRO} <= self.heard - self._faulty and abs(turned) > _TURNING_RADPS * t:
            # ay over the yaw rate is a third speed; the lateral turn is the integral of ay / v
            third = (end.lateral - start.lateral) / turned * (end.distance - start.distance) / t
            if abs(third - last.moment.wheel) < abs(third - last.other):
                guilty = GPS
        return guilty, f"wheel speed and GPS differ by {last.moment.wheel - last.other:.2g} m/s"
