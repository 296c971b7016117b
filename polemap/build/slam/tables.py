"""Routes, detections and links of all drives to the tables of one graph."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from polemap.build.slam.constants import (
    CURVATURE_OFFSET_SD_RADPM,
    POLE_FLOOR_M,
    SAME_POLE_SD_M,
    SIDESLIP_SD_RAD,
    SLIP_SD_RAD_PER_MPS2,
    SPEED_SCALE_SD,
    YAW_RATE_OFFSET_SD_RADPS,
    YAW_RATE_SCALE_SD,
)
from polemap.build.slam.noise import Noise
from polemap.build.slam.problem import Problem
from polemap.build.slam.route import Route
from polemap.vehicle.pose import rotate, rotate_covariance

Floats = NDArray[np.float64]
Whole = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class Sightings:
    """Detections of all drives, gathered a row a landmark a keyframe.

    Attributes:
        pose: `(n,)` keyframe, numbered through all routes; landmark: `(n,)`.
        point_m: `(n, 2)` in the vehicle frame of the keyframe; covariance_m2: `(n, 2, 2)`.
        start_m: `(m, 2)` where the landmarks stand, as far as is known.
    """

    pose: Whole
    landmark: Whole
    point_m: Floats
    covariance_m2: Floats
    start_m: Floats


NO_SIGHTINGS = Sightings(
    np.empty(0, dtype=np.int64), np.empty(0, dtype=np.int64), np.empty((0, 2)),
    np.empty((0, 2, 2)), np.empty((0, 2)),
)  # fmt: skip
NO_LINKS = np.empty((0, 2), dtype=np.int64)


def pose_starts(routes: Sequence[Route]) -> Whole:
    """Number of the first keyframe of each route, and of all, `(len(routes) + 1,)`."""
    return np.cumsum([0, *(len(route) for route in routes)]).astype(np.int64)


def gather(
    pose: Whole, landmark: Whole, point_m: Floats, covariance_m2: Floats, start_m: Floats
) -> Sightings:
    """Detections of one landmark at one keyframe to their mean.

    Neighbouring scans err alike, so that a mean is no better than one of them.
    """
    n = len(start_m)
    code, row, count = np.unique(pose * n + landmark, return_inverse=True, return_counts=True)
    mean = np.column_stack([np.bincount(row, point_m[:, a], len(code)) for a in (0, 1)])
    covariance = np.zeros((len(code), 2, 2))
    np.add.at(covariance, row, covariance_m2)
    return Sightings(
        code // n, code % n, mean / count[:, None], covariance / count[:, None, None], start_m
    )


def build_problem(
    routes: Sequence[Route],
    sightings: Sightings,
    link: Whole,
    noise: Noise,
    *,
    extra_m: Floats | None = None,
) -> Problem:
    """The tables of the graph; `extra_m` `(q, 2)` are further landmarks, which links tie."""
    starts = pose_starts(routes)
    rows = np.cumsum([0, *(len(route.calibration) for route in routes)])
    columns = [_route_columns(route, noise) for route in routes]
    biases = np.cumsum([0, *(len(route.fix_s) for route in routes)])
    extra = np.empty((0, 2)) if extra_m is None else extra_m
    known = [route.calibration_knowledge() for route in routes]
    origin = [start for start, route in zip(starts, routes, strict=False) if not len(route.fix_s)]
    return Problem(
        poses=np.concatenate([route.poses for route in routes]),
        points_m=np.concatenate([sightings.start_m, extra]),
        calibration=np.concatenate([route.calibration for route in routes]),
        calibration_walk=np.concatenate(
            [np.arange(len(route.calibration)) > 0 for route in routes]
        ),
        motion_from=np.concatenate(
            [np.arange(len(r) - 1) + s for r, s in zip(routes, starts, strict=False)]
        ),
        motion_calibration=np.concatenate(
            [
                route.calibration_of(route.stamp_s[:-1]) + row
                for route, row in zip(routes, rows, strict=False)
            ]
        ),
        motion=np.concatenate([route.steps.motion for route in routes]),
        motion_jacobian=np.concatenate([route.steps.jacobian for route in routes]),
        motion_covariance=np.concatenate([route.steps.covariance for route in routes]),
        seen_from=sightings.pose,
        seen=sightings.landmark,
        seen_m=sightings.point_m,
        seen_covariance_m2=noise.seen_variance
        * (sightings.covariance_m2 + np.eye(2) * POLE_FLOOR_M**2),
        fix_from=np.concatenate([c[0] + s for c, s in zip(columns, starts, strict=False)]),
        fix_bias=np.concatenate(
            [np.arange(len(r.fix_s)) + b for r, b in zip(routes, biases, strict=False)]
        ),
        fix_m=np.concatenate([route.fix_m for route in routes]),
        fix_antenna_m=np.concatenate([c[1] for c in columns]),
        fix_sd_m=np.concatenate([noise.fix.white_m * route.hdop for route in routes]),
        bias_sd_m=np.concatenate([c[2] for c in columns]),
        bias_share=np.concatenate([c[3] for c in columns]),
        link=link,
        link_sd_m=np.full(len(link), SAME_POLE_SD_M),
        origin=np.array(origin[:1], dtype=np.int64),
        calibration_known=np.concatenate([mean for mean, _ in known]),
        calibration_information=np.concatenate([information for _, information in known]),
    )


def _route_columns(route: Route, noise: Noise) -> tuple[Whole, Floats, Floats, Floats]:
    """Keyframe, antenna, and sd and correlation of the bias of every fix."""
    keyframe = route.keyframe_of(route.fix_s)
    offset = route.from_keyframe(keyframe, route.fix_s)
    antenna = rotate(np.broadcast_to(route.antenna_m, (len(offset), 2)), offset[:, 2])
    share = np.zeros(len(route.fix_s))
    share[1:] = np.exp(-np.diff(route.fix_s) / noise.fix.correlation_s)
    return keyframe, antenna + offset[:, :2], noise.fix.lasting_m * route.hdop, share


def calibration_sd() -> Floats:
    """What the calibration is known to beforehand, `(6,)`."""
    return np.array(
        [
            SPEED_SCALE_SD,
            YAW_RATE_SCALE_SD,
            YAW_RATE_OFFSET_SD_RADPS,
            CURVATURE_OFFSET_SD_RADPM,
            SIDESLIP_SD_RAD,
            SLIP_SD_RAD_PER_MPS2,
        ]
    )


def detections_at_keyframes(
    route: Route, stamps_s: Floats, points_m: Floats, covariance_m2: Floats
) -> tuple[Whole, Floats, Floats]:
    """Keyframe of each detection, and the detection in that keyframe's axes."""
    keyframe = route.keyframe_of(stamps_s)
    offset = route.from_keyframe(keyframe, stamps_s)
    return (
        keyframe,
        rotate(points_m, offset[:, 2]) + offset[:, :2],
        rotate_covariance(covariance_m2, offset[:, 2]),
    )
