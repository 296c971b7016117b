"""Where the car may be when the particles do not know: GNSS and constellations of poles."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.detections import Detections
from polemap.drivelog.frames import EarthFrame
from polemap.drivelog.samples import GnssFix
from polemap.localize.gnss.alignment import GnssAlignment, GnssPose
from polemap.localize.gnss.outlier_mixture import GnssReceiver
from polemap.localize.gnss.particle_weights import MAX_AGE_S
from polemap.localize.particle_filter.constellation import (
    Against,
    Candidates,
    ConstellationIndex,
)
from polemap.localize.particle_filter.estimate import position_sd
from polemap.localize.particle_filter.exploration import draw_poses
from polemap.localize.particle_filter.health import Verdict
from polemap.localize.particle_filter.recent_poles import RecentPoles
from polemap.localize.place.claims import PlaceClaims
from polemap.localize.place.patterns import MapPatterns
from polemap.map.pole_map import PoleMap

Floats = NDArray[np.float64]

# poles that must fit together to prove a place: with two, one wrong match is half of the proof
_PROOF_POLES = 3
_MARGIN = 1.5  # by so many poles another place must explain less
_STANDING_M = 0.2
# a car that has driven for so long and still has no heading starts with all of them
_START_PATIENCE_S = 5.0
# a search costs up to 20 ms near a fix: two a second leave a core to the rest
_INTERVAL_S = 0.5
# how far a pole may stand from its map pole: both maps' errors and 45 m of dead reckoning
_TOLERANCE_M = 0.6
# least distance around a fix that is searched: a Gauss-Markov error of 2.5 m, or a bad minute
_REACH_M = 40.0
_NO_CANDIDATES = Candidates(np.empty((0, 3)), np.empty(0, dtype=np.int64), np.empty(0))


class PlaceSearch:
    """Follows GNSS and the poles of the last metres, and draws poses from both on demand."""

    def __init__(
        self,
        pole_map: PoleMap,
        receiver: GnssReceiver,
        places: Literal["constellations", "gnss"] = "constellations",
    ) -> None:
        self._by_poles = places == "constellations"
        self._claims: PlaceClaims | None = None
        self._receiver = receiver
        self._alignment = GnssAlignment(receiver)
        self._recent = RecentPoles()
        self._index = ConstellationIndex(pole_map)
        self._searched_s = -np.inf
        self._searched_at_m = np.zeros(2)
        self._waited_s = 0.0

    @property
    def newest_fix_s(self) -> float:
        """Stamp of the newest fix, minus infinity before the first."""
        return self._alignment.newest_s

    def newest_fix_m(self, stamp_s: float) -> Floats | None:
        """East, north `(2,)` of the newest fix; None where it is too old for a place."""
        if stamp_s - self._alignment.newest_s > MAX_AGE_S:
            return None
        return self._alignment.newest_m

    def use_map(self, pole_map: PoleMap) -> None:
        """Go on with other poles, of the same frame."""
        self._index = ConstellationIndex(pole_map)

    def use_patterns(self, patterns: MapPatterns | None, frame: EarthFrame) -> None:
        """Search a large map by its patterns where no fix narrows the search, see `patterns_of`.

        Args:
            frame: of the places.
        """
        if patterns is None:
            self._claims = None
        elif self._claims is None:
            self._claims = PlaceClaims(patterns, frame)
        else:
            self._claims.use_patterns(patterns)

    def add_fix(self, fix: GnssFix, odometry_pose: Floats) -> None:
        """Take in a fix and the dead-reckoned pose `(3,)` of its moment."""
        self._alignment.add_fix(fix, odometry_pose)

    def add_scan(self, scan: Detections, odometry_pose: Floats, travelled_m: float) -> None:
        """Take in a scan and the dead-reckoned pose `(3,)` of its moment."""
        self._recent.add_scan(scan, odometry_pose, travelled_m)
        if self._claims is not None:
            self._claims.add_scan(scan, odometry_pose, travelled_m)

    def forget_poles(self) -> None:
        """Odometry has failed: the poles of the last metres are no constellation any more."""
        self._recent = RecentPoles()
        if self._claims is not None:
            self._claims.forget()

    def draw_start(
        self, count: int, stamp_s: float, odometry_pose: Floats, rng: np.random.Generator
    ) -> Floats:
        """Poses `(count, 3)` to begin with; none while waiting makes them better.

        Poses of any heading are a poor start: a single pole fits them all. So the first metres are
        awaited, after which GNSS has a heading, unless the poles fit a constellation in one place
        only, or the car has driven for as long as the patience lasts.
        """
        if not self.rested(stamp_s):
            return np.empty((0, 3))
        since_s, self._searched_s = stamp_s - self._searched_s, stamp_s
        gnss = self._gnss_pose(stamp_s, odometry_pose)
        candidates = self._search(odometry_pose, gnss, rng)
        moved = np.hypot(*(odometry_pose[:2] - self._searched_at_m)) > _STANDING_M
        self._searched_at_m = odometry_pose[:2].copy()
        if gnss is not None and moved and np.isfinite(since_s):
            self._waited_s += since_s
        if gnss is None or not gnss.heading_known:
            sure = _stands_out(candidates, self._enough(gnss))
            if not sure and (gnss is None or self._waited_s < _START_PATIENCE_S):
                return np.empty((0, 3))
        return draw_poses(count, gnss, candidates, rng)

    def verify(
        self,
        pose: Floats,
        stamp_s: float,
        odometry_pose: Floats,
        rng: np.random.Generator,
        *,
        proven: bool = False,
    ) -> Verdict:
        """Hold a pose `(3,)` against the poles of the last metres, and against other places.

        "confirmed" if it explains enough of them and no other place does as well, "contradicted"
        if another one does clearly better; a pose that was proven before gives way only to one that
        is alone in that, and by one pole more: the map may lack what is seen.
        """
        self._searched_s = stamp_s
        gnss = self._gnss_pose(stamp_s, odometry_pose)
        candidates = self._search(odometry_pose, gnss, rng)
        if gnss is None and self._claims is not None:
            # of a city that is searched by its patterns, a claim alone says more than "open"
            if not len(candidates):
                return "open"
            return "confirmed" if candidates.at(pose)[0] else "contradicted"
        own = self._index.judge(
            pose[np.newaxis],
            self._recent.around(odometry_pose),
            _TOLERANCE_M,
            self._against(gnss),
        )
        enough, score = self._enough(gnss), float(own.score[0])
        found = len(candidates) > 0 and candidates.matched[0] >= enough
        if proven:
            # nearly the same pose is no other place: dead reckoning has bent the constellation
            found = _stands_out(candidates, enough + 1) and not candidates.at(pose)[0]
        if found and candidates.score[0] >= score + _MARGIN:
            return "contradicted"
        rivals = candidates.score[~candidates.at(pose)]
        if own.matched[0] >= enough and (len(rivals) == 0 or score >= rivals[0] + _MARGIN):
            return "confirmed"
        return "open"

    def _enough(self, gnss: GnssPose | None) -> int:
        """Poles that a constellation must hold to be a proof; one more without a heading."""
        known = gnss is not None and gnss.heading_known
        return _PROOF_POLES + (not known)

    def rested(self, stamp_s: float, intervals: float = 1.0) -> bool:
        """Whether the last search is long enough ago for another."""
        return stamp_s - self._searched_s >= intervals * _INTERVAL_S

    def draw_anew(
        self, count: int, stamp_s: float, odometry_pose: Floats, rng: np.random.Generator
    ) -> Floats:
        """Rear-axle poses `(count, 3)` at `stamp_s`; none where nothing is known."""
        self._searched_s = stamp_s
        gnss = self._gnss_pose(stamp_s, odometry_pose)
        return draw_poses(count, gnss, self._search(odometry_pose, gnss, rng), rng)

    def _gnss_pose(self, stamp_s: float, odometry_pose: Floats) -> GnssPose | None:
        if stamp_s - self._alignment.newest_s > MAX_AGE_S:
            return None
        return self._alignment.align(odometry_pose)

    def _search(
        self, odometry_pose: Floats, gnss: GnssPose | None, rng: np.random.Generator
    ) -> Candidates:
        if not self._by_poles:
            return _NO_CANDIDATES
        if gnss is None and self._claims is not None:
            return self._claimed(odometry_pose, needed=True)
        points = self._recent.around(odometry_pose)
        # one less than a proof where a fix narrows the search: without one, chance matches abound
        least = self._enough(gnss) if gnss is None else self._enough(gnss) - 1
        if len(points) < least:
            return _NO_CANDIDATES
        reach = np.inf
        if gnss is not None:
            reach = max(_REACH_M, 3.0 * position_sd(gnss.covariance)[0])
        found = self._index.find(
            points,
            tolerance_m=_TOLERANCE_M,
            min_poles=least,
            rng=rng,
            centre_m=None if gnss is None else gnss.pose[:2],
            reach_m=reach,
            against=self._against(gnss),
        )
        if len(found) and found.matched[0] >= self._enough(gnss):
            return found
        # nothing there looks like the way: the fix may be wrong
        claimed = self._claimed(odometry_pose, needed=False)
        return claimed if len(claimed) else found

    def _claimed(self, odometry_pose: Floats, *, needed: bool) -> Candidates:
        """The place that the poles of the way claim, wherever it is; none in a small map."""
        if self._claims is None:
            return _NO_CANDIDATES
        claim = self._claims.claim(odometry_pose, needed=needed)
        if claim is None:
            return _NO_CANDIDATES
        matched = np.array([claim.matched])
        return Candidates(
            claim.pose[np.newaxis],
            matched,
            matched.astype(np.float64),
            claim.covariance[np.newaxis],
        )

    def _against(self, gnss: GnssPose | None) -> Against | None:
        if gnss is None:
            return None
        return lambda poses: gnss.misfit(poses, self._receiver)


def _stands_out(candidates: Candidates, enough: int) -> bool:
    """Whether the best candidate explains enough poles, and clearly more than the others."""
    if len(candidates) == 0 or candidates.matched[0] < enough:
        return False
    return len(candidates) == 1 or bool(candidates.score[0] >= candidates.score[1] + _MARGIN)
