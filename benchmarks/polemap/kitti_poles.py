"""Poles of KITTI odometry 03 against its LiDAR map, every frame by a model that never saw it.

    python -m benchmarks.polemap.kitti_poles

Two models, each trained on one half of the drive, judge the other half; a third, trained on
simulated labels alone (`polemap/models/simulated.json`), judges all. Printed per band of range for
single frames, and for tracks. Not timed, so `python -m benchmarks` leaves it out.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from benchmarks.harness import RECORDINGS
from polemap.config import PolemapConfig
from polemap.detect.classifier import PoleClassifier
from polemap.detect.models.io import read_classifier
from polemap.drivelog.drive import Drive
from polemap.drivelog.readers.registry import open_drive
from polemap.evaluation.detections import FrameRecord, Score, record, score_frames, score_tracks
from polemap.map.io import read_map
from polemap.map.pole_map import PoleMap
from polemap.perception import PolePerception, perceive_drive
from polemap.stereo.config import StereoConfig
from polemap.stereo.matching import make_matcher
from polemap.training import Samples, TrainingConfig, collect, train

KITTI = RECORDINGS / "kitti_odometry"
UNMAPPED = Path(__file__).parent / "kitti_03_unmapped_poles.csv"
BANDS_M = [(5.0, 20.0), (5.0, 10.0), (10.0, 15.0), (15.0, 20.0)]


def records_of(drive: Drive, poles: PoleMap, model: PoleClassifier) -> list[FrameRecord]:
    """A record of every frame, as one model sees it."""
    assert drive.rig is not None
    assert drive.reference is not None
    config = PolemapConfig()
    eye = PolePerception(drive.rig, config, classifier=model)
    return [
        record(
            seen,
            drive.reference.at(np.array([seen.frame.stamp_s]))[0],
            poles,
            drive.rig,
            config.detection,
        )
        for seen in perceive_drive(drive, eye)
    ]


def half_models(samples: Samples) -> list[PoleClassifier]:
    """Model k is trained without part k."""
    return [train(samples.take(samples.group != part), TrainingConfig(), {}) for part in (0, 1)]


def main() -> None:
    """Print the tables."""
    drive = open_drive(KITTI / "sequences" / "03")
    poles = read_map(KITTI / "poles" / "03.csv", drive.frame)
    lacking = read_map(UNMAPPED, drive.frame).points_m
    assert drive.rig is not None
    matcher = make_matcher(StereoConfig(), drive.rig)
    settings = PolemapConfig().detection
    labels = collect(drive, poles, matcher, settings, TrainingConfig(), ignore_m=lacking, parts=2)
    middle = len(drive.frame_stamps_s) // 2
    first, second = (records_of(drive, poles, model) for model in half_models(labels))
    crossed = [*first[:middle], *second[middle:]]
    _frames("halves crossed", crossed, poles, lacking)
    # tracks do not go over from one model to the other
    for name, part in (("first half", first[:middle]), ("second half", second[middle:])):
        _print(f"{name}, tracks", score_tracks(part, poles, BANDS_M[0], lacking))
    simulated = records_of(drive, poles, read_classifier("simulated"))
    _frames("simulated labels only", simulated, poles, lacking)
    _print("simulated labels only, tracks", score_tracks(simulated, poles, BANDS_M[0], lacking))


def _frames(name: str, records: list[FrameRecord], poles: PoleMap, lacking: np.ndarray) -> None:
    for score in score_frames(records, poles, BANDS_M, lacking):
        _print(name, score)


def _print(name: str, score: Score) -> None:
    values = score.figures()
    low, high = values.pop("range_min_m"), values.pop("range_max_m")
    text = ", ".join(f"{key} {value:.3g}" for key, value in values.items())
    print(f"{name}, {low:.0f}-{high:.0f} m: {text}", flush=True)


if __name__ == "__main__":
    main()
