"""The stakes round a sapling as one landmark of a drive."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from polemap.build.georeference import MapDetections
from polemap.build.traversals import TraversalLandmarks
from polemap.drivelog.landmark_kind import LandmarkKind
from polemap.drivelog.stake_groups import DIAMETER_MAX_M, diameter_m, stake_groups

Whole = NDArray[np.int64]

_OBSERVATIONS_MIN = 3  # of a stake
_INSIDE_SHARE = 0.75  # of a group's diameter: what stands so near to its middle is a part of it


def join_stakes(
    detections: MapDetections, landmarks: TraversalLandmarks, rows: Whole
) -> tuple[MapDetections, Whole] | None:
    """Detections of stakes moved to the middle of their group, one a scan; None without a group.

    Scans may bring groups (`parts` above 1): stakes that were seen alone before join these.

    Args:
        detections: of one drive.
        landmarks: its traversal landmarks.
        rows: `(len(detections),)` landmark of each detection.

    Returns:
        The detections, and the number of the landmark of each.
    """
    parts = np.ones(len(landmarks), dtype=np.int64)
    np.maximum.at(parts, rows, detections.parts)
    pole = landmarks.kind == LandmarkKind.POLE
    # two landmarks are two things where their traversals overlap: others are the same, seen again
    overlap = (landmarks.first_s[:, None] <= landmarks.last_s) & (
        landmarks.last_s[:, None] >= landmarks.first_s
    )
    single = pole & (parts == 1)
    steady = single & (landmarks.observations >= _OBSERVATIONS_MIN)
    width = np.where(steady, landmarks.width_m, np.nan)
    label = stake_groups(landmarks.points_m, width, landmarks.height_m, overlap)
    points, number = detections.points_m.copy(), rows.copy()
    sizes, count = detections.width_m.copy(), detections.parts.copy()
    groups = [np.flatnonzero(label == group) for group in range(label.max(initial=-1) + 1)]
    for whole in np.flatnonzero(pole & (parts > 1)).tolist():
        reach = _INSIDE_SHARE * min(float(landmarks.width_m[whole]), DIAMETER_MAX_M)
        gap = np.hypot(*(landmarks.points_m - landmarks.points_m[whole]).T)
        inside = np.flatnonzero(single & overlap[whole] & (gap <= reach) & (label < 0))
        groups.append(np.concatenate([[whole], inside]))
    joined = np.zeros(len(landmarks), dtype=bool)
    for members in groups:
        if len(members) < 2:
            continue
        given = parts[members[0]] > 1
        middle = landmarks.points_m[members[0] if given else members].reshape(-1, 2).mean(axis=0)
        wide = (
            float(landmarks.width_m[members[0]])
            if given
            else diameter_m(landmarks.points_m[members], landmarks.width_m[members])
        )
        mine = np.isin(rows, members)
        points[mine] += (middle - landmarks.points_m)[rows[mine]]
        number[mine], sizes[mine] = members[0], wide
        count[mine] = parts[members[0]] if given else len(members)
        joined[members] = True
    if not joined.any():
        return None
    moved = detections.with_columns(points_m=points, width_m=sizes, parts=count)
    # of a scan's stakes one stays: they share the camera's error, and a group is seen once
    _, first = np.unique(np.stack([moved.scan, number]), axis=1, return_index=True)
    again = np.setdiff1d(np.flatnonzero(joined[number]), first)
    keep = np.setdiff1d(np.arange(len(moved)), again)
    return moved.take(keep), number[keep]
