"""Places seen again: which local maps lie on each other, and which of that holds together.

Every pair of local maps that may overlap, as far as the graph knows where they are, is matched as
a whole (`matching`). A match is taken for a loop if it beats being elsewhere and every other place
within reach by fixed log odds. Loops of one round must also agree with each other: from the surest
on, each is held against the covariance of all anchors after the loops before it (the joint
compatibility test, on loops in the place of single features). What fails is not lost: all is
matched anew in the next round, from the poses that the graph then has. Where places are known too
badly to look for them, the index of patterns tells what looks alike (`recall`).
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from polemap.build.slam.config import SlamConfig
from polemap.build.slam.constants import LOOP_MARGIN
from polemap.build.slam.loop import MATCH_SD, Found, Loop
from polemap.build.slam.matching import Placement, corrected, place
from polemap.build.slam.recall import Recall, mirrored
from polemap.build.slam.submaps import Submap
from polemap.vehicle.kalman import chi_square_gate
from polemap.vehicle.pose import compose, relative, rotation, wrap_angle

Floats = NDArray[np.float64]
Whole = NDArray[np.int64]

OVERLAP_M = 40.0  # anchors farther apart share too few poles
SEARCH_SD_M = 12.0  # of a place that is less known, nothing is looked for yet
_NEAREST = 2  # local maps of one visit that another is matched with
_VISITS = 8  # later visits to a place, the nearest, that a local map is matched with
_VISIT = 3  # local maps in a row that may show one place
_SAME_M, _SAME_RAD = 4.0, 0.15  # places that are one
_RECALLED_SD = np.array([1.0, 1.0, 0.05])  # of a place that patterns tell
_PRIOR_PROBABILITY = 0.997  # of a right loop against where the graph has the car
_JOINT_PROBABILITY = 0.9999  # of a right loop against the better ones


def find_loops(
    submaps: Sequence[Submap],
    anchors: Floats,
    covariance: Floats,
    config: SlamConfig,
    known: Collection[tuple[int, int]] = (),
    numbers: Whole | None = None,
    own: NDArray[np.bool_] | None = None,
) -> Found:
    """Loops among local maps whose anchors stand at `anchors` `(n, 3)`.

    Args:
        submaps: the local maps.
        anchors: their poses.
        covariance: `(3 n, 3 n)` of the anchors' joint error in the map's axes.
        config: settings.
        known: pairs that are not looked at.
        numbers: `(n,)` of the local maps among all, where these are some of them; loops have them.
        own: `(n,)` only pairs whose first is one of these; by default all.
    """
    candidates: list[Loop] = []
    ambiguous = 0
    if numbers is None:
        numbers = np.arange(len(submaps))
    pairs, unreached = _candidates(submaps, anchors, covariance, numbers, own)
    for first, second in pairs:
        if (int(numbers[first]), int(numbers[second])) in known:
            continue
        predicted, jacobian, rows = relative_with_jacobian(anchors, first, second)
        spread = jacobian @ covariance[np.ix_(rows, rows)] @ jacobian.T + np.diag(MATCH_SD**2)
        a, b = submaps[first], submaps[second]
        placements = place(a, b, predicted, spread)
        if not placements or placements[0].log_odds < config.loop_log_odds:
            continue
        best = placements[0]
        rival = max([0.0, *(other.log_odds for other in placements[1:])])
        if best.log_odds - rival < LOOP_MARGIN:
            ambiguous += 1
            continue
        if best.prior2 > chi_square_gate(_PRIOR_PROBABILITY, 3):
            continue
        candidates.append(_loop(first, second, a, b, predicted, best))
    agreeing = _agreeing(candidates, anchors, covariance)
    kept = [
        replace(loop, first=int(numbers[loop.first]), second=int(numbers[loop.second]))
        for loop in agreeing
    ]
    return Found(tuple(kept), ambiguous, len(candidates) - len(kept), unreached)


def recall_loops(
    submaps: Sequence[Submap],
    anchors: Floats,
    covariance: Floats,
    config: SlamConfig,
    known: Collection[tuple[int, int]] = (),
) -> Found:
    """Loops among local maps of whose places too little is known to look for them, by patterns.

    A loop must beat being elsewhere within all that the graph leaves open, every other place that
    looks alike, and what the mirror image of the local map reaches by chance.
    """
    recall = Recall(submaps)
    candidates: list[Loop] = []
    ambiguous: list[int] = []
    for second, submap in enumerate(submaps):
        found = _placed_by_patterns(recall, submaps, second, submap, anchors, covariance)
        if not found or found[0].log_odds < config.loop_log_odds:
            continue
        best = found[0]
        mirror = mirrored(submap)
        chance = _placed_by_patterns(recall, submaps, second, mirror, anchors, covariance)
        here = _put(best, anchors)
        rivals = [one.log_odds for one in found[1:] if not _same(_put(one, anchors), here)]
        rival = max([0.0, *rivals, *(one.log_odds for one in chance)])
        if best.log_odds - rival < LOOP_MARGIN:
            ambiguous.append(second)
        else:
            candidates.append(best)
    # where one of a row fits two places, the others may have missed one of them
    open_ones = np.array(ambiguous, dtype=np.int64)
    supported = [
        one for one in candidates
        if not (np.abs(open_ones - one.second) <= _VISIT).any()
        and _supported(one, candidates, anchors)
    ]  # fmt: skip
    new = [
        one for one in supported
        if one.first < one.second - 1 and (one.first, one.second) not in known
        and not np.intersect1d(submaps[one.first].landmark, submaps[one.second].landmark).size
    ]  # fmt: skip
    kept = _agreeing(new, anchors, covariance)
    return Found(tuple(kept), len(ambiguous), len(new) - len(kept))


def _put(loop: Loop, anchors: Floats) -> Floats:
    """Where a loop puts the anchor `(3,)` of its second local map."""
    predicted, _, _ = relative_with_jacobian(anchors, loop.first, loop.second)
    return compose(anchors[loop.first], predicted + loop.innovation)


def _same(one: Floats, other: Floats) -> bool:
    off = one - other
    return bool(np.hypot(*off[:2]) < _SAME_M and abs(wrap_angle(off[2])) < _SAME_RAD)


def _supported(loop: Loop, candidates: Sequence[Loop], anchors: Floats) -> bool:
    """Whether the loop of a neighbour along the way moves it likewise: one pattern may repeat."""
    put = _put(loop, anchors)
    for other in candidates:
        if 0 < abs(other.second - loop.second) <= _VISIT:
            carried = compose(put, relative(anchors[loop.second], anchors[other.second]))
            if _same(_put(other, anchors), carried):
                return True
    return False


def _placed_by_patterns(
    recall: Recall,
    submaps: Sequence[Submap],
    second: int,
    submap: Submap,
    anchors: Floats,
    covariance: Floats,
) -> list[Loop]:
    """What a local map, or its mirror image, looks like, the likeliest first."""
    loops = []
    recalled = recall.find(submap)
    for other, pose in zip(recalled.other.tolist(), recalled.poses, strict=True):
        if abs(other - second) <= 1:
            continue
        a = submaps[other]
        placements = place(a, submap, pose, np.diag(_RECALLED_SD**2))
        if not placements:
            continue
        predicted, jacobian, rows = relative_with_jacobian(anchors, other, second)
        spread = jacobian @ covariance[np.ix_(rows, rows)] @ jacobian.T + np.diag(MATCH_SD**2)
        # the place may be anywhere within what the graph leaves open, not near the pattern only
        open_places = np.linalg.slogdet(spread)[1] - 2.0 * np.log(_RECALLED_SD).sum()
        for one in placements:
            innovation = corrected(pose, one, submap) - predicted
            innovation[2] = wrap_angle(innovation[2])
            prior2 = float(innovation @ np.linalg.solve(spread, innovation))
            if prior2 > chi_square_gate(_PRIOR_PROBABILITY, 3):
                continue
            odds = one.log_odds + 0.5 * (one.prior2 - prior2 - open_places)
            landmarks = np.column_stack(
                [a.landmark[one.pairs[:, 0]], submap.landmark[one.pairs[:, 1]]]
            )
            measured = corrected(pose, one, submap)
            loops.append(Loop(other, second, landmarks, odds, innovation, measured))
    return sorted(loops, key=lambda loop: -loop.log_odds)


def _loop(
    first: int, second: int, a: Submap, b: Submap, predicted: Floats, best: Placement
) -> Loop:
    measured = corrected(predicted, best, b)
    innovation = measured - predicted
    innovation[2] = wrap_angle(innovation[2])
    landmarks = np.column_stack([a.landmark[best.pairs[:, 0]], b.landmark[best.pairs[:, 1]]])
    return Loop(first, second, landmarks, best.log_odds, innovation, measured)


def _candidates(
    submaps: Sequence[Submap],
    anchors: Floats,
    covariance: Floats,
    numbers: Whole,
    own: NDArray[np.bool_] | None,
) -> tuple[list[tuple[int, int]], bool]:
    """Pairs that may overlap: of every visit to a place the nearest local maps only."""
    n = len(submaps)
    if n < 2:
        return [], False
    index = 3 * np.arange(n)
    east, north = covariance[np.ix_(index, index)], covariance[np.ix_(index + 1, index + 1)]
    spread = np.diag(east) + np.diag(north)
    # variance of the difference of two anchors' places, without what both share
    sd = np.sqrt(np.maximum(spread[:, None] + spread[None, :] - 2.0 * (east + north), 0.0))
    distance = np.hypot(*(anchors[:, None, :2] - anchors[None, :, :2]).transpose(2, 0, 1))
    near = (distance - 3.0 * sd <= OVERLAP_M) & (sd <= SEARCH_SD_M)
    route = np.array([submap.route for submap in submaps])
    pairs = []
    for first in range(n) if own is None else np.flatnonzero(own).tolist():
        others = np.flatnonzero(near[first])
        others = others[numbers[others] > numbers[first] + 1]
        if not len(others):
            continue
        ends = (np.diff(numbers[others]) > 1) | (np.diff(route[others]) != 0)
        visits = [
            visit[np.argsort(distance[first, visit], kind="stable")]
            for visit in np.split(others, np.flatnonzero(ends) + 1)
        ]
        visits.sort(key=lambda visit: float(distance[first, visit[0]]))
        for order in visits[:_VISITS]:
            pairs += [
                (first, int(second))
                for second in order[:_NEAREST]
                if not np.intersect1d(submaps[first].landmark, submaps[second].landmark).size
            ]
    far = (distance - 3.0 * sd <= OVERLAP_M) & (sd > SEARCH_SD_M)
    return pairs, bool(far.any())


def relative_with_jacobian(
    anchors: Floats, first: int, second: int
) -> tuple[Floats, Floats, Whole]:
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
    noise = np.diag(MATCH_SD**2)
    kept = []
    for loop in sorted(loops, key=lambda loop: (-loop.log_odds, loop.first, loop.second)):
        _, jacobian, rows = relative_with_jacobian(anchors, loop.first, loop.second)
        across = spread[:, rows] @ jacobian.T
        innovation = jacobian @ across[rows] + noise
        off = loop.innovation - jacobian @ state[rows]
        off[2] = wrap_angle(off[2])
        if off @ np.linalg.solve(innovation, off) > chi_square_gate(_JOINT_PROBABILITY, 3):
            continue
        gain = np.linalg.solve(innovation, across.T).T
        state += gain @ off
        spread -= gain @ across.T
        kept.append(loop)
    return kept
