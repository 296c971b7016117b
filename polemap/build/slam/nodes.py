"""What a condensed drive saw in the frames of its nodes, and back from there to solved poses."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from polemap.build.drive_observations import DriveObservations
from polemap.build.slam.condense import Condensed
from polemap.build.slam.constants import KEYFRAME_M
from polemap.build.slam.route import Route
from polemap.build.slam.submaps import Submap
from polemap.build.traversals import TraversalLandmarks
from polemap.drivelog.frames import EarthFrame
from polemap.drivelog.streams import ReferenceStream
from polemap.vehicle.pose import (
    inverse_transform_points,
    rotate,
    rotate_covariance,
    transform_points,
    wrap_angle,
)

Floats = NDArray[np.float64]
Whole = NDArray[np.int64]

_SEEN_MIN = 3  # as in `association` and `submaps`


@dataclass(frozen=True, slots=True)
class PassPoles:
    """Poles of the passes of one drive, and their local maps, in the frames of its nodes.

    Attributes:
        landmarks: at the poses of the chain; node: `(m,)` nearest to each; point_m: `(m, 2)` and
            covariance_m2 `(m, 2, 2)` in its frame; turn_rad: `(m,)` yaw of it in the chain.
        cannot_link: `(k, 2)`.
        local: a local map a node, with its row of landmarks; None where too few poles are.
    """

    landmarks: TraversalLandmarks
    node: Whole
    point_m: Floats
    covariance_m2: Floats
    turn_rad: Floats
    cannot_link: Whole
    local: tuple[Submap, ...]


def poles_of(part: Condensed) -> PassPoles:
    """Poles of the passes of a drive, each in the frame of its nearest node."""
    seen = part.observed
    solid = seen.landmarks.observations >= _SEEN_MIN
    number = np.cumsum(solid) - 1
    landmarks = seen.landmarks.take(solid)
    way = _way(part, seen.detections.stamp_s)
    mine = solid[seen.rows]
    row, at = number[seen.rows[mine]], way[mine]
    count = np.maximum(np.bincount(row, minlength=len(landmarks)), 1)
    middle = np.bincount(row, at, len(landmarks)) / count
    nodes = _way(part, part.stamp_s)
    node = _nearest(nodes, middle)
    pose = part.chain[node]
    pair = seen.cannot_link[solid[seen.cannot_link].all(axis=1)]
    turn = np.array(pose[:, 2])
    return PassPoles(
        landmarks=landmarks,
        node=node,
        point_m=inverse_transform_points(pose, landmarks.points_m),
        covariance_m2=rotate_covariance(landmarks.covariance_m2, -turn),
        turn_rad=turn,
        cannot_link=number[pair].reshape(-1, 2).astype(np.int64),
        local=tuple(_local_maps(part, landmarks, row, at, nodes, seen.detections.range_m[mine])),
    )


def _way(part: Condensed, stamps_s: Floats) -> Floats:
    return np.interp(stamps_s, part.path.stamp_s, part.path.travelled_m)


def _nearest(nodes: Floats, way: Floats) -> Whole:
    """The node nearest along the way, `(m,)`; both `nodes` `(n,)` and `way` in metres."""
    return np.searchsorted(0.5 * (nodes[1:] + nodes[:-1]), way).astype(np.int64)


def _local_maps(
    part: Condensed,
    landmarks: TraversalLandmarks,
    row: Whole,
    way: Floats,
    nodes: Floats,
    range_m: Floats,
) -> list[Submap]:
    """Local maps about the nodes: of detections `row` `(d,)`, their `way` and `range_m`."""
    stride = np.floor(way / KEYFRAME_M).astype(np.int64)
    about = _nearest(nodes, np.asarray((stride + 0.5) * KEYFRAME_M, dtype=np.float64))
    strides = np.unique(np.column_stack([about, row, stride]), axis=0)
    pairs, times = np.unique(strides[:, :2], axis=0, return_counts=True)
    pairs = pairs[times >= _SEEN_MIN]
    steps = np.arange(0.0, nodes[-1] + KEYFRAME_M, KEYFRAME_M)
    stamps = np.interp(steps, part.path.travelled_m, part.path.stamp_s)
    places = part.path.at(stamps)[:, :2]
    owner = _nearest(nodes, np.asarray(steps, dtype=np.float64))
    local = []
    for node in np.unique(pairs[:, 0]).tolist():
        own = pairs[pairs[:, 0] == node, 1]
        pose = part.chain[node]
        local.append(
            Submap(
                route=0,
                anchor=node,
                landmark=own,
                points_m=inverse_transform_points(pose, landmarks.points_m[own]),
                width_m=landmarks.width_m[own],
                kind=landmarks.kind[own],
                way_m=inverse_transform_points(pose, places[owner == node]),
                reach_m=float(np.quantile(range_m[about == node], 0.9)),
            )
        )
    return local


def placed(
    part: Condensed, route: Route, shift_m: Floats, frame: EarthFrame, reference: ReferenceStream
) -> DriveObservations:
    """What a drive saw, from the solved poses instead of those of its chain."""
    seen = part.observed
    views, detections, landmarks = seen.detections.views, seen.detections, seen.landmarks
    move = np.array([*shift_m, 0.0])
    poses = route.poses_at(views.stamp_s) + move
    points, turn = _carried(detections.points_m, views.poses, poses, detections.scan)
    middle = 0.5 * (landmarks.first_s + landmarks.last_s)
    there = route.poses_at(middle) + move
    marks, turned = _carried(
        landmarks.points_m, part.path.at(middle), there, np.arange(len(landmarks))
    )
    detections = replace(
        detections,
        frame=frame,
        views=replace(views, poses=poses),
        points_m=points,
        covariance_m2=rotate_covariance(detections.covariance_m2, turn),
        gain_m_per_px=rotate(detections.gain_m_per_px, turn),
        direction_rad=wrap_angle(detections.direction_rad + turn),
        reference_sd_m=reference.sd_at(detections.stamp_s),
    )
    landmarks = landmarks.with_columns(
        points_m=marks,
        covariance_m2=rotate_covariance(landmarks.covariance_m2, turned),
        gain_m_per_px=rotate(landmarks.gain_m_per_px, turned),
        direction_rad=wrap_angle(landmarks.direction_rad + turned),
        reference_sd_m=reference.sd_at(middle),
    )
    return DriveObservations(detections, landmarks, seen.rows, seen.cannot_link)


def _carried(points_m: Floats, before: Floats, after: Floats, row: Whole) -> tuple[Floats, Floats]:
    """Points moved with the poses they were seen from, `row` `(n,)`, and their turns."""
    local = inverse_transform_points(before[row], points_m)
    turn = wrap_angle(after[row, 2] - before[row, 2])
    return transform_points(after[row], local), turn
