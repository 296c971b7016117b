"""The odometry's calibration from poles alone, on short stretches that each stand for themselves.

Without GNSS an error of the calibration turns the far end of a drive by radians, too far for any
linear step. Within a stretch of a minute it turns little; so the stretches are solved side by side,
tied to nothing but the calibration that they share, and the drive is dead reckoned anew with it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from polemap.build.slam.problem import Problem
from polemap.build.slam.route import Route

Floats = NDArray[np.float64]
Whole = NDArray[np.int64]

WINDOW_S = 40.0


def in_windows(problem: Problem, routes: Sequence[Route]) -> Problem:
    """The same problem without what ties one stretch to another, and without fixes."""
    number, start = [], 0
    for route in routes:
        part = np.floor((route.stamp_s - route.stamp_s[0]) / WINDOW_S).astype(np.int64)
        number.append(part + start)
        start += int(part[-1]) + 1
    window = np.concatenate(number)
    inside = window[problem.motion_from] == window[problem.motion_from + 1]
    # a landmark belongs to the stretch that saw it first
    first = np.full(len(problem.points_m), np.iinfo(np.int64).max)
    np.minimum.at(first, problem.seen, window[problem.seen_from])
    seen = window[problem.seen_from] == first[problem.seen]
    _, begins = np.unique(window, return_index=True)
    none = np.empty(0, dtype=np.int64)
    return replace(
        problem,
        motion_from=problem.motion_from[inside],
        motion_calibration=problem.motion_calibration[inside],
        motion=problem.motion[inside],
        motion_jacobian=problem.motion_jacobian[inside],
        motion_covariance=problem.motion_covariance[inside],
        seen_from=problem.seen_from[seen],
        seen=problem.seen[seen],
        seen_m=problem.seen_m[seen],
        seen_covariance_m2=problem.seen_covariance_m2[seen],
        fix_from=none,
        fix_bias=none,
        fix_m=np.empty((0, 2)),
        fix_antenna_m=np.empty((0, 2)),
        fix_sd_m=np.empty(0),
        bias_sd_m=np.empty(0),
        bias_share=np.empty(0),
        origin=begins.astype(np.int64),
    )
