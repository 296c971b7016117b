"""Rounds of association and solving: single passes, then loops, then poles that passes share."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from polemap.build.config import MappingConfig
from polemap.build.slam.association import Seen, poles, see
from polemap.build.slam.config import SlamConfig
from polemap.build.slam.constants import CALIBRATION_WALK, KEYFRAME_M, ROUNDS_MOST, SUBMAP_M
from polemap.build.slam.fix_noise import FixNoise, measure_fixes
from polemap.build.slam.graph import LINK_SCALE, Graph
from polemap.build.slam.known import KnownPoles
from polemap.build.slam.loop import STRAIN_PROBABILITY, Found, Loop
from polemap.build.slam.loops import find_loops, recall_loops
from polemap.build.slam.noise import Noise, measure_noise
from polemap.build.slam.problem import Problem, Solution
from polemap.build.slam.route import Route
from polemap.build.slam.submaps import Submap, cut_submaps
from polemap.build.slam.tables import NO_LINKS, build_problem, calibration_sd, pose_starts
from polemap.build.slam.windows import in_windows
from polemap.drivelog.detections import Detections
from polemap.drivelog.frames import EarthFrame
from polemap.vehicle.kalman import chi_square_gate

Floats = NDArray[np.float64]
Whole = NDArray[np.int64]

_STEPS = 10
_WINDOW_ROUNDS = 3
_SETTLED_M = 0.02
_SCALES = (20.0 * LINK_SCALE, 5.0 * LINK_SCALE)
_FEW_AT_ODDS = 0.05  # of the loops: so many may be chance, and need no further round
_BROKEN_WEIGHT = 0.25  # of a link that its kernel has given up


@dataclass(frozen=True, slots=True)
class State:
    """What is known after a round."""

    routes: tuple[Route, ...]
    seen: Seen
    noise: Noise
    problem: Problem
    solution: Solution
    graph: Graph


class Builder:
    """The rounds over the same drives; see the module."""

    beside = round(SUBMAP_M / KEYFRAME_M) // 2  # see `Problem`

    def __init__(
        self,
        scans: Sequence[Sequence[Detections]],
        mapping: MappingConfig,
        config: SlamConfig,
        frame: EarthFrame,
        known: KnownPoles | None = None,
    ) -> None:
        """With `known`, the drives lie in a map that is there already, and are held by it."""
        self._scans = scans
        self._mapping = mapping
        self.config = config
        self._frame = frame
        self._known = known

    def poles(self, seen: Seen) -> tuple[Floats, Whole]:
        """Poles of several passes, and the links that lead to them."""
        return poles(seen, self._mapping)

    def associate(self, routes: Sequence[Route]) -> Seen:
        """Landmarks of single passes, from the poses of the routes."""
        return see(routes, self._scans, self._mapping, self._frame)

    def solve(
        self,
        routes: Sequence[Route],
        seen: Seen,
        noise: Noise,
        link: Whole = NO_LINKS,
        extra_m: Floats | None = None,
        scales: Sequence[float] = (),
        steps: int = _STEPS,
    ) -> State:
        """Solve, with links that pull from afar first where `scales` says so."""
        sds = (calibration_sd(), CALIBRATION_WALK)
        problem = build_problem(routes, seen.sightings, link, noise, extra_m=extra_m)
        problem = replace(problem, beside=self.beside)
        if self._known is not None:
            problem = self._known.hold(problem, seen)
            scales = scales or _SCALES[-1:]
        for scale in scales:
            begun = Graph(problem, sds, scale).solve(4)
            problem = replace(problem, poses=begun.poses, points_m=begun.points_m)
        graph = Graph(problem, sds)
        solution = graph.solve(steps)
        return State(tuple(_moved(routes, solution)), seen, noise, problem, solution, graph)

    def measured(self, state: State) -> Noise:
        """The noise that the residuals of a state show."""
        fix_s = np.concatenate([route.fix_s for route in state.routes])
        hdop = np.concatenate([route.hdop for route in state.routes])
        return measure_noise(state.problem, state.solution, state.noise, fix_s, hdop, self.config)

    def fixes(self, state: State) -> FixNoise:
        """The noise of the fixes that is to be stated of a solved state."""
        fix_s = np.concatenate([route.fix_s for route in state.routes])
        hdop = np.concatenate([route.hdop for route in state.routes])
        return measure_fixes(state.problem, state.solution, fix_s, hdop, self.config)

    def submaps(self, state: State) -> list[Submap]:
        """The local maps that loops are looked for with."""
        landmarks = state.seen.landmarks
        return cut_submaps(
            state.routes, state.seen.sightings, state.solution.points_m, landmarks.width_m,
            landmarks.kind,
        )  # fmt: skip

    def find_loops(
        self,
        submaps: Sequence[Submap],
        poses: Floats,
        anchors: Whole,
        graph: Graph,
        known: Collection[tuple[int, int]],
    ) -> Found:
        """Loops among local maps at `poses` `(n, 3)`, which are the keyframes `anchors` `(n,)`."""
        covariance = graph.covariance(anchors, np.empty(0, dtype=np.int64))
        found = find_loops(submaps, poses, covariance, self.config, known)
        if not found.loops and found.unreached:
            return recall_loops(submaps, poses, covariance, self.config, known)
        return found

    def calibrate(self, routes: Sequence[Route], noise: Noise) -> list[Route]:
        """Routes dead reckoned anew with the calibration that poles alone show."""
        sds = (calibration_sd(), CALIBRATION_WALK)
        routes = list(routes)
        for _ in range(_WINDOW_ROUNDS):
            seen = self.associate(routes)
            problem = build_problem(routes, seen.sightings, NO_LINKS, noise)
            solution = Graph(in_windows(problem, routes), sds).solve(_STEPS)
            routes = [route.reckoned() for route in _moved(routes, solution)]
        return routes


def _moved(routes: Sequence[Route], solution: Solution) -> list[Route]:
    poses = pose_starts(routes)
    rows = np.cumsum([0, *(len(route.calibration) for route in routes)])
    return [
        replace(route, poses=solution.poses[a:b]).with_calibration(solution.calibration[c:d])
        for route, a, b, c, d in zip(routes, poses, poses[1:], rows, rows[1:], strict=False)
    ]


@dataclass(frozen=True, slots=True)
class Closed:
    """What became of the loops.

    Attributes:
        loops, taken_back: those that hold, and those that the rest contradicted, each time.
        ambiguous: matches that were left as two places would have served.
        rounds: that it took.
        anchors: `(n,)` keyframe of every local map that the loops count by.
    """

    loops: tuple[Loop, ...]
    taken_back: tuple[Loop, ...]
    ambiguous: int
    rounds: int
    anchors: Whole


def close_loops(builder: Builder, state: State) -> tuple[State, Closed]:
    """Find loops and solve, until no new one is found and none is given up."""
    loops: dict[tuple[int, int], Loop] = {}
    refused: dict[tuple[int, int], int] = {}
    taken_back: list[Loop] = []
    anchors: Whole = np.empty(0, dtype=np.int64)
    ambiguous = rounds = 0
    seen = state.seen
    for rounds in range(1, ROUNDS_MOST + 1):  # noqa: B007
        submaps = builder.submaps(state)
        anchors = np.array([submap.anchor for submap in submaps], dtype=np.int64)
        poses = state.solution.poses[anchors]
        known = set(loops) | {pair for pair, times in refused.items() if times >= 2}
        found = builder.find_loops(submaps, poses, anchors, state.graph, known)
        state.graph.forget_marginals()
        ambiguous = found.ambiguous
        loops |= {(loop.first, loop.second): loop for loop in found.loops}
        if not found.loops:
            break
        links = Found(tuple(loops.values()), 0, 0).links()
        start = replace(seen.sightings, start_m=state.solution.points_m[: len(seen.landmarks)])
        begun = replace(seen, sightings=start)
        level = builder.measured(state)
        state = builder.solve(state.routes, begun, level, links, scales=_SCALES)
        broken = _broken(loops, state.problem.link, state.solution)
        solved = state.solution.poses[anchors]
        broken += [
            pair
            for pair, loop in loops.items()
            if pair not in broken and loop.strain(solved) > chi_square_gate(STRAIN_PROBABILITY, 3)
        ]
        for pair in broken:
            refused[pair] = refused.get(pair, 0) + 1
            taken_back.append(loops.pop(pair))
        few = found.at_odds <= _FEW_AT_ODDS * len(loops)
        if not broken and few and not found.unreached:
            break
    closed = Closed(tuple(loops.values()), tuple(taken_back), ambiguous, rounds, anchors)
    return state, closed


def _broken(
    loops: dict[tuple[int, int], Loop], links: Whole, solution: Solution
) -> list[tuple[int, int]]:
    """Loops of which the kernels gave up most links."""
    weight = {
        tuple(pair): w
        for pair, w in zip(links.tolist(), solution.link_weight.tolist(), strict=True)
    }
    broken = []
    for pair, loop in loops.items():
        rows = np.sort(loop.landmarks, axis=1).tolist()
        weights = [weight[tuple(row)] for row in rows if row[0] != row[1]]
        if weights and float(np.median(weights)) < _BROKEN_WEIGHT:
            broken.append(pair)
    return broken


def settle(builder: Builder, state: State) -> State:
    """Join passes to poles and solve, until the poses stay where they are."""
    for _ in range(ROUNDS_MOST):
        seen = builder.associate(state.routes)
        points, link = builder.poles(seen)
        after = builder.solve(state.routes, seen, builder.measured(state), link, points)
        move = np.abs(after.solution.poses - np.concatenate([r.poses for r in state.routes]))
        state = after
        # what no pole holds wanders on a little from round to round, and changes nothing else
        if not len(move) or np.quantile(move[:, :2], 0.95) < _SETTLED_M:
            break
    return state
