"""The eye on one screen: frame -> disparity -> poles of this frame -> tracks -> scan."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from polemap.config import PolemapConfig
from polemap.detect.classifier import PoleClassifier
from polemap.detect.detection import FrameView, detect
from polemap.detect.models.io import read_classifier
from polemap.drivelog.drive import Drive
from polemap.drivelog.errors import InputError
from polemap.drivelog.merge import SampleRows, merge_streams
from polemap.drivelog.odometry_window import OdometryWindow
from polemap.drivelog.samples import OdometrySample, PoleScan, StereoFrame, VisibleRegion
from polemap.stereo.config import StereoConfig
from polemap.stereo.matching import DisparityPair, StereoMatcher, make_matcher
from polemap.stereo.rig import StereoRig
from polemap.track.disparity_offset import DisparityOffset
from polemap.track.frame_motion import KEEP_S, motion_between
from polemap.track.tracking import PoleTracker
from polemap.track.tracks import Sighting, Tracks


@dataclass(frozen=True, slots=True)
class PerceivedFrame:
    """Everything that one frame led to, for pictures and tables."""

    frame: StereoFrame
    disparity: DisparityPair
    view: FrameView
    tracks: Tracks
    scan: PoleScan


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
        self._tracker = PoleTracker(config.tracking)
        self._offset = DisparityOffset(rig, config.tracking) if rig is not None else None
        self._odometry = OdometryWindow(KEEP_S)
        self._stamp_s: float | None = None

    def record_odometry(self, sample: OdometrySample) -> None:
        """Take a sample of speed and yaw rate."""
        self._odometry.insert(sample)
        self._odometry.forget()

    def scan_frame(self, frame: StereoFrame) -> PoleScan:
        """The poles of a stereo frame; see `perceive`."""
        return self.perceive(frame).scan

    def track_scan(self, scan: PoleScan, *, raw_stereo: bool = False) -> PoleScan:
        """Track poles that were detected elsewhere; the scan comes back with ids and existence.

        Args:
            raw_stereo: they are this camera's detections as `detect` gives them, so they share an
                error of the disparities, which is learned and corrected as in `perceive_disparity`.
        """
        sighting = Sighting(
            scan.stamp_s,
            scan.points_vehicle_m,
            scan.covariance_m2,
            scan.width_m,
            np.full(len(scan), np.nan) if scan.height_m is None else scan.height_m,
            scan.existence,
            scan.view,
        )
        if raw_stereo and self._offset is not None:
            return self._track_stereo(sighting, scan.arrival_s, self._offset)[1]
        return self._track(sighting, scan.arrival_s)

    def perceive(self, frame: StereoFrame) -> PerceivedFrame:
        """The poles of a stereo frame with all that led to them.

        Raises:
            InputError: there is no camera, or the classifier cannot be read.
            StereoError: images that do not fit the camera.
        """
        if self._rig is None:
            raise InputError("perception: a stereo frame came, but the drive has no camera")
        if self._matcher is None:
            self._matcher = make_matcher(self._stereo, self._rig)
        if self._classifier is None:
            self._classifier = read_classifier(self._config.detection.model)
        disparity = self._matcher.match(frame.left, frame.right)
        return self.perceive_disparity(frame, disparity)

    def perceive_disparity(self, frame: StereoFrame, disparity: DisparityPair) -> PerceivedFrame:
        """`perceive` with disparity maps that are there already."""
        if self._rig is None or self._offset is None:
            raise InputError("perception: a stereo frame came, but the drive has no camera")
        if self._classifier is None:
            self._classifier = read_classifier(self._config.detection.model)
        view = detect(
            frame.left, frame.right, disparity, self._rig, self._classifier, self._config.detection
        )
        found = view.detections
        sighting = Sighting(
            frame.stamp_s,
            found.points_vehicle_m,
            found.covariance_m2,
            found.width_m,
            found.height_m,
            found.probability,
            view.region,
        )
        mended, scan = self._track_stereo(sighting, frame.arrival_s, self._offset)
        found = replace(found, points_vehicle_m=mended.points_vehicle_m)
        view = replace(view, detections=found)
        return PerceivedFrame(frame, disparity, view, self._tracks(), scan)

    def _track_stereo(
        self, raw: Sighting, arrival_s: float, offset: DisparityOffset
    ) -> tuple[Sighting, PoleScan]:
        """Track with what is known of the disparities' error, and learn more of it."""
        elapsed_s = raw.stamp_s - self._stamp_s if self._stamp_s is not None else np.inf
        points = offset.corrected(raw.points_vehicle_m)
        mended = replace(raw, points_vehicle_m=points, per_offset_m=offset.per_px(points))
        before = offset.value_px
        scan = self._track(mended, arrival_s)
        offset.learn(mended, self._tracker.tracks, elapsed_s)
        self._tracker.shift(offset.value_px - before)
        return mended, scan

    def _track(self, sighting: Sighting, arrival_s: float) -> PoleScan:
        """Predict to the sighting's stamp, update, and say what is known now."""
        tracker = self._tracker
        if self._stamp_s is not None:
            motion = motion_between(
                self._odometry,
                self._stamp_s,
                sighting.stamp_s,
                gap_max_s=self._config.tracking.gap_max_s,
            )
            if motion is None:  # a hole in the odometry, or a clock that went back
                tracker.clear()
                if self._offset is not None:
                    self._offset.clear()
            else:
                tracker.predict(motion)
                if self._offset is not None:
                    self._offset.move(motion)
        self._stamp_s = sighting.stamp_s
        tracker.update(sighting)
        tracks = self._tracks()
        tracks = tracks.take(tracks.confirmed)
        if self._config.tracking.output == "tracks":
            # a track that was just not seen is still known, but only what is in view is a scan
            shown = tracks.detection >= 0
            if sighting.view is not None:
                shown |= sighting.view.contains(tracks.points_vehicle_m)
            tracks = tracks.take(shown)
            return _scan(sighting, arrival_s, tracks)
        tracks = tracks.take(tracks.detection >= 0)
        rows = tracks.detection
        covariance = sighting.covariance_m2[rows]
        if sighting.per_offset_m is not None and self._offset is not None:
            shared = sighting.per_offset_m[rows]
            covariance = covariance + self._offset.sd_px**2 * (
                shared[:, :, None] * shared[:, None, :]
            )
        measured = replace(
            tracks, points_vehicle_m=sighting.points_vehicle_m[rows], covariance_m2=covariance
        )
        return _scan(sighting, arrival_s, measured)

    def _tracks(self) -> Tracks:
        """All tracks, with what the shared error adds to their covariance."""
        tracks = self._tracker.tracks
        return tracks if self._offset is None else tracks.with_shared(self._offset.sd_px**2)


def _scan(sighting: Sighting, arrival_s: float, tracks: Tracks) -> PoleScan:
    view: VisibleRegion | None = sighting.view
    return PoleScan(
        sighting.stamp_s,
        arrival_s,
        tracks.points_vehicle_m,
        tracks.covariance_m2,
        tracks.width_m,
        tracks.ids,
        tracks.existence,
        view,
        tracks.height_m,
    )


def scan_drive(
    drive: Drive,
    config: PolemapConfig,
    progress: Callable[[int], None] | None = None,
    *,
    stereo: StereoConfig | None = None,
    raw_stereo: bool = False,
) -> list[PoleScan]:
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
        raise InputError(f"drive {drive.name}: it has neither images nor poles.csv")
    perception = PolePerception(drive.rig, config, stereo=stereo)
    scans = []
    for sample in samples_in_order(drive):
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
    for sample in samples_in_order(drive):
        if isinstance(sample, OdometrySample):
            perception.record_odometry(sample)
        elif isinstance(sample, StereoFrame):
            yield perception.perceive(sample)


def samples_in_order(drive: Drive) -> Iterator[OdometrySample | StereoFrame | PoleScan]:
    """Odometry and frames (or scans, where there are no frames) in the order of their stamps.

    A whole drive lies on disk, so nothing is late here.
    """
    streams: list[SampleRows[OdometrySample | StereoFrame | PoleScan]] = []
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
