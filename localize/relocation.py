"""Where the car may be when the particles do not know: GNSS and constellations of poles."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from drivelog.samples import GnssFix, PoleScan
from localize.config import LocalizeConfig
from localize.constellation import Candidates, ConstellationIndex, PoleMemory
from localize.exploration import draw_poses
from localize.gnss_alignment import GnssAlignment, GnssPose
from localize.particles import position_sd
from polemap.landmark_map import PoleMap

Floats = NDArray[np.float64]

_NO_CANDIDATES = Candidates(np.empty((0, 3)), np.empty(0, dtype=np.int64), np.empty(0))


class Relocation:
    """Follows GNSS and the poles of the last metres, and draws poses from both on demand."""

    def __init__(self, pole_map: PoleMap, config: LocalizeConfig) -> None:
        self._config = config
        self._alignment = GnssAlignment(config)
        self._memory = PoleMemory()
        self._index = ConstellationIndex(pole_map)
        self._searched_s = -np.inf
        self._first_fix_s: float | None = None

    @property
    def newest_fix_s(self) -> float:
        """Stamp of the newest fix, minus infinity before the first."""
        return self._alignment.newest_s

    def add_fix(self, fix: GnssFix, antenna_m: Floats, reckoned: Floats) -> None:
        """Take in a fix and the dead-reckoned pose `(3,)` of its moment."""
        self._alignment.push(fix, antenna_m, reckoned)

    def add_scan(self, scan: PoleScan, reckoned: Floats, travelled_m: float) -> None:
        """Take in a scan and the dead-reckoned pose `(3,)` of its moment."""
        self._memory.push(scan, reckoned, travelled_m)

    def start(
        self, count: int, stamp_s: float, reckoned: Floats, rng: np.random.Generator
    ) -> Floats:
        """Poses `(count, 3)` to begin with; none while waiting makes them better.

        Poses of any heading are a poor start. So the first metres are awaited, after which GNSS has
        a heading, unless the poles already fit a constellation or the patience ends.
        """
        if not self.rested(stamp_s):
            return np.empty((0, 3))
        self._searched_s = stamp_s
        gnss = self._gnss_pose(stamp_s, reckoned)
        candidates = self._search(reckoned, gnss, rng)
        if gnss is not None and self._first_fix_s is None:
            self._first_fix_s = stamp_s
        sure = len(candidates) > 0 and candidates.matched[0] > self._config.constellation_min_poles
        if not sure and (gnss is None or not gnss.heading_known):
            waited = 0.0 if self._first_fix_s is None else stamp_s - self._first_fix_s
            if waited < self._config.start_patience_s:
                return np.empty((0, 3))
        return draw_poses(count, gnss, candidates, rng)

    def rested(self, stamp_s: float) -> bool:
        """Whether the last search is long enough ago for another."""
        return stamp_s - self._searched_s >= self._config.constellation_interval_s

    def draw(
        self, count: int, stamp_s: float, reckoned: Floats, rng: np.random.Generator
    ) -> Floats:
        """Rear-axle poses `(count, 3)` at `stamp_s`; none where nothing is known."""
        self._searched_s = stamp_s
        gnss = self._gnss_pose(stamp_s, reckoned)
        return draw_poses(count, gnss, self._search(reckoned, gnss, rng), rng)

    def _gnss_pose(self, stamp_s: float, reckoned: Floats) -> GnssPose | None:
        if stamp_s - self._alignment.newest_s > self._config.gnss_max_age_s:
            return None
        return self._alignment.pose(reckoned)

    def _search(
        self, reckoned: Floats, gnss: GnssPose | None, rng: np.random.Generator
    ) -> Candidates:
        config = self._config
        points = self._memory.around(reckoned)
        if len(points) < config.constellation_min_poles:
            return _NO_CANDIDATES
        reach = np.inf
        if gnss is not None:
            reach = max(config.constellation_reach_m, 3.0 * position_sd(gnss.covariance)[0])
        return self._index.find(
            points,
            tolerance_m=config.constellation_tolerance_m,
            # the whole map offers chance matches that the surroundings of a fix do not
            min_poles=config.constellation_min_poles + (gnss is None),
            rng=rng,
            centre_m=None if gnss is None else gnss.pose[:2],
            reach_m=reach,
        )
