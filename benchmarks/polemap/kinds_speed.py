"""Processor time that corners and lines add to the detection of poles, after the disparity.

    python -m benchmarks polemap.kinds_speed

Frames of two streets of `perception_speed`, of one with houses (`residential`), and of KITTI 03.
Every frame is looked at for poles alone, with corners, with lines (markings and kerbs) and with
all, in turn, nine times over. The median of the nine counts, and the median over the frames of what
a set takes beyond poles alone; `least_ms` is the same of the best of the nine, in which other work
of the machine shows less.
"""

from __future__ import annotations

import time

import cv2
import numpy as np

from benchmarks.polemap.perception_speed import KITTI, recorded, simulated
from polemap.detect.config import DetectionConfig
from polemap.detect.detection import detect
from polemap.detect.models.io import read_classifier, read_corner_classifier
from polemap.drivelog.samples import StereoFrame
from polemap.stereo.config import StereoConfig
from polemap.stereo.matching import make_matcher

_LINES = ("lane_marking", "kerb")
SETS = {
    "poles": DetectionConfig(),
    "corners": DetectionConfig(kinds=("pole", "corner")),
    "lines": DetectionConfig(kinds=("pole", *_LINES)),
    "all": DetectionConfig(kinds=("pole", "corner", *_LINES)),
}
_ROUNDS = 9


def run() -> dict[str, dict[str, float]]:
    """What every set of kinds takes beyond poles alone, by street."""
    cv2.setNumThreads(1)
    parts = {world: simulated(world, 511, 12) for world in ("suburb", "avenue", "residential")}
    if KITTI.exists():
        parts["kitti_03"] = recorded(KITTI)
    models = read_classifier("default"), read_corner_classifier("corners")
    figures = {}
    for street, (rig, samples) in parts.items():
        matcher = make_matcher(StereoConfig(), rig)
        frames = [sample for sample in samples if isinstance(sample, StereoFrame)]
        spent = np.empty((len(SETS), _ROUNDS, len(frames)))
        for at, frame in enumerate(frames):
            maps = matcher.match(frame.left, frame.right)
            for number in range(_ROUNDS):
                for row, config in enumerate(SETS.values()):
                    begin = time.process_time()
                    detect(frame, maps, rig, models[0], config, models[1])
                    spent[row, number, at] = 1e3 * (time.process_time() - begin)
        middle, least = np.median(spent, axis=1), spent.min(axis=1)
        for row, name in enumerate(SETS):
            alone = 0.0 if row == 0 else middle[0]
            more, best = middle[row] - alone, least[row] - (0.0 if row == 0 else least[0])
            figures[f"kinds_{street}_{name}"] = {
                "median_ms": float(np.median(more)),
                "p95_ms": float(np.percentile(more, 95)),
                "least_ms": float(np.median(best)),
                "ratio_to_poles": float(np.median(more / middle[0])),
            }
    return figures
