"""The speed to be believed: the wheels', or what ax and GPS say where the wheels are faulty."""

from __future__ import annotations

from polemap.electric.isolation.late import Event
from polemap.electric.isolation.motion import Moment, Motion

# what no car gains in a second, and what noise and a stone under a wheel add in a tick
IMPOSSIBLE_MPS2, _LEAP_MPS = 13.0, 1.5
# share of the way to a GPS's speed that a fix moves the speed
_GPS_SHARE = 0.3


class TrustedSpeed:
    """Follows the wheels while they are believed.

    Attributes:
        mps: the speed.
    """

    def __init__(self, speed_mps: float, motion: Motion) -> None:
        self.mps = speed_mps
        self._motion, self._at = motion, motion.now

    def leaps(self, wheel_mps: float, elapsed_s: float) -> bool:
        """Whether wheels gained since the last look what no car gains."""
        return abs(wheel_mps - self.mps) > IMPOSSIBLE_MPS2 * elapsed_s + _LEAP_MPS

    def follow(self, wheel_mps: float) -> None:
        """The wheels are believed."""
        self.mps, self._at = wheel_mps, self._motion.now

    def carry(self, *, by_ax: bool) -> None:
        """The wheels are not; `by_ax`: the accelerometer is."""
        now = self._motion.now
        if by_ax:
            self.mps = max(self.mps + now.forward - self._at.forward, 0.0)
        self._at = now

    def toward(self, fix: Event, *, by_ax: bool) -> None:
        """A GPS's speed, carried to now."""
        speed = fix.other
        if by_ax:
            speed += self._motion.now.forward - fix.moment.forward
        self.mps += _GPS_SHARE * (speed - self.mps)

    def from_before(self, moment: Moment, fix: Event | None, *, by_ax: bool) -> None:
        """The wheels have lied since `moment`: go on from there, or from a GPS's speed."""
        now = self._motion.now
        speed = moment.wheel + (now.forward - moment.forward if by_ax else 0.0)
        self.mps = max(speed if fix is None else fix.other, 0.0)
        self._at = now
