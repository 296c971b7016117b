"""One drive as the merging sees it; what a worker computes and a checkpoint holds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from polemap.build.config import MappingConfig
from polemap.build.drift import Drift, middle_s
from polemap.build.georeference import MapDetections, georeference_scans
from polemap.build.lines.seen_lines import SeenLines, seen_lines
from polemap.build.registration import Shift, moved_detections, moved_landmarks
from polemap.build.stakes import join_stakes
from polemap.build.traversals import (
    TraversalLandmarks,
    associate,
    average_traversals,
    cannot_link_pairs,
)
from polemap.drivelog.detections import Detections
from polemap.drivelog.frames import EarthFrame
from polemap.drivelog.streams import ReferenceStream

Whole = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class DriveObservations:
    """Detections of a drive, its traversal landmarks, and how they belong together.

    Attributes:
        rows: `(len(detections),)` traversal landmark of each detection.
        cannot_link: `(k, 2)` pairs of traversal landmarks that were seen side by side.
        lines: pieces of lines, None of a detector that looks for none.
    """

    detections: MapDetections
    landmarks: TraversalLandmarks
    rows: Whole
    cannot_link: Whole
    lines: SeenLines | None = None

    @property
    def order(self) -> tuple[float, str]:
        """Drives are told apart and put in order by this, never by how they were given."""
        return (self.detections.start_s, self.detections.drive)

    def moved(self, shift: Shift) -> DriveObservations:
        """The same drive after a correction of its reference."""
        return replace(
            self,
            detections=moved_detections(self.detections, shift),
            landmarks=moved_landmarks(self.landmarks, shift),
        )

    def without_drift(self, drift: Drift) -> DriveObservations:
        """The same drive after a correction that changes along it."""
        views, landmarks = self.detections.views, self.landmarks
        move = drift.at(views.stamp_s)
        poses = views.poses + np.column_stack([move, np.zeros(len(move))])
        time = middle_s(landmarks)
        return replace(
            self,
            detections=replace(
                self.detections,
                views=replace(views, poses=poses),
                points_m=self.detections.points_m + move[self.detections.scan],
            ),
            landmarks=replace(
                landmarks,
                points_m=landmarks.points_m + drift.at(time),
                aligned_sd_m=drift.sd_at(time),
            ),
        )


def observe_drive(
    name: str,
    drive_frame: EarthFrame,
    scans: Sequence[Detections],
    reference: ReferenceStream,
    config: MappingConfig,
    frame: EarthFrame,
    focal_baseline_px_m: float | None = None,
) -> DriveObservations:
    """MapDetections and traversal landmarks of one drive in the map's frame.

    `focal_baseline_px_m` is the stereo camera's, where one saw the poles: its disparity errs alike
    in all scans of a traversal, which no scatter shows.

    Raises:
        InputError: no scan has a reference pose.
        FrameError: no transformation leads from the drive's frame to the map's.
    """
    detections = georeference_scans(
        name, drive_frame, scans, reference, config, frame, focal_baseline_px_m
    )
    numbers = associate(detections, config)
    landmarks, rows = average_traversals(detections, numbers)
    joined = join_stakes(detections, landmarks, rows) if config.group_stakes else None
    if joined is not None:
        detections = joined[0]
        landmarks, rows = average_traversals(*joined)
    lines = seen_lines(
        scans, detections.views, reference, config.reference_sd_m, config.reference_yaw_sd_rad
    )
    links = cannot_link_pairs(rows, detections.scan, len(landmarks))
    return DriveObservations(detections, landmarks, rows, links, lines)


def join_cannot_link(parts: Sequence[Whole], lengths: Sequence[int]) -> Whole:
    """Pairs of several drives, renumbered for the joined landmarks."""
    starts = np.concatenate([[0], np.cumsum(lengths)[:-1]]).astype(np.int64)
    return np.concatenate([part + start for part, start in zip(parts, starts, strict=True)])
