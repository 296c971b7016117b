"""What the filter does when its place is in doubt: explore, start anew, prove where it is.

`exploration.py` and `health.py` say when, `place_search.py` says where.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.detections import Detections
from polemap.localize.config import RecoveryConfig
from polemap.localize.contradictions import StrangePoles, UnmatchedPoles
from polemap.localize.gnss.outlier_mixture import GnssReceiver
from polemap.localize.particle_filter.estimate import Event
from polemap.localize.particle_filter.exploration import (
    LikelihoodAverages,
    Quality,
    normalized_quality,
    plain_quality,
)
from polemap.localize.particle_filter.health import (
    LostDetector,
    RestartCause,
    StartProof,
    Verdict,
)
from polemap.localize.particle_filter.particles import ParticleSet
from polemap.localize.particle_filter.place_search import PlaceSearch
from polemap.localize.particle_filter.pole_weigher import Match, PoleWeigher
from polemap.localize.particle_filter.sensor_model import PoseLikelihoods
from polemap.map.pole_map import PoleMap

Floats = NDArray[np.float64]

# share of the particles that start anew where the map may be wrong instead
_RESTART_SHARE = 0.75
# largest share that is drawn anew while the rest goes on (more would be a restart), and of the
# short-term likelihood in the long-term one below which that begins; our choice, as the book leaves
# them open
_EXPLORE_SHARE_MAX, _EXPLORE_MARGIN = 0.2, 0.4
# searches of a proven place that is in doubt come so many times less often
_DOUBT_INTERVALS = 4.0
# independent poles that must have fitted, the last of them not longer ago
_HELD_POLES, _HELD_S = 12.0, 3.0
# a pose this wide is held by no pole: those of the next street fit as well
_LOOSE_SD_M = 3.0
# poles that come after so long without any must hold the pose anew before they accuse the detector
_ANEW_S = 10.0
# poles that match nothing send half of the particles around, once a second, as far as odometry may
# have been wrong over so long a way
_SCATTER_S, _SCATTER_SHARE, _SCATTER_MAX_M = 1.0, 0.5, 30.0


@dataclass(frozen=True, slots=True)
class Step:
    """Odometry pose `(3,)` at a scan, the way and time since the last one, and since the first."""

    odometry_pose: Floats
    moved_m: float
    elapsed_s: float
    travelled_m: float = 0.0


class Recovery:
    """Watches the particle filter and gives its particles other places.

    Args:
        counts: `reinitializations`, all and by cause, `start_corrections` and
            `exploration_events` are counted here.

    Attributes:
        search: where the car may be.
        averages: of how well scans fit.
        lost, proof: the judgement of the present place.
        unmatched, strange: whether the poles of the last second, or the last few, contradict it.
        explored_share: of the particles that the last scan gave another place.
    """

    def __init__(
        self,
        pole_map: PoleMap,
        config: RecoveryConfig,
        receiver: GnssReceiver,
        weigher: PoleWeigher,
        rng: np.random.Generator,
        counts: Counter[str],
    ) -> None:
        self._weigher = weigher
        self._rng = rng
        self.counts = counts
        self._config = config
        self.search = PlaceSearch(pole_map, receiver, config.places)
        self._classic = config.exploration == "classic"
        self.averages = (
            LikelihoodAverages(1.0, 1.0)
            if self._classic
            else LikelihoodAverages(_EXPLORE_SHARE_MAX, _EXPLORE_MARGIN)
        )
        self.lost = LostDetector(config)
        self.proof = StartProof(config)
        self.unmatched, self.strange = UnmatchedPoles(), StrangePoles()
        self._scattered_s = -np.inf
        self._matched_at_m = 0.0
        self._held_by = 0.0
        self._matched_s = self._corners_s = -np.inf
        self._held_anew_by = 0.0
        self.explored_share = 0.0

    def use_map(self, pole_map: PoleMap) -> None:
        """Go on with other poles, of the same frame."""
        self.search.use_map(pole_map)

    def believe(self) -> None:
        """Somebody who should know has said where the car is."""
        self.averages.reset()
        self.lost.reset()
        self.strange.forget()
        self.proof.believe()

    def recover(
        self, particles: ParticleSet, scan: Detections, odometry_pose: Floats, scan_evidence: float
    ) -> Event | None:
        """Start anew when lost, explore when the likelihood has fallen; what was done, if anything.

        Args:
            scan_evidence: log-likelihood of the scan, averaged over the particles before it.
        """
        self.explored_share = 0.0
        total = len(particles)
        spread_only = self._config.restart == "spread"
        if self.proof.contradicted and not spread_only:
            return self._begin_elsewhere(particles, scan, odometry_pose)
        lost = self.lost.scattered if spread_only else self.lost.lost
        if lost and self.search.rested(scan.stamp_s):
            # where poles just do not fit, the map may have changed: the old particles keep a part
            cause = self.lost.cause
            elsewhere = self.lost.scattered or self.lost.astray
            if not self._restart(
                particles, 1.0 if elsewhere else _RESTART_SHARE, scan, odometry_pose
            ):
                return None
            self._count_restart(cause)
            return "reinitialized"
        wanted = 0 if self._classic else round(self.averages.share * total)
        if wanted == 0 or len(scan) < 2 or not self.search.rested(scan.stamp_s):
            return None
        drawn = self.search.draw_anew(wanted, scan.stamp_s, odometry_pose, self._rng)
        if len(drawn) == 0:
            return None
        # newcomers have passed no scan yet: they count by how they stand this one beside the others
        result = self._weigher.weigh(drawn, scan)
        self._mix_in(particles, drawn, np.minimum(result.log_likelihood - scan_evidence, 0.0))
        self.counts["exploration_events"] += 1
        return "explored"

    def quality(self, result: PoseLikelihoods, weights: Floats, seen: int) -> Quality:
        """How well a scan fits, by which exploration is called for."""
        return (plain_quality if self._classic else normalized_quality)(result, weights, seen)

    def inject(self, particles: ParticleSet, scan: Detections, odometry_pose: Floats) -> None:
        """Classic Augmented MCL: after the estimate a share of the particles is drawn anew.

        They weigh as much as the others until the next scan has met them.
        """
        wanted = round(self.averages.share * len(particles)) if self._classic else 0
        searching = self._config.places == "constellations"
        if wanted == 0 or (searching and not self.search.rested(scan.stamp_s)):
            return
        drawn = self.search.draw_anew(wanted, scan.stamp_s, odometry_pose, self._rng)
        if len(drawn):
            self._mix_in(particles, drawn, np.zeros(len(drawn)))
            self.counts["exploration_events"] += 1

    def _begin_elsewhere(
        self, particles: ParticleSet, scan: Detections, odometry_pose: Floats
    ) -> Event | None:
        """The poles of the last metres fit clearly better at another place."""
        if not self._restart(particles, _RESTART_SHARE, scan, odometry_pose):
            return None
        if self.proof.was_proven:
            self._count_restart("place")
            return "reinitialized"
        self.counts["start_corrections"] += 1
        return "initialized"

    def _count_restart(self, cause: RestartCause) -> None:
        self.counts["reinitializations"] += 1
        self.counts[f"reinitializations_{cause}"] += 1

    def _restart(
        self, particles: ParticleSet, share: float, scan: Detections, odometry_pose: Floats
    ) -> bool:
        """Let a share of the particles start anew; whether there was anywhere to start."""
        count = round(share * len(particles))
        drawn = self.search.draw_anew(count, scan.stamp_s, odometry_pose, self._rng)
        if len(drawn) == 0:
            return False
        self._mix_in(particles, drawn, np.zeros(len(drawn)))
        self.averages.reset()
        self.lost.reset()
        self.unmatched.forget()
        self.strange.forget()
        return True

    def _mix_in(self, particles: ParticleSet, rear: Floats, log_weights: Floats) -> None:
        """Let poses take the places of as many particles."""
        self.explored_share = len(rear) / len(particles)
        particles.replace_some(rear, log_weights)

    def add_held(
        self, stamp_s: float, matched: int, share: float, major_sd_m: float, *, corners: int = 0
    ) -> None:
        """Take in the poles of a scan that fit, and the share of it that is independent.

        Args:
            major_sd_m: of the position; where it is so wide no pole holds the pose any more.
            corners: that are believed and fit; they go on holding what poles have held.
        """
        loose = major_sd_m > _LOOSE_SD_M
        if loose or not self.proof.proven or self.strange.contradict:
            self._held_by = self._held_anew_by = 0.0
        elif matched:
            if stamp_s - self._matched_s > _ANEW_S:
                self._held_anew_by = 0.0
            self._held_anew_by += matched * share
            self._held_by += matched * share
            self._matched_s = stamp_s
        self._corners_s = stamp_s if corners else self._corners_s

    @property
    def far_from_fixes(self) -> bool:
        """Whether a fix lies far from a place that is new: not enough poles have held it yet."""
        return self.lost.far and self._held_by < _HELD_POLES

    def held(self, stamp_s: float) -> bool:
        """Whether so many poles have held the pose, the last one lately, that fixes far away are
        wrong."""
        lately = stamp_s - max(self._matched_s, self._corners_s) <= _HELD_S
        return lately and self._held_by >= _HELD_POLES

    def held_anew(self, stamp_s: float) -> bool:
        """Whether poles have done so since the last time that none was found for long."""
        lately = stamp_s - self._matched_s <= _HELD_S
        return lately and min(self._held_by, self._held_anew_by) >= _HELD_POLES

    def scatter(self, particles: ParticleSet, stamp_s: float, travelled_m: float) -> None:
        """Poles are seen and match nothing: half of the particles look around.

        They go where odometry that was wrong since the last match may have led to.

        Args:
            stamp_s, travelled_m: of the scan.
        """
        if self._config.restart == "spread":
            return
        if not self.strange.contradict or stamp_s - self._scattered_s < _SCATTER_S:
            return
        self._scattered_s = stamp_s
        particles.scatter(_SCATTER_SHARE, min(travelled_m - self._matched_at_m, _SCATTER_MAX_M))
        self.counts["scattered"] += 1

    def prove(self, stamp_s: float, fit: Match, pose: Floats, step: Step, *, narrow: bool) -> None:
        """Ask the last metres' constellation while the place is not proven, or in doubt again.

        Args:
            fit: of the poles of a scan.
        """
        seen = len(fit.assignment)
        proof = self.proof
        if fit.matched and not self.strange.contradict:
            self._matched_at_m = step.travelled_m
        proof.add_fit(fit.matched, seen, step.elapsed_s)
        verdict: Verdict = "open"
        if not proof.proven or proof.in_doubt or self.strange.contradict:
            intervals = _DOUBT_INTERVALS if proof.proven else 1.0
            if self.search.rested(stamp_s, intervals):
                verdict = self.search.verify(
                    pose, stamp_s, step.odometry_pose, self._rng, proven=proof.proven
                )
        proof.add_verdict(
            verdict,
            narrow=narrow,
            matched=fit.matched,
            possible=min(float(seen), fit.expected),
            moved_m=step.moved_m,
        )
