"""The measure of realism: a classifier trained on simulated labels alone, tested on KITTI 03.

It is set beside classifiers trained on one half of KITTI 03 and tested on the other, in both
directions; the figure is the ratio of the average precisions. Hypotheses are labelled by the
LiDAR map of the sequence, as in `polemap train`.
"""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from sklearn.metrics import average_precision_score

from drivelog.drive import open_drive
from polemap.config import PolemapConfig
from polemap.io import read_map
from polemap.training import Samples, TrainingConfig, collect, join, train
from simulate.config import SimulateConfig, kitti_camera
from simulate.drive import simulate_drive
from stereo.config import StereoConfig
from stereo.matching import make_matcher

KITTI = Path(__file__).parents[2] / "shared" / "data" / "kitti_odometry"
# world, seed, pictures a second
DRIVES = (("suburb", 101, 1.6), ("park_loop", 102, 3.0), ("avenue", 103, 1.2))


def _gather(drive_path: Path, map_path: Path, parts: int) -> Samples:
    drive = open_drive(drive_path)
    poles = read_map(map_path, drive.frame)
    matcher = make_matcher(StereoConfig(), drive.rig)
    return collect(drive, poles, matcher, PolemapConfig().detection, TrainingConfig(), parts=parts)


def compare(folders: list[Path]) -> dict[str, float]:
    """Average precisions on both halves of KITTI 03, and the ratios simulated to real."""
    config = TrainingConfig()
    real = _gather(KITTI / "sequences" / "03", KITTI / "poles" / "03.csv", 2)
    simulated = join([_gather(folder, folder / "objects.geojson", 1) for folder in folders])
    from_simulation = train(simulated, config, {})
    result: dict[str, float] = {
        "simulated_hypotheses": float(len(simulated)),
        "simulated_poles_share": float(simulated.is_pole.mean()),
    }
    for test in (0, 1):
        part = real.group == test
        other = Samples(
            real.features[~part], real.is_pole[~part], np.zeros((~part).sum(), np.int64),
            real.pole[~part], (real.groups[1 - test],),
        )  # fmt: skip
        models = {"real": train(other, config, {}), "simulated": from_simulation}
        for name, model in models.items():
            chance = model.probability(real.features[part])
            precision = average_precision_score(real.is_pole[part], chance)
            result[f"average_precision_{name}_half_{test + 1}"] = float(precision)
        result[f"ratio_half_{test + 1}"] = (
            result[f"average_precision_simulated_half_{test + 1}"]
            / result[f"average_precision_real_half_{test + 1}"]
        )
    return result


def run() -> dict[str, dict[str, float]]:
    """Collected by `python -m benchmarks`; takes some minutes."""
    if not KITTI.is_dir():
        return {}
    with TemporaryDirectory() as place:
        folders = []
        for name, seed, rate in DRIVES:
            config = SimulateConfig(camera=kitti_camera(frame_rate_hz=rate))
            folders.append(simulate_drive(name, Path(place) / name, 1, seed, config, objects=True))
        return {"simulate_transfer": compare(folders)}


if __name__ == "__main__":
    for key, values in run().items():
        print(key, {k: round(v, 3) for k, v in values.items()})
