"""Where a drive went by odometry and GNSS alone, found from its beginning on.

Odometry that is off by a few percent and by an offset of the steering turns a drive of some
kilometres round itself, so that nothing can be solved for at once. The way is therefore laid onto
the fixes stretch by stretch: each is dead reckoned on with the calibration found so far, and all
up to its end is solved again.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from polemap.build.slam.config import SlamConfig
from polemap.build.slam.constants import CALIBRATION_WALK
from polemap.build.slam.graph import Graph
from polemap.build.slam.noise import stated_noise
from polemap.build.slam.route import Route
from polemap.build.slam.tables import NO_LINKS, NO_SIGHTINGS, build_problem, calibration_sd
from polemap.vehicle.pose import compose, relative, rigid_fit, transform_points

Floats = NDArray[np.float64]

FIXES_MIN = 3  # fewer do not tell a heading
_STRETCH_S = 60.0
_HELD_AFTER = 30  # stretches
_START_M = 30.0  # of way that tells a heading
_SPACING_M = 10.0
_TRIES = 200
_STEPS = 5
_FIX_EVERY_S = 4.0


def lay_on_fixes(route: Route, config: SlamConfig, *, thin: bool = True) -> Route:
    """The route on its fixes; without any it stays where dead reckoning has it, and too few of
    them move it only. Without `thin` all of its keyframes and fixes are taken."""
    if not len(route.fix_s):
        return route
    if len(route.fix_s) < FIXES_MIN:
        here = transform_points(route.path.at(route.fix_s[:1])[0], route.antenna_m)
        move = np.array([*(route.fix_m[0] - here), 0.0])
        return replace(route, poses=route.poses + move)
    coarse = _coarse(route) if thin else route
    coarse = replace(coarse, poses=_start(coarse, config))
    ends = np.arange(coarse.stamp_s[0] + _STRETCH_S, coarse.stamp_s[-1] + _STRETCH_S, _STRETCH_S)
    counts = np.unique(np.searchsorted(coarse.stamp_s, ends, side="right"))
    known = 1
    stops = counts[counts >= 2].tolist()
    for number, count in enumerate(stops):
        # what lies half an hour back stays where it was found
        first = stops[number - _HELD_AFTER] - 1 if number >= _HELD_AFTER else 0
        poses = coarse.poses.copy()
        # from the last that is known on by odometry, with the calibration found so far
        poses[known:] = compose(
            poses[known - 1],
            relative(
                coarse.path.at(coarse.stamp_s[known - 1]), coarse.path.at(coarse.stamp_s[known:])
            ),
        )
        coarse = replace(coarse, poses=poses)
        part = coarse.between(first, count)
        problem = build_problem([part], NO_SIGHTINGS, NO_LINKS, stated_noise(config))
        if first > 0:
            problem = replace(problem, origin=np.zeros(1, dtype=np.int64))
        solved = Graph(problem, (calibration_sd(), CALIBRATION_WALK)).solve(_STEPS)
        poses = coarse.poses.copy()
        poses[first:count] = solved.poses
        calibration = coarse.calibration.copy()
        mine = int(coarse.calibration_of(coarse.stamp_s[first : first + 1])[0])
        calibration[mine:] = solved.calibration[mine:]
        coarse = replace(coarse, poses=poses).with_calibration(calibration)
        known = count
    fine = route.with_calibration(coarse.calibration)
    return replace(fine, poses=coarse.poses_at(route.stamp_s))


def _coarse(route: Route) -> Route:
    """The same route with a keyframe every ten metres, and every ten seconds."""
    way = np.interp(route.stamp_s, route.path.stamp_s, route.path.travelled_m)
    tick = np.floor(way / _SPACING_M)
    keep = np.concatenate([[True], np.diff(tick) > 0])
    keep[-1] = True
    tick = np.floor(route.fix_s / _FIX_EVERY_S)
    fixes = np.concatenate([[True], np.diff(tick) > 0])
    thin = replace(
        route,
        stamp_s=route.stamp_s[keep],
        poses=route.poses[keep],
        fix_s=route.fix_s[fixes],
        fix_m=route.fix_m[fixes],
        hdop=route.hdop[fixes],
    )
    return thin.with_calibration(route.calibration)


def _start(route: Route, config: SlamConfig) -> Floats:
    """Poses with the first stretch turned and moved onto its fixes: most of them decide."""
    way = np.interp(route.fix_s, route.path.stamp_s, route.path.travelled_m)
    first = way <= max(way[0] + _START_M, _START_M)
    if np.count_nonzero(first) < FIXES_MIN:
        first = np.arange(len(way)) < FIXES_MIN
    here = transform_points(route.path.at(route.fix_s[first]), route.antenna_m)
    there = route.fix_m[first]
    best, most = np.array([*(there[0] - here[0]), 0.0]), -1.0
    rng = np.random.default_rng(0)
    reach = 2.0 * config.gnss_sd_m * float(np.median(route.hdop[first]))
    for _ in range(_TRIES):
        pair = rng.choice(len(here), size=min(2, len(here)), replace=False)
        pose = rigid_fit(here[pair], there[pair])
        off = np.hypot(*(transform_points(pose, here) - there).T)
        support = float(np.sum(np.maximum(0.0, 1.0 - (off / reach) ** 2)))
        if support > most:
            best, most = pose, support
    off = np.hypot(*(transform_points(best, here) - there).T)
    fits = off <= reach
    if np.count_nonzero(fits) >= 2:
        best = rigid_fit(here[fits], there[fits])
    return compose(best, route.path.at(route.stamp_s))
