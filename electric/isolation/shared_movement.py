"""Whether what looks like a sensor's noise is the car's own movement: another sensor shows it too.

Slip control, brakes that pulse and wheels that shimmy shake a car faster and harder than anything
an accelerometer showed before. Noise of two sensors is their own; a movement is in both.
"""

from __future__ import annotations

from collections import deque
from typing import Final, NamedTuple

import numpy as np
from numpy.polynomial.legendre import legvander
from numpy.typing import NDArray

Floats = NDArray[np.float64]

WINDOW_S: Final = 1.0
# polynomial that leaves of a second what is faster than some 3 Hz
_DEGREE = 7
# the second sensor may lead by so much (filters of the first) or come so much later (a bus)
_LEAD_S, _LAG_S = 0.02, 0.05
# correlation of independent noises of n values: deviations of 1 / sqrt(n), the largest of some
# ten lags; and the share of the movement that is shared at least
_DEVIATIONS, _LEAST = 4.0, 0.35
# sampling and filters leave half of a shared movement's correlation at least
_CLEAR = 2.0
_HARD_S = 0.3


class Comparison(NamedTuple):
    """What one signal's fast changes have to do with another's rates.

    Attributes:
        correlation: at the lag at which it is largest.
        limit: what independent noises do not reach.
        possible: what it would be if the second signal had all that the first shows beside the
            noise that it has; meaningful where it is the first one's integral in the same units.
    """

    correlation: float
    limit: float
    possible: float

    @property
    def shared(self) -> bool:
        """Whether both show one movement."""
        return self.correlation > self.limit

    @property
    def hidden(self) -> bool:
        """Whether the second signal is too noisy to tell."""
        return self.possible < _CLEAR * self.limit


def compare(stamps_s: Floats, level: Floats, integral: Floats) -> Comparison:
    """Compare fast changes of one signal with the rates of another, each without its slow course.

    Args:
        stamps_s: `(n,)`, evenly spaced.
        level: `(n,)` an acceleration, or what causes one.
        integral: `(n,)` a speed or a yaw rate that this moves, of whatever unit.
    """
    n = len(stamps_s) - 1
    if n < 3 * _DEGREE:
        return Comparison(0.0, 1.0, 0.0)
    step_s = float(stamps_s[-1] - stamps_s[0]) / n
    slow = np.linalg.qr(legvander(np.linspace(-1.0, 1.0, n), _DEGREE))[0]
    rate = _without(slow, (integral[1:] - integral[:-1]) / step_s)
    cause = _without(slow, level[:-1])
    sizes = float(np.sqrt(cause @ cause)), float(np.sqrt(rate @ rate))
    limit = max(_LEAST, _DEVIATIONS / n**0.5)
    if not min(sizes) > 0.0:
        return Comparison(0.0, limit, 1.0)
    lead, lag = round(_LEAD_S / step_s), round(_LAG_S / step_s)
    best = max(
        float(cause[max(0, -k) : n - max(0, k)] @ rate[max(0, k) : n - max(0, -k)])
        for k in range(-lead, lag + 1)
    )
    return Comparison(best / (sizes[0] * sizes[1]), limit, sizes[0] / sizes[1])


def _without(slow: Floats, values: Floats) -> Floats:
    return np.asarray(values - slow @ (slow.T @ values))


class Recent:
    """The rows of the last `WINDOW_S`, tick by tick."""

    def __init__(self) -> None:
        self._ticks: deque[tuple[Floats, Floats]] = deque()

    def add(self, stamps_s: Floats, table: Floats) -> None:
        """Rows `(n, k)` at stamps `(n,)`; older ones go."""
        ticks = self._ticks
        if ticks and stamps_s[0] - ticks[-1][0][-1] > 0.5 * WINDOW_S:
            ticks.clear()
        ticks.append((stamps_s, table))
        while ticks[0][0][-1] < stamps_s[-1] - WINDOW_S:
            ticks.popleft()

    def compared(self, level: int, integral: int) -> Comparison:
        """Two columns, see `compare`."""
        return compare(self._stamps(), self._column(level), self._column(integral))

    def hardest(self, integral: int) -> float:
        """Largest mean rate of a column over `_HARD_S`."""
        stamps_s, values = self._stamps(), self._column(integral)
        ends = np.searchsorted(stamps_s, stamps_s + _HARD_S)
        starts = np.flatnonzero(ends < len(stamps_s))
        change = values[ends[starts]] - values[starts]
        return float(np.abs(change).max(initial=0.0)) / _HARD_S

    def _stamps(self) -> Floats:
        return np.concatenate([stamps for stamps, _ in self._ticks])

    def _column(self, column: int) -> Floats:
        return np.concatenate([rows[:, column] for _, rows in self._ticks])
