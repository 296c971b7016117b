"""Watches the computer's clock, and the stamps of each sensor against the times of arrival.

The computer's clock may be set while a car drives: `ComputerClock` sees that in the arrivals of all
sensors together, and what lies behind it never notices. A stamp that lies in the future of its
arrival, or that falls behind the sensor's own earlier stamps and stays there, can only be a
sensor's clock's fault. Until several samples agree on the size of the step they are dropped; then
the step is taken out of every later stamp, so that the sensor is of use again. A mere delay never
looks like that, and is left to the replay.
"""

from __future__ import annotations

from collections import Counter

FUTURE_S = 0.05
"""A stamp may lie this far behind its arrival: clocks of one car, synchronised by software."""
STEP_SAMPLES = 5
"""Samples in a row that must agree on a step: 0.1 s of odometry."""
# no clock of a car reads more, in seconds of any era: what lies beyond is a damaged number
_LATEST_S = 1e10
# arrivals this far apart are a hole, and this far back a clock that was set: sensors that share a
# queue come out of order by less
_HOLE_S, _BACK_S = 60.0, 1.0
# a smaller step is a delay like any other
_STEP_S = 0.5
# a sensor silent for longer has stopped
_SILENCE_S = 0.5
# samples that agree on a step do so to this
_AGREE_S = 0.05
# the typical delay follows short delays at once and long ones slowly
_TYPICAL_SHARE = 0.01


def is_time(stamp_s: float) -> bool:
    """Whether a clock can read this: false for NaN, infinity and what leaves no digits for time."""
    return abs(stamp_s) <= _LATEST_S


class ComputerClock:
    """The clock that arrivals are read from, made steady.

    A sample that arrives long before the last one, or more than a minute after it, is dropped, and
    so are the next, until five in a row agree that time has gone on there. Then the clock was set
    back, and from then on all stamps and arrivals are moved by as much; or there was a hole.

    Attributes:
        correction_s: to be added to what the clock reads.
        counts: `clock_ahead`, `clock_back` (dropped), `computer_clock_steps`.
    """

    def __init__(self) -> None:
        self.counts: Counter[str] = Counter()
        self.correction_s = 0.0
        self._newest_s: float | None = None
        self._suspects: list[float] = []

    def accept(self, arrival_s: float) -> bool:
        """Whether a sample of this arrival may be used, with the correction that then holds."""
        if not is_time(arrival_s):
            return True  # the sensor's own clock counts it and drops it
        arrival = arrival_s + self.correction_s
        newest = arrival if self._newest_s is None else self._newest_s
        if -_BACK_S <= arrival - newest <= _HOLE_S:
            self._suspects.clear()
            self._newest_s = max(newest, arrival)
            return True
        if self._suspects and not -_BACK_S <= arrival - self._suspects[-1] <= _HOLE_S:
            self._suspects.clear()
        self._suspects.append(arrival)
        if len(self._suspects) < STEP_SAMPLES:
            self.counts["clock_back" if arrival < newest else "clock_ahead"] += 1
            return False
        first = self._suspects[0]
        self._suspects.clear()
        if arrival < newest:
            self.counts["computer_clock_steps"] += 1
            self.correction_s += newest - first
            arrival += newest - first
        self._newest_s = arrival
        return True


class StreamClock:
    """One sensor's stamps.

    `counts` holds what was found, by kind: not_finite (or no time that a clock can read), future,
    clock_backwards (dropped while a step is being made sure of), clock_steps, silences.
    """

    def __init__(self) -> None:
        self.counts: Counter[str] = Counter()
        self.silent_s = 0.0
        self._correction_s = 0.0
        self._delay_s: float | None = None
        self._period_s: float | None = None
        self._newest_s = float("-inf")
        self._last_arrival_s: float | None = None
        self._suspects: list[float] = []

    def checked_stamp(self, stamp_s: float, arrival_s: float) -> float | None:
        """The stamp to use, or None if the sample must be dropped (and has been counted)."""
        if not (is_time(stamp_s) and is_time(arrival_s)):
            self.counts["not_finite"] += 1
            return None
        self._watch_silence(arrival_s)
        stamp = stamp_s + self._correction_s
        delay = arrival_s - stamp
        problem = self._problem(stamp, delay)
        if problem is None:
            self._suspects.clear()
            self._note(stamp, delay)
            return stamp
        self._suspects.append(delay)
        if not self._step_is_sure():
            self.counts[problem] += 1
            return None
        self.counts["clock_steps"] += 1
        self._correction_s += delay - (self._delay_s or 0.0)
        self._suspects.clear()
        stamp = stamp_s + self._correction_s
        self._newest_s = stamp
        return stamp

    def _problem(self, stamp: float, delay: float) -> str | None:
        if delay < -FUTURE_S:
            return "future"
        step = _STEP_S
        typical = self._delay_s
        if typical is not None and stamp < self._newest_s - step and delay > typical + step:
            return "clock_backwards"
        return None

    def _step_is_sure(self) -> bool:
        needed = STEP_SAMPLES
        last = self._suspects[-needed:]
        return len(last) == needed and max(last) - min(last) < _AGREE_S

    def _note(self, stamp: float, delay: float) -> None:
        # nothing arrives before it was measured: below zero it is the clock that runs fast
        delay = max(delay, 0.0)
        if self._delay_s is None or delay < self._delay_s:
            self._delay_s = delay
        else:
            self._delay_s += _TYPICAL_SHARE * (delay - self._delay_s)
        if stamp > self._newest_s:
            self._newest_s = stamp

    def _watch_silence(self, arrival_s: float) -> None:
        last, self._last_arrival_s = self._last_arrival_s, arrival_s
        if last is None:
            return
        gap = arrival_s - last
        if self._period_s is None:
            self._period_s = gap
        limit = max(_SILENCE_S, 3.0 * self._period_s)
        if gap > limit:
            self.counts["silences"] += 1
            self.silent_s += gap
            return
        self._period_s += 0.1 * (max(gap, 0.0) - self._period_s)
