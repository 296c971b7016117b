"""Places seen again: which local maps lie on each other, and which of that holds together.

Every pair of local maps that may overlap, as far as the graph knows where they are, is matched as
a whole (`matching`). A match is taken for a loop if it beats being elsewhere and every other place
within reach by fixed log odds. Loops of one round must also agree with each other: from the surest
on, each is held against the covariance of all anchors after the loops before it (the joint
compatibility test, on loops in the place of single features). What fails is not lost: all is
matched anew in the next round, from the poses that the graph then has.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from polemap.build.slam.config import SlamConfig
from polemap.build.slam.constants import LOOP_MARGIN
from polemap.build.slam.matching import Placement, corrected, place
from polemap.build.slam.submaps import Submap
from polemap.vehicle.kalman import chi_square_quantile
from polemap.vehicle.pose import relative, rotation, wrap_angle

Floats = NDArray[np.float64]
Whole = NDArray[np.int64]

_OVERLAP_M = 40.0  # anchors farther apart share too few poles
_SEARCH_SD_M = 12.0  # of a place that is less known, nothing is looked for yet
_NEAREST = 2  # local maps of one visit that another is matched with
_PRIOR_GATE = chi_square_quantile(0.997, 3)
_JOINT_GATE = chi_square_quantile(0.9999, 3)
# what matching whole local maps leaves, metres and radians, and what their bending adds
_MATCH_SD = np.array([0.15, 0.15, 0.01])


@dataclass(frozen=True, slots=True)
class Loop:
    """Two local maps that show one place.

    Attributes:
        first, second: their numbers; landmarks: `(k, 2)` that are one pole each.
        log_odds: against being elsewhere.
        innovation: `(3,)` measured less predicted pose of the second in the first.
    """

    first: int
    second: int
    landmarks: Whole
    log_odds: float
    innovation: Floats


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


def find_loops(
    submaps: Sequence[Submap],
    anchors: Floats,
    covariance: Floats,
    config: SlamConfig,
    known: Collection[tuple[int, int]] = (),
) -> Found:
    """Loops among local maps whose anchors stand at `anchors` `(n, 3)`.

    Args:
        submaps: the local maps.
        anchors: their poses.
        covariance: `(3 n, 3 n)` of the anchors' joint error in the map's axes.
        config: settings.
        known: pairs that are not looked at.
    """
    candidates: list[tuple[Loop, Floats]] = []
    ambiguous = 0
    pairs, unreached = _candidates(submaps, anchors, covariance)
    for first, second in pairs:
        if (first, second) in known:
            continue
        predicted, jacobian, rows = _relative(anchors, first, second)
        spread = jacobian @ covariance[np.ix_(rows, rows)] @ jacobian.T + np.diag(_MATCH_SD**2)
        a, b = submaps[first], submaps[second]
        placements = place(a, b, predicted, spread)
        if not placements or placements[0].log_odds < config.loop_log_odds:
            continue
        best = placements[0]
        rival = max([0.0, *(other.log_odds for other in placements[1:])])
        if best.log_odds - rival < LOOP_MARGIN:
            ambiguous += 1
            continue
        if best.prior2 > _PRIOR_GATE:
            continue
        candidates.append((_loop(first, second, a, b, predicted, best), predicted))
    kept = _agreeing([loop for loop, _ in candidates], anchors, covariance)
    return Found(tuple(kept), ambiguous, len(candidates) - len(kept), unreached)


def _loop(
    first: int, second: int, a: Submap, b: Submap, predicted: Floats, best: Placement
) -> Loop:
    innovation = corrected(predicted, best, b) - predicted
    innovation[2] = wrap_angle(innovation[2])
    landmarks = np.column_stack([a.landmark[best.pairs[:, 0]], b.landmark[best.pairs[:, 1]]])
    return Loop(first, second, landmarks, best.log_odds, innovation)


def _candidates(
    submaps: Sequence[Submap], anchors: Floats, covariance: Floats
) -> tuple[list[tuple[int, int]], bool]:
    """Pairs that may overlap: of every visit to a place the nearest local maps only."""
    n = len(submaps)
    if n < 2:
        return [], False
    index = 3 * np.arange(n)
    east, north = covariance[np.ix_(index, index)], covariance[np.ix_(index + 1, index + 1)]
    own = np.diag(east) + np.diag(north)
    # variance of the difference of two anchors' places, without what both share
    sd = np.sqrt(np.maximum(own[:, None] + own[None, :] - 2.0 * (east + north), 0.0))
    distance = np.hypot(*(anchors[:, None, :2] - anchors[None, :, :2]).transpose(2, 0, 1))
    near = (distance - 3.0 * sd <= _OVERLAP_M) & (sd <= _SEARCH_SD_M)
    route = np.array([submap.route for submap in submaps])
    pairs = []
    for first in range(n):
        others = np.flatnonzero(near[first])
        others = others[others > first + 1]
        if not len(others):
            continue
        ends = (np.diff(others) > 1) | (np.diff(route[others]) != 0)
        for visit in np.split(others, np.flatnonzero(ends) + 1):
            order = visit[np.argsort(distance[first, visit], kind="stable")]
            pairs += [
                (first, int(second))
                for second in order[:_NEAREST]
                if not np.intersect1d(submaps[first].landmark, submaps[second].landmark).size
            ]
    far = (distance - 3.0 * sd <= _OVERLAP_M) & (sd > _SEARCH_SD_M)
    return pairs, bool(far.any())


def _relative(anchors: Floats, first: int, second: int) -> tuple[Floats, Floats, Whole]:
    """Pose of the second in the first, its Jacobian `(3, 6)` by both, and their rows."""
    a, b = anchors[first], anchors[second]
    pose = relative(a, b)
    turn = rotation(-a[2])
    jacobian = np.zeros((3, 6))
    jacobian[:2, :2], jacobian[:2, 3:5] = -turn, turn
    jacobian[:2, 2] = pose[1], -pose[0]
    jacobian[2, 2], jacobian[2, 5] = -1.0, 1.0
    rows = np.concatenate([3 * first + np.arange(3), 3 * second + np.arange(3)])
    return pose, jacobian, rows


def _agreeing(loops: list[Loop], anchors: Floats, covariance: Floats) -> list[Loop]:
    """The loops that are jointly compatible, from the surest on."""
    spread = covariance.copy()
    state = np.zeros(len(spread))
    noise = np.diag(_MATCH_SD**2)
    kept = []
    for loop in sorted(loops, key=lambda loop: (-loop.log_odds, loop.first, loop.second)):
        _, jacobian, rows = _relative(anchors, loop.first, loop.second)
        across = spread[:, rows] @ jacobian.T
        innovation = jacobian @ across[rows] + noise
        off = loop.innovation - jacobian @ state[rows]
        off[2] = wrap_angle(off[2])
        if off @ np.linalg.solve(innovation, off) > _JOINT_GATE:
            continue
        gain = np.linalg.solve(innovation, across.T).T
        state += gain @ off
        spread -= gain @ across.T
        kept.append(loop)
    return kept
