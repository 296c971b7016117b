"""The eye end to end: a rendered drive, a real one, and poles that were detected elsewhere."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from polemap.config import PolemapConfig
from polemap.detect.config import DetectionConfig
from polemap.detect.ground import ground_from_mounting
from polemap.drivelog.detections import Detections, pole_detections
from polemap.drivelog.drive import Drive
from polemap.drivelog.errors import FrameError, InputError
from polemap.drivelog.frames import EarthFrame
from polemap.drivelog.landmark_kind import LandmarkKind
from polemap.drivelog.readers.registry import open_drive
from polemap.drivelog.samples import OdometrySample, StereoFrame
from polemap.evaluation.detections import evidence, match, record, score_frames, score_tracks
from polemap.map.io import read_map
from polemap.map.pole_map import PoleMap
from polemap.perception import PolePerception, perceive_drive, scan_drive
from polemap.stereo.config import StereoConfig
from polemap.stereo.matching import DisparityPair, make_matcher
from polemap.track.config import TrackingConfig
from polemap.training import TrainingConfig, collect
from tests.polemap.detect.lines.scenes import RIG as LINE_RIG
from tests.polemap.detect.lines.scenes import Scene
from tests.polemap.street import RIG, Thing, street

STEREO = StereoConfig(disparities=96)
POLES = [Thing(14.0, 2.5, 0.2, 4.0), Thing(17.0, -3.0, 0.3, 4.0), Thing(21.0, 2.8, 0.25, 4.0)]


class Given:
    """A matcher that gives the exact maps of the street."""

    name = "given"

    def __init__(self, maps: list[DisparityPair]) -> None:
        self._maps = iter(maps)

    def match(self, left: object, right: object) -> DisparityPair:
        return next(self._maps)


def _approach(tracking: TrackingConfig, frames: int = 8) -> tuple[list[Detections], list[float]]:
    """Scans of an approach to `POLES` at 10 m/s and 10 Hz, and the distance driven at each."""
    rng = np.random.default_rng(11)
    driven = [1.0 * step for step in range(frames)]
    rendered = [street([replace(p, x_m=p.x_m - x) for p in POLES], rng, 0.1) for x in driven]
    perception = PolePerception(
        RIG, PolemapConfig(tracking=tracking), matcher=Given([r[2] for r in rendered])
    )
    scans = []
    for step, (left, right, _) in enumerate(rendered):
        perception.record_odometry(OdometrySample(0.1 * step, 0.1 * step, 10.0, 0.0))
        scans.append(
            perception.scan_frame(StereoFrame(0.1 * step, 0.1 * step + 0.08, step, left, right))
        )
    return scans, driven


@pytest.mark.parametrize("output", ["detections", "tracks"])
def test_scans_hold_the_poles_with_lasting_ids(output: str) -> None:
    scans, driven = _approach(TrackingConfig.model_validate({"output": output}))
    assert len(scans[0]) == 0  # nothing is confirmed by one look
    truth = np.array([(p.x_m, p.y_m) for p in POLES])
    ids: dict[int, set[int]] = {}
    for scan, x in zip(scans[3:], driven[3:], strict=True):
        one, two = match(truth - (x, 0.0), scan.points_vehicle_m, 0.6)
        u, _, d = RIG.project(np.column_stack([truth - (x, 0.0), np.zeros(len(truth))])).T
        near = np.flatnonzero((d > RIG.focal_px * RIG.baseline_m / 16.0) & (u > 60.0) & (u < 580.0))
        assert set(near) <= set(one)
        assert (scan.probability[two] > 0.8).all()
        for pole, row in zip(one, two, strict=True):
            ids.setdefault(int(pole), set()).add(int(scan.track_id[row]))
        assert scan.arrival_s == pytest.approx(scan.stamp_s + 0.08)
        assert scan.view is not None
        assert np.linalg.eigvalsh(scan.covariance_m2).min() > 0
    assert all(len(names) == 1 for names in ids.values())


def test_frames_without_a_camera_and_drives_without_eyes_are_refused() -> None:
    image = np.zeros((4, 4), dtype=np.uint8)
    with pytest.raises(InputError, match="the drive has no camera"):
        PolePerception(None, PolemapConfig()).scan_frame(StereoFrame(0.0, 0.0, 0, image, image))
    blind = Drive("blind", Path(), EarthFrame("local", name="x"), 2.7)
    with pytest.raises(InputError, match="neither images nor poles"):
        scan_drive(blind, PolemapConfig())


def test_poles_from_elsewhere_get_ids() -> None:
    perception = PolePerception(None, PolemapConfig())
    n = 2
    for step in range(4):
        perception.record_odometry(OdometrySample(0.1 * step, 0.1 * step, 5.0, 0.0))
        scan = pole_detections(
            0.1 * step,
            0.1 * step,
            np.array([[10.0 - 0.5 * step, 2.0], [12.0 - 0.5 * step, -2.0]]),
            np.tile(0.01 * np.eye(2), (n, 1, 1)),
        )
        tracked = perception.track_scan(scan)
    assert sorted(tracked.track_id.tolist()) == [0, 1]
    assert np.allclose(
        np.sort(tracked.points_vehicle_m, axis=0), np.sort(scan.points_vehicle_m, axis=0)
    )


def test_evidence_is_there_for_poles_that_show() -> None:
    hidden = Thing(20.0, -3.0, 0.3, 2.4)
    van = Thing(12.0, -1.9, 2.5, 2.6)
    plain = Thing(15.0, 2.0, 0.2, 3.0)
    _, _, maps = street([van, hidden, plain], np.random.default_rng(1), 0.1)
    places = np.array([(t.x_m, t.y_m) for t in (hidden, plain)] + [(15.0, 3.5), (-5.0, 0.0)])
    share = evidence(places, maps, ground_from_mounting(RIG), RIG)
    assert share[1] > 0.9
    assert share[[0, 2, 3]].max() < 0.2


def test_training_needs_one_frame_and_a_reference() -> None:
    frame = EarthFrame("local", name="a")
    pole_map = PoleMap.empty(EarthFrame("local", name="b"))
    drive = Drive("d", Path(), frame, 2.7)
    matcher = make_matcher(STEREO)
    with pytest.raises(FrameError, match="local frame 'b'"):
        collect(drive, pole_map, matcher, DetectionConfig(), TrainingConfig())
    same = replace(pole_map, frame=frame)
    with pytest.raises(InputError, match="needs images and a reference"):
        collect(drive, same, matcher, DetectionConfig(), TrainingConfig())


@pytest.mark.slow
def test_real_street_against_its_lidar_map(recording: Callable[[str], Path]) -> None:
    """Frames 22 to 38 of KITTI 03: trunks, a lamp, parked cars, hedges."""
    folder = recording("kitti_odometry")
    drive = open_drive(folder / "sequences" / "03")
    known = read_map(folder / "poles" / "03.csv", drive.frame)
    assert drive.rig is not None
    assert drive.reference is not None
    stamps = drive.frame_stamps_s
    part = drive.between(stamps[22], stamps[38])
    perception = PolePerception(drive.rig, PolemapConfig())
    records = []
    for seen in perceive_drive(part, perception):
        pose = drive.reference.at(np.array([seen.frame.stamp_s]))[0]
        records.append(record(seen, pose, known, drive.rig, DetectionConfig()))
    (frames,) = score_frames(records, known, [(5.0, 20.0)])
    figures = frames.figures()
    assert frames.shown > 15
    # far below what the whole drive shows: one short stretch
    assert figures["recall"] > 0.75
    assert figures["precision"] > 0.6
    assert figures["across_median_m"] < 0.4
    assert figures["along_median_m"] < 0.4
    tracks = score_tracks(records, known, (5.0, 20.0))
    assert tracks.found >= 2
    assert tracks.right >= 2


def test_lines_pass_with_the_scan() -> None:
    image, maps = Scene(light=lambda x, y: np.where(np.abs(y - 1.7) < 0.06, 170.0, 90.0)).take()
    # the maps of every third row, as a matcher would give all of them
    left = np.repeat(maps.left, 3, axis=0)[: LINE_RIG.height_px]
    disparity = DisparityPair(np.where(left > 0, left, np.nan), np.where(left > 0, left, np.nan))
    frame = StereoFrame(0.0, 0.0, 0, image, image)
    kinds = DetectionConfig(kinds=("pole", "lane_marking"))
    plain, more = (
        PolePerception(LINE_RIG, PolemapConfig(detection=detection)).perceive(frame, disparity)
        for detection in (DetectionConfig(), kinds)
    )
    assert plain.scan.lines is None
    lines = more.scan.lines
    assert lines is not None
    assert (lines.kind == LandmarkKind.LANE_MARKING).all()
    assert len(lines) > 0
    assert more.view.lines is lines
