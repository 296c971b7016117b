"""What the graph is made of: tables of poses, motions, detections, fixes and links."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Whole = NDArray[np.int64]

# of the keyframes beside, that see poles of other passes where a place is seen again
_SHARED = 0.3


@dataclass(frozen=True, slots=True)
class Problem:
    """One factor graph in the plane; poses of all drives in one numbering.

    Attributes:
        poses: `(n, 3)` where solving begins; points_m: `(m, 2)` of the landmarks.
        calibration: `(k, 6)` about which the motions were taken.
        calibration_walk: `(k,)` whether a row goes on from the one before (same drive).
        motion_from, motion_calibration: `(a,)` pose that a motion starts from, and its calibration;
            it leads to the next pose.
        motion, motion_jacobian, motion_covariance: `(a, 3)`, `(a, 3, 6)`, `(a, 3, 3)`.
        seen_from, seen: `(b,)` pose and landmark of a detection; seen_m: `(b, 2)` in the vehicle
            frame; seen_covariance_m2: `(b, 2, 2)`.
        fix_from, fix_bias: `(c,)` pose and bias of a fix; fix_m: `(c, 2)` in the map;
            fix_antenna_m: `(c, 2)` antenna in the frame of that pose; fix_sd_m: `(c,)` white part.
        bias_sd_m, bias_share: `(d,)` sd of a bias, and the correlation with the bias before it, 0
            where a drive begins.
        link: `(e, 2)` landmarks that are one pole; link_sd_m: `(e,)` their difference.
        calibration_known, calibration_information: `(k, 6)`, `(k, 6, 6)` what is known of the
            calibration beside its prior; nothing where the information is zero.
        origin: `(f,)` poses that are held where they are: the origin of a local frame.
        known: `(g,)` landmarks of a map that is there already; known_m: `(g, 2)`,
            known_covariance_m2: `(g, 2, 2)` where it has them.
        beside: poses on each side that show what one of them does.
    """

    poses: Floats
    points_m: Floats
    calibration: Floats
    calibration_walk: NDArray[np.bool_]
    motion_from: Whole
    motion_calibration: Whole
    motion: Floats
    motion_jacobian: Floats
    motion_covariance: Floats
    seen_from: Whole
    seen: Whole
    seen_m: Floats
    seen_covariance_m2: Floats
    fix_from: Whole
    fix_bias: Whole
    fix_m: Floats
    fix_antenna_m: Floats
    fix_sd_m: Floats
    bias_sd_m: Floats
    bias_share: Floats
    link: Whole
    link_sd_m: Floats
    origin: Whole
    calibration_known: Floats = field(default_factory=lambda: np.empty((0, 6)))
    calibration_information: Floats = field(default_factory=lambda: np.empty((0, 6, 6)))
    known: Whole = field(default_factory=lambda: np.empty(0, dtype=np.int64))
    known_m: Floats = field(default_factory=lambda: np.empty((0, 2)))
    known_covariance_m2: Floats = field(default_factory=lambda: np.empty((0, 2, 2)))
    beside: int = 0


@dataclass(frozen=True, slots=True)
class Solution:
    """What the graph was solved to.

    Attributes:
        poses, points_m, calibration, bias_m: as in `Problem`.
        cost: half the sum of squared, robust residuals.
        link_weight: `(e,)` what a robust kernel leaves of each link, 0 to 1.
        fix_weight: `(c,)` the same of the fixes; fix_residual_m: `(c,)` from fix to antenna.
    """

    poses: Floats
    points_m: Floats
    calibration: Floats
    bias_m: Floats
    cost: float
    link_weight: Floats
    fix_weight: Floats
    fix_residual_m: Floats


def seen_once(problem: Problem) -> NDArray[np.bool_]:
    """Poses `(n,)` about which hardly a pole was seen by another pass, or is known.

    The poses `problem.beside` before and after are asked too.
    """
    shared = np.zeros(len(problem.points_m), dtype=np.bool_)
    shared[problem.link.ravel()] = True
    seen = np.bincount(problem.seen_from, shared[problem.seen], len(problem.poses))
    # of a neighbourhood, within one drive
    begin = np.setdiff1d(np.arange(len(problem.poses)), problem.motion_from + 1)
    total = np.concatenate([[0.0], np.cumsum(seen >= 1.0)])
    row = np.arange(len(problem.poses))
    first = np.maximum(row - problem.beside, begin[np.searchsorted(begin, row, side="right") - 1])
    ends = np.append(begin[1:], len(row))
    last = np.minimum(row + problem.beside + 1, ends[np.searchsorted(begin, row, side="right") - 1])
    return np.asarray((total[last] - total[first]) < _SHARED * (last - first))
