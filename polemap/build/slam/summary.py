"""Figures of a solved graph: residuals, loops, fixes, and what to expect along the routes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from polemap.build.slam.motion import CALIBRATION
from polemap.build.slam.noise import seen_residuals
from polemap.build.slam.precision import Precision
from polemap.build.slam.report import AlongRoute, DriveSummary, LoopFigures, SlamSummary
from polemap.build.slam.rounds import Closed, State
from polemap.build.slam.route import Route

Floats = NDArray[np.float64]
Whole = NDArray[np.int64]

_OUTLIER_WEIGHT = 0.1
_STATIONS_MOST = 600


def summarise(
    state: State, closed: Closed, precision: Precision, starts: Whole, shift_m: Floats
) -> SlamSummary:
    """The figures of a solved graph; `starts` are the first keyframes of its routes."""
    problem, solution = state.problem, state.solution
    residual = np.hypot(*seen_residuals(problem, solution).T) if len(problem.seen) else np.empty(0)
    place = np.sqrt(np.trace(precision.absolute[:, :2, :2], axis1=1, axis2=2) / 2.0)
    parts, first = [], 0
    off = solution.fix_residual_m
    for number, route in enumerate(state.routes):
        rows = slice(int(starts[number]), int(starts[number + 1]))
        fixes = slice(first, first + len(route.fix_s))
        first += len(route.fix_s)
        relative = precision.relative_sd_m[rows]
        way = float(np.sum(np.hypot(*np.diff(route.poses[:, :2], axis=0).T)))
        parts.append(
            DriveSummary(
                drive=route.name,
                way_m=way,
                fixes=len(route.fix_s),
                fixes_left_out=int(np.count_nonzero(solution.fix_weight[fixes] < _OUTLIER_WEIGHT)),
                fix_residual_m=float(np.median(off[fixes])) if len(route.fix_s) else float("nan"),
                absolute_sd_m=(float(np.median(place[rows])), float(place[rows].max())),
                relative_sd_m=(float(np.median(relative)), float(relative.max())),
                calibration=dict(zip(CALIBRATION, route.calibration.mean(axis=0), strict=True)),
                along=_along(
                    route, place[rows], relative, off[fixes], solution.fix_weight[fixes], shift_m
                ),
            )
        )
    given_up = int(np.count_nonzero(solution.link_weight < 0.25))
    return SlamSummary(
        drives=tuple(parts),
        loops=len(closed.loops),
        loops_taken_back=len(closed.taken_back),
        loops_ambiguous=closed.ambiguous,
        detection_residual_m=float(np.median(residual)) if len(residual) else float("nan"),
        links=len(problem.link),
        links_given_up=given_up,
        gnss_sd_m=state.noise.fix.sd_m,
        gnss_correlation_s=state.noise.fix.correlation_s,
        absolute=any(len(route.fix_s) for route in state.routes),
        places=_places(state, closed, starts),
    )


def _along(
    route: Route,
    absolute_sd_m: Floats,
    relative_sd_m: Floats,
    fix_off_m: Floats,
    fix_weight: Floats,
    shift_m: Floats,
) -> AlongRoute:
    way = _way_m(route)
    # of every so many keyframes the first: figures of a city are to stay a page
    step = max(1, -(-len(route) // _STATIONS_MOST))
    shown = np.unique([*range(0, len(route), step), len(route) - 1])
    every = max(1, -(-len(fix_off_m) // _STATIONS_MOST))
    fix_way = np.interp(route.fix_s, route.stamp_s, way)[::every]
    columns = (
        way[shown],
        route.poses[shown, 0] + shift_m[0],
        route.poses[shown, 1] + shift_m[1],
        absolute_sd_m[shown],
        relative_sd_m[shown],
        fix_way,
        fix_off_m[::every],
        fix_weight[::every],
    )
    return AlongRoute(*(tuple(np.round(column, 3).tolist()) for column in columns))


def _way_m(route: Route) -> Floats:
    step = np.hypot(*np.diff(route.poses[:, :2], axis=0).T)
    return np.concatenate([[0.0], np.cumsum(step)])


def _places(state: State, closed: Closed, starts: Whole) -> tuple[LoopFigures, ...]:
    ways = [_way_m(route) for route in state.routes]

    def place(submap: int) -> tuple[str, float]:
        keyframe = int(closed.anchors[submap])
        number = int(np.searchsorted(starts, keyframe, side="right")) - 1
        way = float(ways[number][keyframe - int(starts[number])])
        return state.routes[number].name, round(way, 1)

    solved = state.solution.poses[closed.anchors]
    rows = [(loop, False) for loop in closed.loops] + [(loop, True) for loop in closed.taken_back]
    return tuple(
        LoopFigures(
            *place(loop.first),
            *place(loop.second),
            poles=len(loop.landmarks),
            log_odds=round(loop.log_odds, 2),
            strain=round(loop.strain(solved), 2),
            taken_back=back,
        )
        for loop, back in rows
    )
