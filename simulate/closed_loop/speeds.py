"""Speeds that the closed loops are driven at: one, or the papers' ranges as a cosine."""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, pi

from polemap.electric.studies.scenes import KMH


@dataclass(frozen=True, slots=True)
class Swing:
    """From the lowest speed to the highest and back; what the driver keeps to at each stamp.

    The papers drove 10-20 (W12) and 0-30 km/h (W14) and do not print how fast it changed. Within
    16 s the motors of the papers' car can: 1.6 of their 2.4 m/s^2.
    """

    lowest_kmh: float
    highest_kmh: float
    lasts_s: float = 16.0

    def __call__(self, stamp_s: float) -> float:
        """Speed in m/s."""
        half = 0.5 * (self.highest_kmh - self.lowest_kmh)
        return KMH * (self.lowest_kmh + half * (1.0 - cos(2.0 * pi * stamp_s / self.lasts_s)))

    def __str__(self) -> str:
        return f"{self.lowest_kmh:.0f}-{self.highest_kmh:.0f} km/h"


RANGES = (Swing(10.0, 20.0), Swing(0.0, 30.0))
"""Those of the papers."""
