"""The clock of a stream that is followed: what time it is now on the clock of its stamps."""

from __future__ import annotations

from collections.abc import Callable
from math import nan
from threading import Lock

_STEP_S = 60.0
_STEP_SAMPLES = 5


class StreamTime:
    """Runs as the computer's steady clock does, set by the sample that was underway the least.

    A sample that is known now cannot have been measured later than now; the one with the smallest
    delay tells how the stream's clock stands. Samples in bursts (chunks of a recorder) do not
    disturb that.

    Attributes:
        began_s: time of recording of the first sample on the clock as it stands; NaN before it.
    """

    def __init__(self, clock: Callable[[], float]) -> None:
        """`clock` is monotonic, in seconds."""
        self._clock = clock
        self._offset_s: float | None = None
        self._suspects: list[float] = []
        self._lock = Lock()
        self.began_s = nan

    def note(self, log_s: float) -> None:
        """A sample with this time of recording has just been taken in.

        One that is a minute off is not believed before `_STEP_SAMPLES` in a row agree: a stamp may
        be wrong, a clock be set, a recorder start anew.
        """
        offset = log_s - self._clock()
        with self._lock:
            if self._offset_s is None:
                self._offset_s, self.began_s = offset, log_s
            elif abs(offset - self._offset_s) > _STEP_S:
                self._suspect(offset, log_s)
            else:
                self._suspects.clear()
                self._offset_s = max(self._offset_s, offset)

    def _suspect(self, offset: float, log_s: float) -> None:
        if self._suspects and abs(offset - self._suspects[-1]) > _STEP_S:
            self._suspects.clear()
        self._suspects.append(offset)
        if len(self._suspects) >= _STEP_SAMPLES:
            self._offset_s, self.began_s = max(self._suspects), log_s
            self._suspects.clear()

    def now_s(self) -> float | None:
        """The time on the stream's clock; None before its first sample."""
        with self._lock:
            return None if self._offset_s is None else self._clock() + self._offset_s
