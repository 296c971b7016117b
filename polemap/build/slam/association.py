"""Detections to landmarks of single passes, and these to poles, at the poses solved so far.

Both are what map building does with a reference (`build/traversals`, `build/merge`): optimal
one-to-one assignment a scan, then joining from the most to the least alike, never two that were
seen side by side. Nothing is kept from round to round: what joined two trees before is apart as
soon as the poses say so.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from polemap.build.config import MappingConfig
from polemap.build.drive_observations import DriveObservations, join_cannot_link, observe_drive
from polemap.build.merge import cluster, measure_reference, revisit_pairs
from polemap.build.slam.route import Route, as_reference
from polemap.build.slam.tables import Sightings, detections_at_keyframes, gather, pose_starts
from polemap.build.traversals import TraversalLandmarks
from polemap.drivelog.detections import Detections
from polemap.drivelog.frames import EarthFrame
from polemap.vehicle.pose import inverse_transform_points, rotate_covariance

Floats = NDArray[np.float64]
Whole = NDArray[np.int64]

_SEEN_MIN = 3  # detections that make a landmark; fewer are mostly false
_POSE_SD_M = 0.1  # of a pass against its neighbours, while the graph is being solved


@dataclass(frozen=True, slots=True)
class Seen:
    """The detections of all drives as landmarks of single passes.

    Attributes:
        sightings: of them at the keyframes.
        landmarks: `(m,)` rows, all drives one after the other.
        cannot_link: `(k, 2)` landmarks that were seen side by side.
        detections: how many there were.
    """

    sightings: Sightings
    landmarks: TraversalLandmarks
    cannot_link: Whole
    detections: int


def see(
    routes: Sequence[Route],
    scans: Sequence[Sequence[Detections]],
    mapping: MappingConfig,
    frame: EarthFrame,
) -> Seen:
    """Associate the detections of every drive by itself, at its route's poses.

    Drives without a scan within their odometry have no part in it.
    """
    observed = [
        _observe(route, list(part), mapping, frame)
        for route, part in zip(routes, scans, strict=True)
    ]
    poses, landmarks, points, covariances = [], [], [], []
    kept, links, lengths, start = [], [], [], 0
    for route, first, part in zip(routes, pose_starts(routes), observed, strict=False):
        if part is None:
            continue
        solid = part.landmarks.observations >= _SEEN_MIN
        number = np.cumsum(solid) - 1
        views = part.detections.views
        pose = views.poses[part.detections.scan]
        mine = solid[part.rows]
        keyframe, point, covariance = detections_at_keyframes(
            route,
            part.detections.stamp_s[mine],
            inverse_transform_points(pose[mine], part.detections.points_m[mine]),
            rotate_covariance(part.detections.covariance_m2[mine], -pose[mine, 2]),
        )
        poses.append(keyframe + first)
        landmarks.append(number[part.rows[mine]] + start)
        points.append(point)
        covariances.append(covariance)
        kept.append(part.landmarks.take(solid))
        pair = part.cannot_link[solid[part.cannot_link].all(axis=1)]
        links.append(number[pair].reshape(-1, 2).astype(np.int64))
        lengths.append(int(np.count_nonzero(solid)))
        start += lengths[-1]
    if not kept:
        none = np.empty(0, dtype=np.int64)
        empty = gather(none, none, np.empty((0, 2)), np.empty((0, 2, 2)), np.empty((0, 2)))
        return Seen(empty, _no_landmarks(), np.empty((0, 2), dtype=np.int64), 0)
    joined = TraversalLandmarks.concatenate(kept)
    sightings = gather(
        np.concatenate(poses),
        np.concatenate(landmarks),
        np.concatenate(points),
        np.concatenate(covariances),
        np.array(joined.points_m),
    )
    count = sum(len(part.rows) for part in observed if part is not None)
    return Seen(sightings, joined, join_cannot_link(links, lengths), count)


def _observe(
    route: Route, scans: list[Detections], mapping: MappingConfig, frame: EarthFrame
) -> DriveObservations | None:
    inside = [
        scan for scan in scans if route.stamp_s[0] - 0.5 <= scan.stamp_s <= route.stamp_s[-1] + 0.5
    ]
    if not inside:
        return None
    stamps = np.array([scan.stamp_s for scan in inside])
    reference = as_reference(route, stamps, np.zeros(2), np.full(len(route), _POSE_SD_M))
    return observe_drive(route.name, frame, inside, reference, mapping, frame)


def _no_landmarks() -> TraversalLandmarks:
    none = np.empty(0)
    whole = np.empty(0, dtype=np.int64)
    two = np.empty((0, 2))
    return TraversalLandmarks(
        drive=np.empty(0, dtype=np.str_), start_s=none, kind=np.empty(0, dtype=np.int8),
        points_m=two, covariance_m2=np.empty((0, 2, 2)), reference_sd_m=none, gain_m_per_px=two,
        aligned_sd_m=none, lever_m=none, direction_rad=none, width_m=none, width_sd_m=none,
        height_m=none, height_sd_m=none, observations=whole, first_s=none, last_s=none,
        directions=whole, range_min_m=none, range_max_m=none,
    )  # fmt: skip


def poles(seen: Seen, mapping: MappingConfig) -> tuple[Floats, Whole]:
    """Poles of more than one pass: where they stand `(q, 2)`, and links `(k, 2)` to them.

    A link leads from a landmark to a pole, numbered after all landmarks.
    """
    landmarks = seen.landmarks
    error = measure_reference(
        landmarks, mapping, revisit_pairs(landmarks, mapping, seen.cannot_link)
    )
    owner = cluster(landmarks, mapping, seen.cannot_link, error)
    count = np.bincount(owner)
    many = count >= 2
    number = np.cumsum(many) - 1
    rows = np.flatnonzero(many[owner]) if len(owner) else np.empty(0, dtype=np.int64)
    pole = number[owner[rows]]
    total = np.maximum(np.bincount(pole), 1)
    points = np.column_stack(
        [np.bincount(pole, landmarks.points_m[rows, axis]) / total for axis in (0, 1)]
    )
    return points, np.column_stack([rows, pole + len(landmarks)]).astype(np.int64)
