"""Corners have a side: one that faces away from where its map says is another corner.

The kernel of the poles compares widths; corners have none, and their sides take that place. A side
is an angle, so the circle is cut open where neither seen nor mapped corners face.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.detections import Detections
from polemap.drivelog.landmark_kind import LandmarkKind
from polemap.localize.particle_filter.landmarks import Landmarks
from polemap.localize.particle_filter.sensor_model import PoleModel, PoseLikelihoods
from polemap.vehicle.pose import wrap_angle

Floats = NDArray[np.float64]

_SIDE_SD_RAD = 0.3  # of the difference between a seen and a mapped side
_SIDES_SD = 3.0  # sides further apart are different
# of a mapped corner in view, of those of a pole: its flank must be seen, and a free side
CORNER_DETECTION = 0.7
# poses are taken to look the same way within this
_TURN_RAD = 0.2


def are_corners(scan: Detections, landmarks: Landmarks) -> bool:
    """Whether landmarks of one kind, seen and mapped, are corners."""
    kinds = scan.kind if len(scan) else landmarks.kind
    return bool(len(kinds)) and int(kinds[0]) == LandmarkKind.CORNER


def corner_model(model: PoleModel) -> PoleModel:
    """The model of poles with sides for widths; clutter faces anywhere."""
    return replace(model, width_sd_m=_SIDE_SD_RAD, clutter_width_span_m=2.0 * np.pi)


def by_turn(
    weigh: Callable[[Floats, Detections, Landmarks], PoseLikelihoods],
    poses: Floats,
    scan: Detections,
    landmarks: Landmarks,
) -> PoseLikelihoods:
    """What `weigh` says of poses `(n, 3)` of corners, those that look alike together."""
    less = replace(landmarks, detection=landmarks.detection * CORNER_DETECTION)
    turn = wrap_angle(poses[:, 2] - poses[0, 2])
    if np.ptp(turn) <= 2.0 * _TURN_RAD:
        yaw = float(poses[0, 2] + 0.5 * (turn.min() + turn.max()))
        return weigh(poses, *with_sides(scan, less, yaw))
    group = np.floor(turn / _TURN_RAD)
    out: PoseLikelihoods | None = None
    for turned in np.unique(group).tolist():
        rows = np.flatnonzero(group == turned)
        yaw = float(poses[0, 2] + (turned + 0.5) * _TURN_RAD)
        part = weigh(poses[rows], *with_sides(scan, less, yaw))
        if out is None:
            n = len(poses)
            out = PoseLikelihoods(
                np.empty(n), np.empty(n), np.empty(n), np.empty(n, dtype=np.int32),
                np.empty((n if len(part.assignment) else 0, len(scan)), dtype=np.int32),
            )  # fmt: skip
        for name in ("log_likelihood", "log_fit", "expected", "matched"):
            getattr(out, name)[rows] = getattr(part, name)
        if len(part.assignment):
            out.assignment[rows] = part.assignment
    assert out is not None
    return out


def with_sides(
    scan: Detections, landmarks: Landmarks, yaw_rad: float
) -> tuple[Detections, Landmarks]:
    """Corners with their sides, on a circle that is cut open, in place of widths.

    Where corners face everywhere, seen ones that face near the cut have no known side.
    """
    seen = scan.facing_rad + yaw_rad
    mapped = landmarks.facing_rad
    if mapped is None:
        mapped = np.full(len(landmarks), np.nan)
    sides = np.sort(np.mod(np.concatenate([seen, mapped]), 2.0 * np.pi))
    sides = sides[np.isfinite(sides)]
    cut, gap = 0.0, 2.0 * np.pi
    if len(sides):
        gaps = np.diff(sides, append=sides[0] + 2.0 * np.pi)
        widest = int(gaps.argmax())
        gap = float(gaps[widest])
        cut = float(sides[widest] + 0.5 * gap)
    opened = np.mod(seen - cut, 2.0 * np.pi)
    limit = _SIDES_SD * _SIDE_SD_RAD
    if gap < limit:
        opened = np.where((opened < limit) | (opened > 2.0 * np.pi - limit), np.nan, opened)
    return (
        scan.with_columns(width_m=opened),
        replace(landmarks, width_m=np.mod(mapped - cut, 2.0 * np.pi)),
    )
