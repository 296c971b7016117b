"""What the tracker holds: tracks, and the motion of the vehicle between two moments."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.columns import Columns
from polemap.drivelog.detections import Detections
from polemap.drivelog.landmark_kind import LandmarkKind

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


def _none() -> Floats:
    return np.empty(0)


@dataclass(frozen=True, slots=True)
class Tracks(Columns):
    """All tracks at one moment, vehicle frame; one a row.

    Attributes:
        ids: `(n,)`, never used twice.
        kind: `(n,)` a `LandmarkKind`; a track takes detections of its own kind only.
        points_vehicle_m, covariance_m2: `(n, 2)`, `(n, 2, 2)`.
        width_m, width_var_m2: `(n,)`.
        height_m: `(n,)` running mean of the visible height, NaN where unknown.
        log_odds: `(n,)` of existence.
        hits: `(n,)` frames that saw it.
        born_s, seen_s: first and last stamp at which it was seen.
        confirmed: `(n,)`.
        detection: `(n,)` row of the detection that it took in the last update, -1 if none.
        shift_per_px_m: `(n, 2)` how the point moves when all disparities grow by one pixel.
        facing_rad: `(n,)` into the free side of a corner, NaN of other kinds.
    """

    ids: Ints = field(default_factory=lambda: np.empty(0, dtype=np.int64))
    kind: NDArray[np.int8] = field(default_factory=lambda: np.empty(0, dtype=np.int8))
    points_vehicle_m: Floats = field(default_factory=lambda: np.empty((0, 2)))
    covariance_m2: Floats = field(default_factory=lambda: np.empty((0, 2, 2)))
    width_m: Floats = field(default_factory=_none)
    width_var_m2: Floats = field(default_factory=_none)
    height_m: Floats = field(default_factory=_none)
    log_odds: Floats = field(default_factory=_none)
    hits: Ints = field(default_factory=lambda: np.empty(0, dtype=np.int64))
    born_s: Floats = field(default_factory=_none)
    seen_s: Floats = field(default_factory=_none)
    confirmed: NDArray[np.bool_] = field(default_factory=lambda: np.empty(0, dtype=bool))
    detection: Ints = field(default_factory=lambda: np.empty(0, dtype=np.int64))
    shift_per_px_m: Floats = field(default_factory=lambda: np.empty((0, 2)))
    facing_rad: Floats = field(default_factory=_none)

    @property
    def existence(self) -> Floats:
        """`(n,)` probability that it is a pole."""
        return np.asarray(1.0 / (1.0 + np.exp(-self.log_odds)))

    def with_shared(self, variance: float) -> Tracks:
        """The same tracks, their covariance widened by what the shared error may be."""
        shared = self.shift_per_px_m[:, :, None] * self.shift_per_px_m[:, None, :]
        return self.with_columns(covariance_m2=self.covariance_m2 + variance * shared)


@dataclass(frozen=True, slots=True)
class Motion:
    """How the vehicle moved between two stamps: the later pose in the earlier one's frame."""

    dt_s: float
    forward_m: float
    left_m: float
    turn_rad: float
    distance_m: float


def detections_of_tracks(tracks: Tracks, detections: Detections, shared_sd_px: float) -> Detections:
    """This moment's detections that the tracks took, with the tracks' identity, size and existence.

    Args:
        tracks: after their correction with the detections.
        detections: of this moment.
        shared_sd_px: standard deviation of the disparity error that all of them share.
    """
    taken = tracks.take(tracks.detection >= 0)
    measured = detections.take(taken.detection)
    shared = measured.shift_per_px_m
    return _as_detections(
        taken,
        detections,
        measured.points_vehicle_m,
        measured.covariance_m2 + shared_sd_px**2 * (shared[:, :, None] * shared[:, None, :]),
    )


def tracks_in_view(tracks: Tracks, detections: Detections) -> Detections:
    """The tracks that were detected at this moment or stand in view, as detections."""
    shown = tracks.detection >= 0
    if detections.view is not None:
        # a track that was just not detected is still known, but only what is in view is a scan
        shown |= detections.view.contains(tracks.points_vehicle_m)
    shown_tracks = tracks.take(shown)
    return _as_detections(
        shown_tracks, detections, shown_tracks.points_vehicle_m, shown_tracks.covariance_m2
    )


def _as_detections(
    tracks: Tracks, moment: Detections, points_vehicle_m: Floats, covariance_m2: Floats
) -> Detections:
    return Detections(
        stamp_s=moment.stamp_s,
        arrival_s=moment.arrival_s,
        view=moment.view,
        kind=tracks.kind,
        points_vehicle_m=points_vehicle_m,
        covariance_m2=covariance_m2,
        # an edge has none, whatever its track began with
        width_m=np.where(tracks.kind == LandmarkKind.CORNER, np.nan, tracks.width_m),
        height_m=tracks.height_m,
        probability=tracks.existence,
        track_id=tracks.ids,
        shift_per_px_m=np.zeros((len(tracks), 2)),
        facing_rad=tracks.facing_rad,
        parts=np.ones(len(tracks), dtype=np.int64),
        lines=moment.lines,
    )
