"""Time of detection and tracking of a frame, by stage, after the disparity; one thread.

The frames are those of KITTI odometry 03 (1242x375, a quarter more pixels than 768x480), or of the
drive that the environment variable POLEMAP_BENCH_DRIVE names.
"""

from __future__ import annotations

import os
import time
from collections import defaultdict
from pathlib import Path

import cv2
import numpy as np

import polemap.detection as detection
from drivelog.drive import Drive, open_drive
from drivelog.samples import OdometrySample, StereoFrame
from polemap.config import PolemapConfig
from polemap.perception import PolePerception, samples_to_see
from stereo.config import StereoConfig
from stereo.matching import make_matcher

_STAGES = (
    "upright_maps", "fit_ground", "depth_edges", "find_slices", "find_stems", "measure",
    "refine_disparity", "visible_region",
)  # fmt: skip
_KITTI = Path(__file__).resolve().parents[2] / "shared/data/kitti_odometry/sequences/03"
_FRAMES = 24
_ROUNDS = 7


def run() -> dict[str, dict[str, float]]:
    """Median and 95th percentile of every stage, and its share of the whole."""
    path = Path(os.environ.get("POLEMAP_BENCH_DRIVE", str(_KITTI)))
    if not path.exists():
        return {}
    cv2.setNumThreads(1)
    return _measure(open_drive(path))


def _measure(drive: Drive) -> dict[str, dict[str, float]]:
    matcher = make_matcher(StereoConfig(), drive.rig)
    stamps = drive.frame_stamps_s
    part = drive.between(stamps[0], stamps[min(_FRAMES, len(stamps) - 1)])
    samples = list(samples_to_see(part))
    maps = {s.index: matcher.match(s.left, s.right) for s in samples if isinstance(s, StereoFrame)}
    spent: dict[str, list[float]] = defaultdict(list)
    plain = {name: getattr(detection, name) for name in _STAGES}
    try:
        for name, function in plain.items():
            setattr(detection, name, _timed(name, function, spent))
        for _ in range(_ROUNDS):
            perception = PolePerception(drive.rig, PolemapConfig())
            for sample in samples:
                if isinstance(sample, OdometrySample):
                    perception.push_odometry(sample)
                elif isinstance(sample, StereoFrame):
                    begin = time.perf_counter()
                    perception.see(sample, maps[sample.index])
                    spent["whole"].append(time.perf_counter() - begin)
    finally:
        for name, function in plain.items():
            setattr(detection, name, function)
    whole = float(np.median(spent["whole"]))
    return {
        f"perception_{name}": {
            "median_ms": 1e3 * float(np.median(values)),
            "p95_ms": 1e3 * float(np.quantile(values, 0.95)),
            "ratio_to_whole": float(np.median(values)) / whole,
        }
        for name, values in spent.items()
    }


def _timed(name, function, spent):  # type: ignore[no-untyped-def]
    def call(*args, **kwargs):  # type: ignore[no-untyped-def]
        begin = time.perf_counter()
        result = function(*args, **kwargs)
        spent[name].append(time.perf_counter() - begin)
        return result

    return call
