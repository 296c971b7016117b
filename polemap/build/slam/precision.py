"""How well poses and poles are known: to the earth, and to the poles beside them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import scipy
from numpy.typing import NDArray

from polemap.build.slam.config import SlamConfig
from polemap.build.slam.constants import CALIBRATION_WALK
from polemap.build.slam.fix_noise import FixNoise
from polemap.build.slam.graph import Graph
from polemap.build.slam.problem import Problem, Solution, seen_once
from polemap.build.slam.tables import calibration_sd

Floats = NDArray[np.float64]
Whole = NDArray[np.int64]

_CHUNK = 60  # anchors whose joint covariance is computed at once
_NO_POLE_M = 60.0  # a pose without a pole so near is known to the earth only


@dataclass(frozen=True, slots=True)
class Precision:
    """Of poses, by keyframe through all routes.

    Attributes:
        absolute: `(n, 3, 3)` covariance in the map's axes.
        relative_sd_m: `(n,)` an axis, of the place against the nearest pole.
    """

    absolute: Floats
    relative_sd_m: Floats


def graph_to_state(
    problem: Problem, solution: Solution, solved: FixNoise, fixes: FixNoise, config: SlamConfig
) -> Graph:
    """The solved graph with what is to be stated of fixes, those of places seen once apart.

    How large the errors of fixes are is measured where poles of several passes contradict them. A
    stretch that was seen once follows its fixes wherever they lead, so that nothing there tells
    whether they were as good: the settings count, not what was measured elsewhere.

    Args:
        problem, solution: the graph as solved, with fixes as in `solved`.
        fixes: their errors as measured (`fix_noise`).
        config: settings.
    """
    once = seen_once(problem)[problem.fix_from]
    scale = fixes.lasting_m / solved.lasting_m
    lasts = fixes.correlation_s / solved.correlation_s
    worse = max(config.gnss_sd_m / fixes.sd_m, 1.0)
    longer = max(config.gnss_correlation_s / fixes.correlation_s, 1.0)
    change = (solution.calibration - problem.calibration)[problem.motion_calibration]
    stated = replace(
        problem,
        poses=solution.poses,
        points_m=solution.points_m,
        calibration=solution.calibration,
        motion=problem.motion + np.einsum("nij,nj->ni", problem.motion_jacobian, change),
        fix_sd_m=problem.fix_sd_m * (fixes.white_m / solved.white_m),
        bias_sd_m=np.where(once, worse, 1.0) * scale * problem.bias_sd_m,
        bias_share=problem.bias_share ** (1.0 / lasts / np.where(once, longer, 1.0)),
    )
    return Graph(stated, (calibration_sd(), CALIBRATION_WALK), bias_m=solution.bias_m)


def pose_precision(graph: Graph, solution: Solution, anchors: Whole, starts: Whole) -> Precision:
    """Precision at the anchors (sorted keyframes), spread over the keyframes between them.

    Args:
        graph: as solved.
        solution: of it.
        anchors: `(k,)` keyframes at which it is computed, at least one a route.
        starts: first keyframe of each route, and their number.
    """
    covariance = np.empty((len(anchors), 3, 3))
    relative = np.empty(len(anchors))
    places = solution.poses[anchors, :2]
    points = solution.points_m
    gap, nearest = (
        scipy.spatial.KDTree(points).query(places)
        if len(points)
        else (np.full(len(anchors), np.inf), None)
    )
    for begin in range(0, len(anchors), _CHUNK):
        rows = np.arange(begin, min(begin + _CHUNK, len(anchors)))
        near = np.asarray(gap)[rows] <= _NO_POLE_M
        chosen = np.asarray(nearest)[rows[near]] if nearest is not None else rows[:0]
        beside, where = np.unique(chosen, return_inverse=True)
        joint = graph.covariance(anchors[rows], beside.astype(np.int64))
        count = 3 * len(rows)
        column = np.zeros(len(rows), dtype=np.int64)
        column[near] = count + 2 * where
        for k, anchor in enumerate(rows.tolist()):
            own = joint[3 * k : 3 * k + 3, 3 * k : 3 * k + 3]
            covariance[anchor] = own
            spread = own[:2, :2]
            if near[k]:
                pose, pole = slice(3 * k, 3 * k + 2), slice(column[k], column[k] + 2)
                cross = joint[pose, pole]
                spread = spread + joint[pole, pole] - cross - cross.T
            relative[anchor] = np.sqrt(max(float(np.trace(spread)) / 2.0, 1e-6))
    keyframes = np.arange(starts[-1])
    row = _before(anchors, keyframes, starts)
    after = np.minimum(row + 1, len(anchors) - 1)
    route = np.searchsorted(starts, anchors, side="right")
    after = np.where(route[after] == route[row], after, row)
    length = anchors[after] - anchors[row]
    share = np.clip((keyframes - anchors[row]) / np.where(length > 0, length, 1), 0.0, 1.0)
    mixed = covariance[row] + share[:, None, None] * (covariance[after] - covariance[row])
    return Precision(mixed, relative[row] + share * (relative[after] - relative[row]))


def _before(anchors: Whole, keyframes: Whole, starts: Whole) -> Whole:
    """The last anchor of the same route at or before each keyframe, else the route's first."""
    row = np.searchsorted(anchors, keyframes, side="right") - 1
    first = np.searchsorted(anchors, starts[:-1])
    route = np.searchsorted(starts, keyframes, side="right") - 1
    return np.maximum(row, first[route]).astype(np.int64)


def anchor_keyframes(starts: Whole, submaps: Whole, every: int) -> Whole:
    """Anchors of local maps, the first and last keyframe of each route, and every so many."""
    own = [submaps]
    for first, end in pairwise(starts.tolist()):
        own.append(np.arange(first, end, max(every, 1)))
        own.append(np.array([first, end - 1]))
    return np.unique(np.concatenate(own)).astype(np.int64)
