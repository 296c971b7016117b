"""The search for the place: hypotheses carried along the way, and how likely the best is wrong.

Every search adds the poses that the pattern index proposes to those carried on from the last, fits
and weighs them all by the poles of the way, and compares what they explain. Four things may be
true: the car is at the best of them, at another one, at a place that the index did not propose, or
not in the map. How well chance alone explains so regular a street is measured rather than modelled:
the mirror image of the local map is searched for, too, and what it reaches at best counts as one
more place.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.detections import Detections
from polemap.localize.place.evidence import Judged, judge, misses
from polemap.localize.place.local_map import LocalMap
from polemap.localize.place.local_map_builder import LocalMapBuilder
from polemap.localize.place.proposals import propose
from polemap.map.pattern_index.index import PatternIndex
from polemap.vehicle.pose import compose, relative, wrap_angle

Floats = NDArray[np.float64]
Whole = NDArray[np.int64]

_PROPOSED, _CARRIED, _WEIGHED = 60, 30, 12
_FEWEST_POLES = 4
_GROUND_PER_POLE_M2 = 60.0  # where a car may be, beside each pole of a map
_ELSEWHERE = 0.1  # prior of not being in the map, or of a place that was not proposed
_SAME_M, _SAME_RAD = 3.0, 0.15
# what is taken for independent is not: differences of log evidence count by this factor
_TEMPER = 0.5
# what is as doubtful without chance is not claimed whatever chance explains
_CHANCE_ASKED = 0.1
WRONG_MOST, WRONG_MOST_HIGHEST = 1e-3, 1e-2
"""Bound on the probability of a wrong claim that is accepted, and what may be asked for at most."""


@dataclass(frozen=True, slots=True)
class Search:
    """What one search found.

    Attributes:
        poses: `(k, 3)` of the vehicle at the newest scan, distinct places, best first.
        log_evidence: `(k,)` of each, prior included.
        covariance: `(k, 3, 3)`.
        matched: `(k,)` poles that each explains.
        rows: `(k, n)` map pole of each seen pole, -1 for none.
        local: the seen poles.
        by_chance: the log evidence of the best of the mirror image; minus infinity where the place
            is too doubtful to ask for it.
    """

    poses: Floats
    log_evidence: Floats
    covariance: Floats
    matched: Whole
    rows: Whole
    local: LocalMap
    by_chance: float

    @property
    def poles(self) -> int:
        """How many poles were seen."""
        return len(self.local)

    @property
    def wrong_at_most(self) -> float:
        """Bound on the probability of a wrong place, by which it is claimed or not; 1 without one.

        Evidence counts by half, and what chance explains in so regular a street is a rival. Of
        claims it holds (`benchmarks/localize/reliability.py`); beyond a hundredth it is no
        probability: how often such places are wrong depends on how the city repeats itself.
        """
        if not len(self.poses):
            return 1.0
        rivals = np.append(self.log_evidence[1:], [self.by_chance, np.log(_ELSEWHERE)])
        odds = np.exp(_TEMPER * (rivals - self.log_evidence[0])).sum()
        return float(odds / (1.0 + odds))


class PlaceFinder:
    """Finds the place of a car in a map by the poles along its way.

    Args:
        index: of the map.
        builder: follows the poles; one of its own by default.
    """

    def __init__(self, index: PatternIndex, builder: LocalMapBuilder | None = None) -> None:
        self._index = index
        self._builder = builder or LocalMapBuilder()
        nothing = np.empty((0, 3)), np.zeros(3)
        self._carried = {False: nothing, True: nothing}

    @property
    def odometry_pose(self) -> Floats:
        """The dead-reckoned pose `(3,)` of the newest scan, for which searches give the place."""
        return self._builder.odometry_pose

    def add_scan(self, scan: Detections, odometry_pose: Floats, travelled_m: float) -> bool:
        """Take in a scan from a dead-reckoned pose `(3,)`; False if the car has hardly moved."""
        return self._builder.add_scan(scan, odometry_pose, travelled_m)

    def search(self) -> Search | None:
        """Where the car was at the newest scan; None while too few poles are known."""
        local = self._builder.local_map()
        if local is None or len(local.confirmed()) < _FEWEST_POLES or not len(self._index):
            return None
        local = local.confirmed()
        here = self.odometry_pose
        found, evidence = self._ranked(local, False, here)
        search = Search(
            found.poses, evidence, found.covariance, found.matched, found.rows, local, -np.inf
        )
        if search.wrong_at_most > _CHANCE_ASKED:
            return search
        mirrored_here = here * np.array([1.0, -1.0, -1.0])
        _, chance = self._ranked(local.mirrored(), True, mirrored_here)
        return replace(search, by_chance=float(chance.max(initial=-np.inf)))

    def _ranked(self, local: LocalMap, mirror: bool, here: Floats) -> tuple[Judged, Floats]:
        """Distinct poses and their log evidence, best first; they are carried on.

        Args:
            here: the dead-reckoned pose of the local map, mirrored if it is.
        """
        carried, there = self._carried[mirror]
        moved = relative(there, here)
        poses = np.concatenate(
            [compose(carried, np.broadcast_to(moved, carried.shape)),
             propose(self._index, local, _PROPOSED).poses]
        )  # fmt: skip
        judged = judge(self._index, local, poses)
        evidence = judged.log_ratio + _log_prior(self._index, judged)
        order = np.argsort(-evidence, kind="stable")
        chosen = distinct(judged.poses, order, _CARRIED)
        judged, evidence = judged.take(chosen), evidence[chosen]
        self._carried[mirror] = judged.poses, here.copy()
        best = np.arange(min(_WEIGHED, len(judged)))
        judged, evidence = judged.take(best), evidence[best]
        evidence = evidence + misses(self._index, local, judged)
        order = np.argsort(-evidence, kind="stable")
        return judged.take(order), evidence[order]


def _log_prior(index: PatternIndex, judged: Judged) -> Floats:
    """Log of the prior mass within reach of each pose: its peak's volume over all places."""
    _, log_volume = np.linalg.slogdet(2.0 * np.pi * judged.covariance)
    ground = len(index) * _GROUND_PER_POLE_M2 * 2.0 * np.pi
    return np.asarray(0.5 * log_volume - np.log(ground))


def distinct(poses: Floats, order: Whole, most: int) -> Whole:
    """Of the ordered poses the first `most` that are not nearly the same."""
    chosen: list[int] = []
    for row in order.tolist():
        if chosen:
            offset = poses[chosen] - poses[row]
            near = np.hypot(offset[:, 0], offset[:, 1]) < _SAME_M
            if (near & (np.abs(wrap_angle(offset[:, 2])) < _SAME_RAD)).any():
                continue
        chosen.append(row)
        if len(chosen) == most:
            break
    return np.array(chosen, dtype=np.int64)
