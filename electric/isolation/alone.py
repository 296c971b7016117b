"""What a fast sensor tells of itself: a value that never moves, noise beyond its own, spikes."""

from __future__ import annotations

from math import exp

import numpy as np
from numpy.typing import NDArray

from polemap.electric.isolation.shared_movement import Recent

Floats = NDArray[np.float64]

GYRO, STEERING, WHEEL_SPEED = "gyro", "steering", "wheel speed"
LATERAL, FORWARD = "lateral accelerometer", "forward accelerometer"
FAST = (STEERING, WHEEL_SPEED, FORWARD, LATERAL, GYRO)
COLUMNS = (0, 1, 3, 4, 5)
"""Where `FAST` stand in `Inputs`."""
# deviations of the best of such sensors, and jumps of one value that no car makes in a row
LEAST_SD = np.array([5e-5, 5e-3, 0.02, 0.02, 5e-4])
LEAST_SPIKE = np.array([0.06, 1.5, 12.0, 12.0, 0.3])
SPIKE_SD = 8.0
# the second difference of white noise has 1 + 4 + 1 times its variance
_SECOND = 6.0**0.5
# times its own noise, in nearly all ticks of half a second
_NOISY, _NOISY_SHARE, _FADE = 5.0, 0.85, 0.8
# what a rough road shakes accelerometers by, however quiet the last one was
_ROUGH_SD = np.array([0.0, 0.0, 0.8, 0.8, 0.0])
# who else shows it where a car shakes: an acceleration in the wheels' speed, a side force and the
# steering that makes one in the yaw rate
_SHARED = ((FORWARD, WHEEL_SPEED), (LATERAL, GYRO), (STEERING, GYRO))
_HARD_MPS2 = 2.5
# a signal that climbs in stairs has no more than so many times its slope
_STAIRS = 2.0
_LEARN_TICKS, _LEARN_RATE = 20, 0.003
# a sensor that has never kept a value for longer than this is never still while a car drives;
# it is stuck after so many times its longest run, and this at least
_LIVELY_S, _STUCK_RUNS, _LEARN_S = 0.06, 5.0, 8.0
# steering and wheels are counted in steps and may stand for a while
_STUCK_S = np.array([1.0, 1.0, 0.25, 0.25, 0.25])

CONSTANT, NOISY, SPIKES = "constant", "ten times its noise", "single values far off"


class OwnChecks:
    """Looks at rows of inputs tick by tick.

    Attributes:
        still_s: `(5,)` how long each of `FAST` has kept its value.
        base: `(5,)` what each scatters by itself, 0 until learned.
    """

    def __init__(self, stamp_s: float) -> None:
        self._tail = np.zeros((0, 5))
        self._moved_s, self._end_s = 0.0, stamp_s
        self._since_s = np.full(5, np.nan)
        self._longest_s = np.zeros(5)
        self._started = np.zeros(5, dtype=bool)
        self._first: list[Floats] = []
        self.base = np.zeros(5)
        self._share = np.zeros(5)
        self._recent = Recent()
        self.still_s = np.zeros(5)

    def look(self, stamps_s: Floats, table: Floats, moving: bool) -> dict[str, str]:
        """Rows `(n, 7)` of inputs at stamps `(n,)`; what is wrong with which sensor."""
        values = np.concatenate([self._tail, table[:, COLUMNS]])
        self._tail = values[-2:]
        self._recent.add(stamps_s, table)
        found = dict.fromkeys(self._constant(stamps_s, values, len(table), moving), CONSTANT)
        if len(values) < 6:
            return found
        first = values[1:] - values[:-1]
        second = first[1:] - first[:-1]
        # a staircase of a steep signal is no noise
        slope = np.abs(values[-1] - values[0]) / (len(values) - 1)
        if not self._noise(second, slope, moving):
            return found
        sd = np.maximum(self.base, LEAST_SD)
        limit = np.maximum(LEAST_SPIKE, SPIKE_SD * sd)
        turned = (first[1:] * first[:-1] < 0.0) & (np.abs(first[1:]) > limit)
        spiked = (turned & (np.abs(first[:-1]) > limit)).any(axis=0)
        loud = self._share > _NOISY_SHARE
        shaken = self._shaken() if loud.any() else set()
        for name, noisy, spike in zip(FAST, loud, spiked, strict=True):
            if noisy and name not in shaken:
                found.setdefault(name, NOISY)
            elif spike:
                found.setdefault(name, SPIKES)
        return found

    def _shaken(self) -> set[str]:
        """Sensors whose fast changes others show as well: the car moves so."""
        place = dict(zip(FAST, COLUMNS, strict=True))
        shaken: set[str] = set()
        for cause, moved in _SHARED:
            told = self._recent.compared(place[cause], place[moved])
            if told.shared:
                shaken |= {cause, moved}
            elif cause == FORWARD and told.hidden:
                # brakes and drive at their limit pulse, and these wheels would not show it
                hard = self._recent.hardest(place[moved]) > _HARD_MPS2
                shaken |= {cause} if hard else set()
        return shaken

    def _constant(self, stamps_s: Floats, values: Floats, rows: int, moving: bool) -> list[str]:
        end = float(stamps_s[-1])
        self._moved_s += moving * (end - self._end_s)
        self._end_s = end
        start = len(values) - rows
        if not start:
            self._since_s[:] = stamps_s[0]
            start = 1
            stamps_s = stamps_s[1:]
        changed = values[start:] != values[start - 1 : -1]
        stuck = []
        for index, name in enumerate(FAST):
            rows_changed = np.flatnonzero(changed[:, index])
            if len(rows_changed):
                ends = stamps_s[rows_changed]
                runs = ends - np.concatenate([self._since_s[index : index + 1], ends[:-1]])
                if self._started[index]:
                    if runs[0] <= self._limit(index):
                        self._longest_s[index] = max(self._longest_s[index], float(runs.max()))
                else:
                    self._started[index] = True
                    self._longest_s[index] = float(runs[1:].max()) if len(runs) > 1 else 0.0
                self._since_s[index] = ends[-1]
            self.still_s[index] = end - self._since_s[index]
            lively = self._moved_s > _LEARN_S and self._longest_s[index] <= _LIVELY_S
            if lively and moving and self.still_s[index] > self._limit(index):
                stuck.append(name)
        return stuck

    def _limit(self, index: int) -> float:
        return max(float(_STUCK_S[index]), _STUCK_RUNS * float(self._longest_s[index]))

    def _noise(self, second: Floats, slope: Floats, moving: bool) -> bool:
        """Learn or compare; whether enough was learned to compare."""
        sd = np.sqrt(np.mean(second * second, axis=0)) / _SECOND
        if len(self._first) < _LEARN_TICKS:
            if moving:
                self._first.append(sd)
                self.base = np.maximum(np.median(self._first, axis=0), LEAST_SD)
            return False
        if moving:
            self._share = _FADE * self._share + (1.0 - _FADE) * (
                sd > np.maximum(np.maximum(_NOISY * self.base, _ROUGH_SD), _STAIRS * slope)
            )
            self.base = self.base * exp(_LEARN_RATE) ** np.sign(sd - self.base)
            self.base = np.maximum(self.base, LEAST_SD)
        return True
