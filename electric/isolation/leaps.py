"""Gyro and steering that leap: steps within a row that no car makes, held back until they last.

A vote needs half a second to see a step; a filter that hears it is wrong by then. What turns a car
are its tyres: their moment is bounded by friction, about g / wheelbase at one axle's limit, and no
driver turns a steering wheel by more than 1000 degrees/s. A step
beyond that, the sensor's own noise on top, is not told until it has lasted; then the sensor is at
fault. What comes back before is a single wild value, of which nothing is told.
"""

from __future__ import annotations

# times the sensor's own noise
_NOISY = 10.0
# a step that has not come back by half within so long lasts
LASTING_S = 0.04
_BACK_SHARE = 0.5
# longer silence tells nothing of a step
_APART_S = 0.2


class Leaps:
    """Watches one signal value by value.

    Args:
        rate: what it changes by in a second at the most.
        floor: what quantisation and vibration add to a change.

    Attributes:
        held: whether the last value was held back.
        before: what stood before the step.
        noise: the sensor's own deviation, as far as it is known.
    """

    __slots__ = (
        "_change_s",
        "_earlier",
        "_floor",
        "_rate",
        "_since_s",
        "_size",
        "before",
        "held",
        "noise",
    )

    def __init__(self, rate: float, floor: float, noise: float = 0.0) -> None:
        self._rate, self._floor = rate, floor
        self.before = self._earlier = self._change_s = float("nan")
        self._since_s = self._size = 0.0
        self.noise = noise
        self.held = False

    def hold_back(self, value: float, stamp_s: float) -> bool:
        """Whether a value is part of a step."""
        change, floor = value - self.before, self._floor
        if not self.held and -floor < change < floor:
            if change:
                self.before, self._change_s = value, stamp_s
            return False
        return self._step(value, change, stamp_s)

    def _step(self, value: float, change: float, stamp_s: float) -> bool:
        if self.held:
            self.held = change * self._size > _BACK_SHARE * self._size * self._size
        else:
            elapsed = stamp_s - self._change_s
            limit = self._rate * elapsed + max(self._floor, _NOISY * self.noise)
            back = abs(value - self._earlier) < _BACK_SHARE * abs(change)
            self.held = elapsed < _APART_S and abs(change) > limit and not back
            self._since_s, self._size = stamp_s, change
        if not self.held:
            # where a wild value came after long silence, the way back from it is no leap
            self._earlier = self.before
            self.before, self._change_s = value, stamp_s
        return self.held

    def lasts(self, value: float, stamp_s: float) -> float:
        """The step's size where it has lasted by now, else 0; `value` is the level from now on."""
        if not self.held or stamp_s - self._since_s < LASTING_S - 1e-6:
            return 0.0
        self.held = False
        self.before, self._change_s = value, stamp_s
        return self._size
