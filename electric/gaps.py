"""Gaps in a signal log: an estimator is not carried across one but begins anew after it.

A model that holds its last inputs for seconds is driven by a car that no longer exists; after
seconds nothing of its state is worth keeping.
"""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from polemap.electric.estimators.base import Estimator
from polemap.electric.signals import Played, SignalLog, play

Floats = NDArray[np.float64]

# a gap is longer than half a second and twenty steps of the log
GAP_S, GAP_STEPS = 0.5, 20.0


@dataclass(frozen=True, slots=True)
class Gap:
    """No rows between the two stamps."""

    from_s: float
    to_s: float

    @property
    def length_s(self) -> float:
        """How long it lasts."""
        return self.to_s - self.from_s


def find_gaps(log: SignalLog) -> list[Gap]:
    """The gaps of a log, in order."""
    step = np.diff(log.stamp_s)
    rows = np.flatnonzero(step > max(GAP_S, GAP_STEPS * float(np.median(step))))
    return [Gap(float(log.stamp_s[row]), float(log.stamp_s[row + 1])) for row in rows]


def play_parts(
    make: Callable[[], Estimator],
    log: SignalLog,
    *,
    steering_offset_rad: float = 0.0,
    steering_scale: float = 1.0,
    steering_delay_s: float = 0.0,
    progress: Callable[[int], None] | None = None,
) -> tuple[Played, Counter[str]]:
    """Play a log with a new estimator after every gap.

    Returns:
        What the estimators said at every row, NaN at a row that stands alone between gaps; and
        what they left out, by reason.
    """
    gaps = find_gaps(log)
    bounds = [float("-inf"), *(gap.to_s for gap in gaps), float("inf")]
    dropped: Counter[str] = Counter()
    means, sds = [], []
    fields: tuple[str, ...] = ()
    for start, end in itertools.pairwise(bounds):
        estimator = make()
        fields = estimator.fields
        rows = int(np.count_nonzero((log.stamp_s >= start) & (log.stamp_s < end)))
        if rows < 2:
            alone = np.full((rows, len(fields)), np.nan)
            means.append(alone)
            sds.append(alone)
            continue
        part = play(
            estimator,
            log.between(start, end),
            steering_offset_rad=steering_offset_rad,
            steering_scale=steering_scale,
            steering_delay_s=steering_delay_s,
            progress=progress,
        )
        means.append(part.mean)
        sds.append(part.sd)
        dropped.update(estimator.dropped)
    played = Played(log.stamp_s, fields, np.concatenate(means), np.concatenate(sds))
    return played, dropped


def settled(log_stamps_s: Floats, gaps: list[Gap], settle_s: float) -> NDArray[np.bool_]:
    """Rows `(n,)` that are at least `settle_s` after the start and after every gap."""
    starts = np.array([log_stamps_s[0], *(gap.to_s for gap in gaps)])
    latest = starts[np.searchsorted(starts, log_stamps_s, side="right") - 1]
    return np.asarray(log_stamps_s >= latest + settle_s)
