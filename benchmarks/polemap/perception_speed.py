"""Processor time of detection and tracking of a frame, by stage, after the disparity; one thread.

    python -m benchmarks polemap.perception_speed

Frames: two simulated streets of 768x480 (two seeds each) and KITTI odometry 03 (1242x375, a quarter
more pixels), or the drive that the environment variable POLEMAP_BENCH_DRIVE names in its place.
`whole` holds all stages and what lies between; its 95th percentile is that of the frames with most
to look at, `hypotheses` the most in a frame (doubles dropped). The best of a frame's rounds counts,
so that other work of the machine does not.
"""

from __future__ import annotations

import os
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import cv2
import numpy as np

import polemap.detect.detection as detection
from benchmarks.harness import RECORDINGS, compared
from benchmarks.simulate.streets import open_street
from polemap.config import PolemapConfig
from polemap.drivelog.detections import Detections
from polemap.drivelog.readers.registry import open_drive
from polemap.drivelog.samples import OdometrySample, StereoFrame
from polemap.perception import PolePerception, samples_in_order
from polemap.stereo.config import StereoConfig
from polemap.stereo.matching import make_matcher
from polemap.stereo.rig import StereoRig

Samples = list[OdometrySample | StereoFrame | Detections]

_STAGES = (
    "upright_maps", "fit_ground", "depth_edges", "find_slices", "find_hypotheses",
    "measure_features",
    "refine_disparity", "visible_region", "_locate", "_suppress",
)  # fmt: skip
KITTI = RECORDINGS / "kitti_odometry" / "sequences" / "03"
_WORLDS = ("suburb", "avenue")
_SEEDS = (511, 512)
_BEGIN_S = 6.0  # the car has set off by then
_RATE_HZ = 10.0
_FRAMES = 24
_ROUNDS = 7


def run() -> dict[str, dict[str, float]]:
    """Median and 95th percentile of every stage over the frames, and its share of the whole."""
    cv2.setNumThreads(1)
    figures: dict[str, dict[str, float]] = {}
    for world in _WORLDS:
        frames = _FRAMES // len(_SEEDS)
        figures |= _profile(world, [simulated(world, seed, frames) for seed in _SEEDS])
    path = Path(os.environ.get("POLEMAP_BENCH_DRIVE", str(KITTI)))
    if path.exists():
        figures |= _profile(f"kitti_{path.name}", [recorded(path)])
    return figures


def recorded(path: Path) -> tuple[StereoRig, Samples]:
    drive = open_drive(path)
    stamps = drive.frame_stamps_s
    part = drive.between(stamps[0], stamps[min(_FRAMES, len(stamps) - 1)])
    if drive.rig is None:
        raise SystemExit(f"{path}: a drive without a camera")
    return drive.rig, list(samples_in_order(part))


def simulated(world_name: str, seed: int, frames: int) -> tuple[StereoRig, Samples]:
    street = open_street(world_name, seed, _RATE_HZ)
    odometry, studio = street.odometry, street.studio
    first = int(np.searchsorted(street.plan.frame_stamps_s, _BEGIN_S))
    stamps = street.plan.frame_stamps_s[first : first + frames]
    samples: Samples = [
        odometry.sample(row) for row in np.flatnonzero(odometry.stamp_s <= stamps[-1]).tolist()
    ]
    for number, stamp in enumerate(stamps.tolist(), first):
        shot = studio.shot(number)
        samples.append(StereoFrame(stamp, stamp, number, shot.left.copy(), shot.right.copy()))
    return studio.renderer.rig, sorted(samples, key=lambda sample: sample.stamp_s)


def _profile(name: str, parts: list[tuple[StereoRig, Samples]]) -> dict[str, dict[str, float]]:
    best: dict[str, list[float]] = defaultdict(list)
    hypotheses: list[int] = []
    for rig, samples in parts:
        matcher = make_matcher(StereoConfig(), rig)
        frames = [sample for sample in samples if isinstance(sample, StereoFrame)]
        maps = {frame.index: matcher.match(frame.left, frame.right) for frame in frames}
        rounds: dict[str, list[list[float]]] = defaultdict(list)
        for _ in range(_ROUNDS):
            for stage, seconds in _stage_times(rig, samples, maps, hypotheses).items():
                rounds[stage].append(seconds)
        for stage, table in rounds.items():
            best[stage] += np.min(table, axis=0).tolist()
    figures = {
        f"perception_{name}_{stage.lstrip('_')}": row
        for stage, row in compared(best, "whole").items()
    }
    figures[f"perception_{name}_whole"]["hypotheses"] = float(np.max(hypotheses))
    return figures


def _stage_times(
    rig: StereoRig, samples: Samples, maps: dict[int, Any], hypotheses: list[int]
) -> dict[str, list[float]]:
    """Seconds of every frame by stage."""
    spent: dict[str, list[float]] = {stage: [] for stage in (*_STAGES, "track", "whole")}
    perception = PolePerception(rig, PolemapConfig())
    perception._track = _timed(perception._track, spent["track"])  # type: ignore[method-assign]
    for sample in samples:
        if isinstance(sample, OdometrySample):
            perception.record_odometry(sample)
        elif isinstance(sample, StereoFrame):
            with _stages_timed(spent):
                begin = time.process_time()
                view = perception.perceive(sample, maps[sample.index]).view
                spent["whole"].append(time.process_time() - begin)
            hypotheses.append(len(view.detections))
    return spent


@contextmanager
def _stages_timed(spent: dict[str, list[float]]) -> Iterator[None]:
    plain = {stage: getattr(detection, stage) for stage in _STAGES}
    try:
        for stage, function in plain.items():
            setattr(detection, stage, _timed(function, spent[stage]))
        yield
    finally:
        for stage, function in plain.items():
            setattr(detection, stage, function)


def _timed(function: Callable[..., Any], seconds: list[float]) -> Callable[..., Any]:
    def call(*args: Any, **kwargs: Any) -> Any:
        begin = time.process_time()
        result = function(*args, **kwargs)
        seconds.append(time.process_time() - begin)
        return result

    return call
