"""What the eye sees of simulated streets, held against the truth.

    python -m benchmarks.polemap.seen_poles [SEEDS] [SECONDS] [WORLD ...]

Per pole: poles that were shown in three frames or more, and the tracks, within 25 m of the camera.
A pole is shown in a frame when, at half or more of its heights from 0.3 to 2.3 m, pixels that are
truly its own carry its disparity. Real drives have no such truth, so the evaluation of maps only
asks for something at the pole's disparity (`polemap.evaluation.evidence`): that counts a pole
behind a hedge and leaves out bollards. Recall after that count is printed, too (`at_disparity`).
NEES: squared error of a confirmed track over its covariance, per degree of freedom,
averaged over the drive; a drive has few poles, so look at the rows, too. The drives are not those
on which the classifier was trained. Not timed, so `python -m benchmarks` leaves it out.
"""

from __future__ import annotations

import sys
from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.simulate.streets import open_street
from polemap.config import PolemapConfig
from polemap.drivelog.frames import EarthFrame
from polemap.drivelog.jobs import LocalWorkers, in_order
from polemap.drivelog.samples import StereoFrame
from polemap.evaluation.detections import FrameRecord, match, record, score_frames, score_tracks
from polemap.map.pole_map import PoleMap
from polemap.perception import PerceivedFrame, PolePerception
from polemap.simulate.truth import true_map
from polemap.stereo.rig import StereoRig
from polemap.vehicle.pose import inverse_transform_points

Floats = NDArray[np.float64]

WORLDS = ("suburb", "avenue", "boulevard")
RATE_HZ = 10.0
BEGIN_S = 4.0  # the car has set off by then
RANGE_M = (5.0, 25.0)
FIRST_SEED = 500
HEIGHTS_M = np.arange(0.3, 2.31, 0.1)


def judge(job: tuple[str, int, float]) -> dict[str, float]:
    """Figures of one drive through one world."""
    name, seed, seconds = job
    cv2.setNumThreads(1)
    street = open_street(name, seed, RATE_HZ, truth_images=True)
    plan, odometry, studio = street.plan, street.odometry, street.studio
    truth = true_map(street.world, EarthFrame("local", name=name), np.zeros(2))
    settings = PolemapConfig()
    perception = PolePerception(studio.renderer.rig, settings)
    row = 0
    records: list[FrameRecord] = []
    truly: list[FrameRecord] = []
    nees: list[float] = []
    for number, stamp in enumerate(plan.frame_stamps_s):
        if not BEGIN_S <= stamp < BEGIN_S + seconds:
            continue
        while row < len(odometry) and odometry.stamp_s[row] <= stamp:
            perception.record_odometry(odometry.sample(row))
            row += 1
        shot = studio.shot(number)
        perceived = perception.perceive(StereoFrame(stamp, stamp, number, shot.left, shot.right))
        pose = plan.motion.at(np.array([stamp]))[0]
        assert shot.truth is not None
        records.append(record(perceived, pose, truth, studio.renderer.rig, settings.detection))
        shown = shown_by_truth(perceived, pose, truth, shot.truth[2], studio.renderer.rig)
        truly.append(replace(records[-1], shown=shown))
        sure = perceived.tracks.confirmed & (perceived.tracks.detection >= 0)
        points, covariance = (
            perceived.tracks.points_vehicle_m[sure],
            perceived.tracks.covariance_m2[sure],
        )
        near = truth.within(pose[:2], 40.0)
        real = inverse_transform_points(pose, truth.points_m[near])
        for one, two in zip(*match(real, points, 1.0), strict=True):
            error = points[two] - real[one]
            nees.append(float(error @ np.linalg.solve(covariance[two], error)) / 2.0)
    there = score_tracks(records, truth, RANGE_M).figures()
    poles = score_tracks(truly, truth, RANGE_M).figures()
    (frames,) = score_frames(truly, truth, [RANGE_M])
    return {
        "poles": poles["shown"],
        "recall": poles["recall"],
        "at_disparity": there["shown"],
        "at_disparity_recall": there["recall"],
        "tracks": poles["claims"],
        "precision": poles["precision"],
        "frame_recall": frames.figures()["recall"],
        "frame_precision": frames.figures()["precision"],
        "across_m": poles["across_median_m"],
        "along_m": poles["along_median_m"],
        "along_bias_m": poles["along_bias_m"],
        "nees": float(np.mean(nees)) if nees else float("nan"),
    }


def shown_by_truth(
    perceived: PerceivedFrame,
    pose: Floats,
    truth: PoleMap,
    owner: NDArray[np.uint16],
    rig: StereoRig,
) -> NDArray[np.int64]:
    """Rows of the map whose own pixels carry their disparity at half or more of their heights."""
    near = truth.within(np.asarray(pose[:2]), 40.0)
    points = inverse_transform_points(pose, truth.points_m[near])
    disparity = perceived.disparity.left
    height, width = disparity.shape
    shown = []
    u, _, d = rig.project(np.column_stack([points, np.zeros(len(points))])).T
    for pole in np.flatnonzero((u >= 0) & (u < width) & (d > 1.0)):
        heights = HEIGHTS_M[truth.height_m[near[pole]] >= HEIGHTS_M]
        foot = float(perceived.view.ground.row_px(u[pole], d[pole]))
        rows = np.rint(foot - heights * d[pole] / rig.baseline_m).astype(np.int64)
        rows = rows[(rows >= 0) & (rows < height)]
        aside = max(0.15, truth.width_m[near[pole]]) * d[pole] / rig.baseline_m
        part = slice(int(max(0.0, u[pole] - aside)), int(min(width, u[pole] + aside + 1.0)))
        with np.errstate(invalid="ignore"):
            there = np.abs(disparity[rows, part] - d[pole]) <= max(1.0, 0.04 * d[pole])
        there &= owner[rows, part] == truth.ids[near[pole]]
        if len(rows) >= 3 and there.any(axis=1).mean() >= 0.5:
            shown.append(near[pole])
    return np.array(shown, dtype=np.int64)


def main(words: list[str]) -> None:
    """Print a row a drive and the means of every world."""
    seeds = int(words[0]) if words else 5
    seconds = float(words[1]) if len(words) > 1 else 10.0
    worlds = words[2:] or list(WORLDS)
    jobs = [(name, FIRST_SEED + k, seconds) for name in worlds for k in range(seeds)]
    results = list(in_order(judge, jobs, LocalWorkers(2)))
    print("world | seed | " + " | ".join(results[0]))
    for (name, seed, _), result in zip(jobs, results, strict=True):
        print(f"{name} | {seed} | " + " | ".join(f"{v:.2f}" for v in result.values()))
    for name in worlds:
        mine = [r for (world, _, _), r in zip(jobs, results, strict=True) if world == name]
        table = np.array([list(r.values()) for r in mine])
        one = np.ones(len(mine))
        weight = {
            "recall": table[:, 0], "at_disparity_recall": table[:, 2], "precision": table[:, 4],
        }  # fmt: skip
        means = [
            np.average(np.nan_to_num(column), weights=weight.get(key, one) + 1e-9)
            for key, column in zip(mine[0], table.T, strict=True)
        ]
        print(f"{name} | mean | " + " | ".join(f"{v:.2f}" for v in means))


if __name__ == "__main__":
    main(sys.argv[1:])
