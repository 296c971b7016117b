"""Perception on one screen: frame -> disparity -> detections of this frame -> tracks -> scan."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from polemap.config import PolemapConfig
from polemap.detect.classifier import PoleClassifier
from polemap.detect.detection import FrameView, detect
from polemap.detect.models.io import read_classifier, read_corner_classifier
from polemap.drivelog.detections import Detections
from polemap.drivelog.drive import Drive
from polemap.drivelog.errors import InputError
from polemap.drivelog.landmark_kind import LandmarkKind
from polemap.drivelog.merge import SampleRows, merge_streams
from polemap.drivelog.odometry_window import OdometryWindow
from polemap.drivelog.samples import OdometrySample, StereoFrame
from polemap.matching_ahead import MatchedFrame, match_ahead
from polemap.stereo.config import StereoConfig
from polemap.stereo.matching import DisparityPair, StereoMatcher, make_matcher
from polemap.stereo.rig import StereoRig
from polemap.track.disparity_offset import DisparityOffset
from polemap.track.frame_motion import KEEP_S, motion_between
from polemap.track.stakes import group_stakes
from polemap.track.tracking import PoleTracker
from polemap.track.tracks import Tracks, detections_of_tracks, tracks_in_view

_Table = TypeVar("_Table", bound=Detections)


@dataclass(frozen=True, slots=True)
class PerceivedFrame:
    """Everything that one frame led to, for pictures and tables."""

    frame: StereoFrame
    disparity: DisparityPair
    view: FrameView
    tracks: Tracks
    scan: Detections


class PolePerception:
    """Turns stereo frames, or poles that were detected elsewhere, into scans of tracked poles.

    Args:
        rig: the camera; None for a drive without images.
        config: settings of this room.
        stereo: settings of the default matcher.
        matcher: takes the place of the default matcher.
        classifier: takes the place of the one that the settings name.
    """

    def __init__(
        self,
        rig: StereoRig | None,
        config: PolemapConfig,
        *,
        stereo: StereoConfig | None = None,
        matcher: StereoMatcher | None = None,
        classifier: PoleClassifier | None = None,
    ) -> None:
        self._rig, self._config = rig, config
        self._stereo, self._matcher, self._classifier = (
            stereo or StereoConfig(),
            matcher,
            classifier,
        )
        self._corners: PoleClassifier | None = None
        self._tracker = PoleTracker(config.tracking)
        self._offset = DisparityOffset(rig, config.tracking) if rig is not None else None
        self._odometry = OdometryWindow(KEEP_S)
        self._stamp_s: float | None = None

    def record_odometry(self, sample: OdometrySample) -> None:
        """Take a sample of speed and yaw rate; one with a value that is not finite is left out."""
        self._odometry.insert(sample)
        self._odometry.forget()

    def match(self, frame: StereoFrame) -> DisparityPair:
        """Disparities of a stereo frame, as `perceive` makes them.

        Raises:
            InputError: there is no camera.
            StereoError: images that do not fit the camera.
        """
        if self._rig is None:
            raise InputError("perception: a stereo frame came, but the drive has no camera")
        self._matcher = self._matcher or make_matcher(self._stereo, self._rig)
        return self._matcher.match(frame.left, frame.right)

    def matched(self, frame: StereoFrame) -> MatchedFrame:
        """A stereo frame with its disparity; may run beside `perceive` of the frame before.

        Raises:
            InputError, StereoError: as of `match`.
        """
        return MatchedFrame(
            frame.stamp_s, frame.arrival_s, frame.index, frame.left, frame.right, self.match(frame)
        )

    def scan_frame(self, frame: StereoFrame) -> Detections:
        """The tracked poles of a stereo frame; see `perceive`."""
        return self.perceive(frame).scan

    def perceive(
        self, frame: StereoFrame, disparity: DisparityPair | None = None
    ) -> PerceivedFrame:
        """The poles of a stereo frame with all that led to them, and its lines.

        Args:
            frame: the pictures; a `MatchedFrame` brings its disparity.
            disparity: their disparity maps, where these are there already.

        Raises:
            InputError: there is no camera, or the classifier cannot be read.
            StereoError: images that do not fit the camera.
        """
        if self._rig is None:
            raise InputError("perception: a stereo frame came, but the drive has no camera")
        if disparity is None:
            disparity = frame.disparity if isinstance(frame, MatchedFrame) else self.match(frame)
        config = self._config.detection
        self._classifier = self._classifier or read_classifier(config.model)
        if LandmarkKind.CORNER in config.landmark_kinds:
            self._corners = self._corners or read_corner_classifier(config.corner_model)
        view = detect(frame, disparity, self._rig, self._classifier, config, self._corners)
        corrected, scan = self._track_stereo(view.landmarks)
        lines = view.lines
        if lines is not None and self._offset is not None:
            lines = self._offset.corrected_lines(lines)
            scan = replace(scan, lines=lines)
        seen = replace(view.located(corrected), lines=lines)
        return PerceivedFrame(frame, disparity, seen, self._tracks(), scan)

    def track_scan(self, scan: Detections, *, raw_stereo: bool = False) -> Detections:
        """Track poles that were detected elsewhere; they come back with ids and existence.

        Args:
            raw_stereo: they are this camera's detections as `detect` gives them, so they share an
                error of the disparities, which is learned and corrected as in `perceive`.
        """
        return self._track_stereo(scan)[1] if raw_stereo else self._track(scan)

    def _track_stereo(self, raw: _Table) -> tuple[_Table, Detections]:
        """Track with what is known of the disparities' error, and learn more of it."""
        offset = self._offset
        if offset is None:
            return raw, self._track(raw)
        elapsed_s = raw.stamp_s - self._stamp_s if self._stamp_s is not None else np.inf
        points = offset.corrected(raw.points_vehicle_m)
        corrected = raw.with_columns(
            points_vehicle_m=points, shift_per_px_m=offset.shift_per_px(points)
        )
        before = offset.value_px
        scan = self._track(corrected)
        offset.learn_from_tracks(corrected, self._tracker.tracks, elapsed_s)
        self._tracker.shift_tracks(offset.value_px - before)
        return corrected, scan

    def _track(self, detections: Detections) -> Detections:
        """Move the tracks with the odometry, correct them, and say what is known now."""
        last_s, self._stamp_s = self._stamp_s, detections.stamp_s
        motion = None if last_s is None else motion_between(self._odometry, last_s, self._stamp_s)
        if motion is not None:
            self._tracker.predict_tracks(motion)
            if self._offset is not None:
                self._offset.dead_reckon(motion)
        elif last_s is not None:  # a hole in the odometry, or a clock that went back
            self._tracker.drop_tracks()
            if self._offset is not None:
                self._offset.forget_tracks()
        self._tracker.correct_tracks(detections)
        tracks = self._tracks()
        tracks = tracks.take(tracks.confirmed)
        if self._config.tracking.output == "tracks":
            scan = tracks_in_view(tracks, detections)
        else:
            shared_sd_px = self._offset.sd_px if self._offset is not None else 0.0
            scan = detections_of_tracks(tracks, detections, shared_sd_px)
        return group_stakes(scan, tracks) if self._config.tracking.group_stakes else scan

    def _tracks(self) -> Tracks:
        """All tracks, with what the shared error adds to their covariance."""
        tracks = self._tracker.tracks
        return tracks if self._offset is None else tracks.with_shared(self._offset.sd_px**2)


def scan_drive(
    drive: Drive,
    config: PolemapConfig,
    progress: Callable[[int], None] | None = None,
    *,
    stereo: StereoConfig | None = None,
    raw_stereo: bool = False,
) -> list[Detections]:
    """The scans of a whole drive, from its images or from the poles that lie beside it.

    Args:
        drive: recording.
        config: settings of this room.
        progress: is called with 1 after every scan.
        stereo: settings of the matcher.
        raw_stereo: the drive's scans are its camera's own detections, not tracked yet.

    Raises:
        InputError: the drive has neither images nor detected poles, or one cannot be read.
    """
    if not drive.has_frames and not drive.scans:
        raise InputError(f"drive {drive.name}: it has neither images nor {drive.names.poles}")
    perception = PolePerception(drive.rig, config, stereo=stereo)
    scans = []
    samples = samples_in_order(drive)
    if drive.has_frames:
        samples = match_ahead(samples, perception.matched)
    for sample in samples:
        if isinstance(sample, OdometrySample):
            perception.record_odometry(sample)
            continue
        if isinstance(sample, StereoFrame):
            scans.append(perception.scan_frame(sample))
        else:
            scans.append(perception.track_scan(sample, raw_stereo=raw_stereo))
        if progress is not None:
            progress(1)
    return scans


def perceive_drive(drive: Drive, perception: PolePerception) -> Iterator[PerceivedFrame]:
    """All that a drive's frames show, one after the other."""
    for sample in match_ahead(samples_in_order(drive), perception.matched):
        if isinstance(sample, OdometrySample):
            perception.record_odometry(sample)
        elif isinstance(sample, StereoFrame):
            yield perception.perceive(sample)


def samples_in_order(drive: Drive) -> Iterator[OdometrySample | StereoFrame | Detections]:
    """Odometry and frames (or scans, where there are no frames) in the order of their stamps.

    A whole drive lies on disk, so nothing is late here.
    """
    streams: list[SampleRows[OdometrySample | StereoFrame | Detections]] = []
    # odometry of the same moment first: the motion up to a frame is known before the frame
    if drive.odometry is not None:
        stamps = drive.odometry.stamp_s
        streams.append(SampleRows(stamps, stamps, drive.odometry.sample))
    if drive.has_frames:
        stamps = drive.frame_stamps_s
        streams.append(SampleRows(stamps, stamps, drive.read_frame))
    else:
        stamps = np.array([scan.stamp_s for scan in drive.scans])
        streams.append(SampleRows(stamps, stamps, drive.scans.__getitem__))
    return merge_streams(streams)
