"""A place seen again: what was matched, and how far a solved graph leaves it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from polemap.vehicle.pose import relative, wrap_angle

Floats = NDArray[np.float64]
Whole = NDArray[np.int64]

# a loop that is strained more than this share of right ones is taken back
STRAIN_PROBABILITY = 0.9999
# what matching whole local maps leaves, metres and radians, and what their bending adds
MATCH_SD = np.array([0.15, 0.15, 0.01])


@dataclass(frozen=True, slots=True)
class Loop:
    """Two local maps that show one place.

    Attributes:
        first, second: their numbers; landmarks: `(k, 2)` that are one pole each.
        log_odds: against being elsewhere.
        innovation: `(3,)` measured less predicted pose of the second in the first.
        measured: `(3,)` that pose, as matching found it.
    """

    first: int
    second: int
    landmarks: Whole
    log_odds: float
    innovation: Floats
    measured: Floats

    def strain(self, anchors: Floats) -> float:
        """How far the anchors `(n, 3)` of a solved graph leave what was matched, squared in sd.

        A chi-square of three degrees of freedom where the loop is right.
        """
        off = relative(anchors[self.first], anchors[self.second]) - self.measured
        off[2] = wrap_angle(off[2])
        return float(np.sum((off / MATCH_SD) ** 2))


@dataclass(frozen=True, slots=True)
class Found:
    """Loops of a round, and how many matches were ambiguous or at odds with surer ones.

    `unreached`: whether some place is known too badly to look for it yet.
    """

    loops: tuple[Loop, ...]
    ambiguous: int
    at_odds: int
    unreached: bool = False

    def links(self) -> Whole:
        """All pairs of landmarks `(k, 2)`, each once."""
        if not self.loops:
            return np.empty((0, 2), dtype=np.int64)
        pairs = np.sort(np.concatenate([loop.landmarks for loop in self.loops]), axis=1)
        return np.unique(pairs[pairs[:, 0] != pairs[:, 1]], axis=0)
