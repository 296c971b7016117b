"""How hard simulated pairs are for the matcher, beside real ones: error against true disparity.

The same matcher, with the same settings, on KITTI 2015 (LiDAR truth) and on simulated pairs of
every world (exact truth) in the same geometry. On both, pixels count whose true disparity is
known and which both cameras see. What of the sub-pixel error is the matcher's and what lies between
pictures and truth shows a registration of windows by least squares
(`benchmarks.simulate.registration`).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from benchmarks.harness import RECORDINGS
from benchmarks.simulate.registration import Windows, register, together
from benchmarks.stereo.pairs import read_grey, read_truth
from polemap.simulate.camera_mounting import kitti_camera
from polemap.simulate.config import RenderConfig, SimulateConfig
from polemap.simulate.render import View
from polemap.simulate.scenario import load_scenario, scenario_names
from polemap.simulate.studio import Studio, make_plan
from polemap.simulate.world import make_world
from polemap.stereo.config import StereoConfig
from polemap.stereo.matching import make_matcher
from polemap.stereo.rig import StereoRig

KITTI = RECORDINGS / "kitti_2015" / "training"
PAIRS_A_SEED = 2
SEEDS = (11, 12, 13, 14)


def occluded(truth: NDArray[np.float32], other: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Pixels of the left view that the right one does not see, from both true disparities."""
    height, width = truth.shape
    u = np.arange(width)[None] - np.rint(truth)
    inside = (u >= 0) & (u < width)
    partner = other[np.arange(height)[:, None], np.clip(u, 0, width - 1).astype(np.int64)]
    return np.asarray(~inside | (np.abs(partner - truth) > np.maximum(1.0, 0.05 * truth)))


def score(
    found: NDArray[np.float32], truth: NDArray[np.float32], known: NDArray[np.bool_]
) -> dict[str, float]:
    """KITTI's measure (more than 3 px and 5 % off), the share matched and the spread."""
    valid = known & np.isfinite(found)
    error = np.abs(found - truth)[valid]
    bad = (error > 3.0) & (error > 0.05 * truth[valid])
    return {
        "bad_percent": 100 * float(bad.mean()),
        "over_1px_percent": 100 * float((error > 1).mean()),
        "density_percent": 100 * float(valid.sum() / known.sum()),
        "median_px": float(np.median(error)),
    }


def _summary(rows: list[dict[str, float]], windows: list[Windows]) -> dict[str, float]:
    """Means over the pairs, least and most of two, and what the registration says."""
    result = {key: float(np.mean([row[key] for row in rows])) for key in rows[0]}
    for key in ("bad_percent", "median_px"):
        result[f"{key}_least"] = min(row[key] for row in rows)
        result[f"{key}_most"] = max(row[key] for row in rows)
    return result | together(windows).figures()


def kitti() -> dict[str, float]:
    """The measure over the KITTI 2015 pairs, or nothing where they are missing."""
    matcher = make_matcher(StereoConfig(disparities=192))
    rows, windows = [], []
    for truth_file in sorted(KITTI.glob("disp_noc_0/*.png")):
        left, right = (read_grey(KITTI / side / truth_file.name) for side in ("image_2", "image_3"))
        truth = np.nan_to_num(read_truth(truth_file, 256.0))
        found = matcher.match(left, right).left
        rows.append(score(found, truth, truth > 0))
        windows.append(register(left, right, found, truth, truth > 0))
    return _summary(rows, windows) if rows else {}


def truths(rig: StereoRig, views: tuple[View, View]) -> tuple[NDArray[np.float32], ...]:
    """True disparity of both views."""
    with np.errstate(divide="ignore"):
        return tuple(
            (rig.focal_px * rig.baseline_m / view.depth_m).astype(np.float32) for view in views
        )


def world(name: str) -> dict[str, float]:
    """The measure over some pairs of a simulated world, in KITTI's geometry."""
    matcher = make_matcher(StereoConfig(disparities=192))
    rows, windows = [], []
    for seed in SEEDS:
        config = SimulateConfig(camera=kitti_camera(), render=RenderConfig(workers=1))
        scenario = load_scenario(name)
        built = make_world(scenario, seed)
        plan = make_plan(built.route, scenario, 1, seed, config)
        studio = Studio(plan, built, 0)
        for number in np.linspace(0, len(plan.frame_stamps_s) - 1, PAIRS_A_SEED + 2)[1:-1]:
            views = studio.views(int(number))
            left, right = studio.picture(int(number), views)
            truth, other = truths(studio.renderer.rig, views)
            known = (truth > 0) & ~occluded(truth, other)
            # LiDAR truth ends at about 80 m and a third of the way up
            known &= truth > studio.renderer.rig.focal_px * studio.renderer.rig.baseline_m / 80
            known[: known.shape[0] // 3] = False
            found = matcher.match(left, right).left
            rows.append(score(found, truth, known))
            windows.append(register(left, right, found, truth, known))
    return _summary(rows, windows)


def run() -> dict[str, dict[str, float]]:
    """Collected by `python -m benchmarks`."""
    results = {"simulate_realism_kitti_2015": kitti()}
    for name in scenario_names():
        results[f"simulate_realism_{name}"] = world(name)
    return {name: values for name, values in results.items() if values}


if __name__ == "__main__":
    for name, values in run().items():
        print(name, {key: round(value, 2) for key, value in values.items()})
