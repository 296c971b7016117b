"""A town of streets and what a car sees in it; another town like it."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np

from benchmarks.localize.cities import City, changed, make_city, motion_along, route
from polemap.drivelog.drive import Drive
from polemap.localize.place.patterns import MapPatterns
from polemap.map.pattern_index.build import build_index
from polemap.map.pattern_index.index import PatternIndex
from polemap.simulate.config import DetectorConfig
from polemap.simulate.points.drive import PointScenario, sensed
from polemap.simulate.points.motion import PointMotion
from tests.pole_maps import plain_map

SCENARIO = PointScenario(gnss=None, detector=DetectorConfig(rate_hz=8.0, detected_share=0.85))


@cache
def town(seed: int = 0) -> City:
    return make_city(2000, seed)


@cache
def index_of(seed: int = 0) -> PatternIndex:
    return build_index(town(seed).surveyed(0.05, seed))[0]


class Patterns(MapPatterns):
    """An index that is there, or none."""

    def __init__(self, index: PatternIndex | None) -> None:
        super().__init__(plain_map(np.empty((0, 2))), background=False)
        self._index, self._given_up = index, index is None


@cache
def drive_in(town_seed: int, seed: int, length_m: float = 100.0) -> tuple[Drive, PointMotion]:
    """A drive through a town of which a twentieth has changed, and its true motion."""
    rng = np.random.default_rng([seed, 5])
    motion = motion_along(route(town(town_seed), length_m, rng), 8.0)
    drive = sensed(SCENARIO, motion, changed(town(town_seed), 0.05, rng), rng)
    return replace(drive, frame=town(town_seed).surveyed(0.05, 0).frame), motion
