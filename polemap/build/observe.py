"""One drive as the merging sees it; what a worker computes and a checkpoint holds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from polemap.build.align import Shift, moved_landmarks, moved_sightings
from polemap.build.config import MappingConfig
from polemap.build.drift import Drift, middle_s
from polemap.build.passes import PassLandmarks, associate, average_passes, together
from polemap.build.sightings import Sightings, collect_sightings
from polemap.drivelog.frames import EarthFrame
from polemap.drivelog.samples import PoleScan
from polemap.drivelog.streams import ReferenceStream

Whole = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class DriveObservations:
    """Sightings of a drive, its pass landmarks, and how they belong together.

    Attributes:
        rows: `(len(sightings),)` pass landmark of each sighting.
        apart: `(k, 2)` pairs of pass landmarks that were seen side by side.
    """

    sightings: Sightings
    landmarks: PassLandmarks
    rows: Whole
    apart: Whole

    @property
    def order(self) -> tuple[float, str]:
        """Drives are told apart and put in order by this, never by how they were given."""
        return (self.sightings.start_s, self.sightings.drive)

    def moved(self, shift: Shift) -> DriveObservations:
        """The same drive after a correction of its reference."""
        return replace(
            self,
            sightings=moved_sightings(self.sightings, shift),
            landmarks=moved_landmarks(self.landmarks, shift),
        )

    def levelled(self, drift: Drift) -> DriveObservations:
        """The same drive after a correction that changes along it."""
        looks, landmarks = self.sightings.looks, self.landmarks
        move = drift.at(looks.stamp_s)
        poses = looks.poses + np.column_stack([move, np.zeros(len(move))])
        time = middle_s(landmarks)
        return replace(
            self,
            sightings=replace(
                self.sightings,
                looks=replace(looks, poses=poses),
                points_m=self.sightings.points_m + move[self.sightings.look],
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
    scans: Sequence[PoleScan],
    reference: ReferenceStream,
    config: MappingConfig,
    frame: EarthFrame,
    focal_baseline_px_m: float | None = None,
) -> DriveObservations:
    """Sightings and pass landmarks of one drive in the map's frame.

    `focal_baseline_px_m` is the stereo camera's, where one saw the poles: its disparity errs alike
    in all looks of a pass, which no scatter shows.

    Raises:
        InputError: no scan has a reference pose.
        FrameError: no transformation leads from the drive's frame to the map's.
    """
    sightings = collect_sightings(
        name, drive_frame, scans, reference, config, frame, focal_baseline_px_m
    )
    numbers = associate(sightings, config)
    landmarks, rows = average_passes(sightings, numbers)
    return DriveObservations(
        sightings, landmarks, rows, together(rows, sightings.look, len(landmarks))
    )


def join_landmarks(parts: Sequence[PassLandmarks]) -> PassLandmarks:
    """The landmarks of several drives, one after the other."""
    return PassLandmarks(
        **{
            field.name: np.concatenate([getattr(part, field.name) for part in parts])
            for field in fields(PassLandmarks)
        }
    )


def take_landmarks(landmarks: PassLandmarks, rows: Whole | NDArray[np.bool_]) -> PassLandmarks:
    """Some rows of the landmarks."""
    return PassLandmarks(
        **{field.name: getattr(landmarks, field.name)[rows] for field in fields(PassLandmarks)}
    )


def join_apart(parts: Sequence[Whole], lengths: Sequence[int]) -> Whole:
    """Pairs of several drives, renumbered for the joined landmarks."""
    starts = np.concatenate([[0], np.cumsum(lengths)[:-1]]).astype(np.int64)
    return np.concatenate([part + start for part, start in zip(parts, starts, strict=True)])
