"""The measure of realism: a classifier trained on simulated labels alone, tested on KITTI 03.

It is set beside classifiers trained on one half of KITTI 03 and tested on the other, in both
directions; the figure is the ratio of the average precisions. Hypotheses are labelled by the
LiDAR map of the sequence, as in `polemap train`; with `_unmapped`, true poles that this map lacks
are left out. Every set of simulated drives has seeds of its own and trains a model of its own;
`_pooled` is the model of all sets.

`python -m benchmarks.simulate.transfer FOLDER` keeps the simulated drives there, or takes them.
"""

from __future__ import annotations

import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from sklearn.metrics import average_precision_score

from benchmarks.polemap.kitti_poles import KITTI, UNMAPPED
from polemap.config import PolemapConfig
from polemap.detect.classifier import PoleClassifier
from polemap.drivelog.readers.registry import open_drive
from polemap.map.io import read_map
from polemap.simulate.camera_mounting import kitti_camera
from polemap.simulate.config import SimulateConfig
from polemap.simulate.drive import simulate_drive
from polemap.stereo.config import StereoConfig
from polemap.stereo.matching import make_matcher
from polemap.training import Samples, TrainingConfig, collect, join, train

# world, pictures a second
DRIVES = (("suburb", 0.8), ("park_loop", 1.5), ("avenue", 0.6))
FIRST_SEEDS = (101, 201, 301)


def drives(place: Path, first_seed: int) -> list[Path]:
    """The drives of one set; those that are there are taken as they are."""
    folders = []
    for number, (name, rate) in enumerate(DRIVES):
        folder = place / f"{name}_{first_seed + number}"
        if not folder.exists():
            config = SimulateConfig(camera=kitti_camera(frame_rate_hz=rate))
            simulate_drive(name, folder, 1, first_seed + number, config, objects=True)
        folders.append(folder)
    return folders


def gather(
    drive_path: Path, map_path: Path, parts: int = 1, lacking: Path | None = None
) -> Samples:
    """Labelled hypotheses of a drive."""
    drive = open_drive(drive_path)
    poles = read_map(map_path, drive.frame)
    ignore = read_map(lacking, drive.frame).points_m if lacking else None
    matcher = make_matcher(StereoConfig(), drive.rig)
    detection = PolemapConfig().detection
    return collect(drive, poles, matcher, detection, TrainingConfig(), ignore_m=ignore, parts=parts)


def _precision(model: PoleClassifier, samples: Samples) -> float:
    return float(average_precision_score(samples.is_pole, model.probability(samples.features)))


def compare(real: Samples, sets: list[Samples]) -> dict[str, float]:
    """Average precisions in both directions, and the ratios simulated to real over the sets."""
    config = TrainingConfig()
    models = [train(one, config, {}) for one in sets]
    pooled = train(join(sets), config, {})
    result: dict[str, float] = {
        "sets": float(len(sets)),
        "simulated_hypotheses": float(sum(map(len, sets))),
        "simulated_poles_share": float(np.mean(join(sets).is_pole)),
    }
    for test, direction in ((1, "trained_0_49_tested_50_98"), (0, "trained_50_98_tested_0_49")):
        judged = real.take(real.group == test)
        best = _precision(train(real.take(real.group != test), config, {}), judged)
        ratios = np.array([_precision(model, judged) for model in models]) / best
        result |= {
            f"{direction}_real_ap": best,
            f"{direction}_ratio_mean": float(ratios.mean()),
            f"{direction}_ratio_sd": float(ratios.std(ddof=1)) if len(ratios) > 1 else 0.0,
            f"{direction}_ratio_min": float(ratios.min()),
            f"{direction}_ratio_max": float(ratios.max()),
            f"{direction}_ratio_pooled": _precision(pooled, judged) / best,
        }
    return result


def measure(place: Path) -> dict[str, dict[str, float]]:
    """Both labellings of KITTI 03 against every set, with its drives in `place`."""
    sets = [
        join([gather(folder, folder / "objects.geojson") for folder in drives(place, seed)])
        for seed in FIRST_SEEDS
    ]
    sequence, poles = KITTI / "sequences" / "03", KITTI / "poles" / "03.csv"
    return {
        "simulate_transfer": compare(gather(sequence, poles, 2), sets),
        "simulate_transfer_unmapped": compare(gather(sequence, poles, 2, UNMAPPED), sets),
    }


def run() -> dict[str, dict[str, float]]:
    """Collected by `python -m benchmarks`; takes a quarter of an hour."""
    if not KITTI.is_dir():
        return {}
    with TemporaryDirectory() as place:
        return measure(Path(place))


if __name__ == "__main__":
    for key, values in (measure(Path(sys.argv[1])) if len(sys.argv) > 1 else run()).items():
        print(key, {k: round(v, 3) for k, v in values.items()})
