"""Maps without reference poses at length: CPU, memory and error of simulated drives in a town.

    python -m benchmarks.polemap.slam_scale [KM] [DRIVES] [SEED]

Points without pictures, cheap GNSS, streets driven two or three times on average; one process. Not
among the timed ones, so `python -m benchmarks` leaves it out.
"""

from __future__ import annotations

import resource
import sys
import time
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from polemap.build.assemble import assemble_map
from polemap.build.config import MappingConfig
from polemap.build.slam.condense import condense
from polemap.build.slam.config import SlamConfig
from polemap.build.slam.motion import MotionNoise
from polemap.build.slam.skeleton import solve_condensed
from polemap.drivelog.drive import Drive
from polemap.simulate.config import DetectorConfig, GnssConfig
from polemap.simulate.points.drive import ODOMETRY, PointScenario, simulate_points
from polemap.simulate.points.motion import GivenPoses
from polemap.simulate.points.poles import Poles
from polemap.vehicle.pose import rigid_fit, transform_points

Floats = NDArray[np.float64]

BLOCK_M = np.array([120.0, 80.0])
SPEED_MPS, STEP_S = 10.0, 0.1
DETECTOR = DetectorConfig(
    rate_hz=5.0, half_view_rad=1.2, range_max_m=30.0, detected_share=0.85, clutter_share=0.05,
    bearing_sd_rad=0.003, correlated_share=0.5, latency_s=0.0,
)  # fmt: skip
GNSS = GnssConfig(
    rate_hz=1.0, wander_sd_m=2.5, multipath_per_min=0.0, outages_per_min=0.0, antenna_x_m=1.0,
    latency_s=0.0,
)  # fmt: skip


def town(blocks: int, rng: np.random.Generator) -> Poles:
    """Poles along the streets of a square town, unevenly, on both sides."""
    points: list[Floats] = []
    size = blocks * BLOCK_M
    for axis in (0, 1):
        for street in range(blocks + 1):
            at = rng.uniform(0.0, 10.0)
            while at < size[axis]:
                off = rng.choice([-1.0, 1.0]) * rng.uniform(4.0, 8.0)
                point = np.empty(2)
                point[axis], point[1 - axis] = at, street * BLOCK_M[1 - axis] + off
                cross = np.abs(point[axis] - BLOCK_M[axis] * np.round(point[axis] / BLOCK_M[axis]))
                if cross > 3.0:
                    points.append(point)
                at += 2.0 + rng.exponential(5.0)
    n = len(points)
    return Poles(np.array(points), rng.uniform(0.1, 0.5, n), rng.beta(6.0, 2.0, n))


def way(blocks: int, length_m: float, rng: np.random.Generator) -> Floats:
    """Poses every `STEP_S` of a random way through the streets, never straight back."""
    at, heading = rng.integers(0, blocks + 1, 2), np.array([1, 0])
    corners, total = [at * BLOCK_M], 0.0
    while total < length_m + 20.0:
        turns = [heading, np.array([-heading[1], heading[0]]), np.array([heading[1], -heading[0]])]
        inside = [turn for turn in turns if ((at + turn >= 0) & (at + turn <= blocks)).all()] or [
            -heading
        ]
        heading = inside[rng.integers(len(inside))]
        at = at + heading
        corners.append(at * BLOCK_M)
        total += float(np.abs(heading * BLOCK_M).sum())
    line = np.array(corners)
    station = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(line, axis=0).T))])
    s = np.arange(0.0, length_m, SPEED_MPS * STEP_S)
    xy = np.column_stack([np.interp(s, station, line[:, axis]) for axis in (0, 1)])
    kernel = np.ones(15) / 15
    padded = np.pad(xy, ((7, 7), (0, 0)), mode="edge")
    xy = np.column_stack([np.convolve(padded[:, axis], kernel, mode="valid") for axis in (0, 1)])
    xy = xy[8:-8]
    ahead = np.gradient(xy, axis=0)
    return np.column_stack([xy, np.arctan2(ahead[:, 1], ahead[:, 0])])


def drive_of(
    poses: Floats, poles: Poles, rng: np.random.Generator, name: str, start_s: float
) -> Drive:
    scenario = PointScenario(
        duration_s=STEP_S * len(poses), motion=GivenPoses(poses, STEP_S),
        odometry=ODOMETRY.model_copy(update={"speed_scale_sd": 0.02}), gnss=GNSS,
        detector=DETECTOR, detector_error_time_s=0.5, start_s=start_s,
    )  # fmt: skip
    drive = simulate_points(scenario, rng, poles).drive
    return replace(drive, name=name, gnss_antenna_m=np.array([1.0, 0.0]))


def _tell(stage: str, begin_s: float) -> float:
    memory_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
    now_s = time.process_time()
    print(f"{stage}: {now_s - begin_s:.1f} s of CPU, {memory_mb:.0f} MB at most so far", flush=True)
    return now_s


def main(km: float = 10.0, drives: int = 2, seed: int = 1) -> None:
    """Simulate, condense drive by drive, solve, build the map, and compare with the truth."""
    rng = np.random.default_rng(seed)
    blocks = max(2, round(float(np.sqrt(km * 1000.0 / 2.5 / BLOCK_M.sum()))))
    poles = town(blocks, rng)
    truth, parts = [], []
    begin = time.process_time()
    for number in range(drives):
        truth.append(way(blocks, km * 1000.0 / drives, rng))
        drive = drive_of(truth[-1], poles, rng, f"drive {number}", 10_000.0 * number)
        parts.append(
            condense(
                drive.name, drive, drive.scans, MappingConfig(), SlamConfig(), MotionNoise(),
                drive.frame,
            )
        )  # fmt: skip
    begin = _tell(f"{km:.0f} km in {drives} drives, simulated and condensed", begin)
    result, observed = solve_condensed(parts, MappingConfig(), SlamConfig())
    begin = _tell(f"solved, {result.summary.loops} loops", begin)
    pole_map = assemble_map(observed, MappingConfig(), result.frame).pole_map
    _tell(f"map of {len(pole_map)} poles ({len(poles.points_m)} stand there)", begin)
    found, true = [], []
    for number, (reference, poses) in enumerate(zip(result.references, truth, strict=True)):
        at = reference.at(10_000.0 * number + STEP_S * np.arange(len(poses)))
        known = np.isfinite(at).all(axis=1)
        found.append(at[known, :2])
        true.append(poses[known, :2])
    one, other = np.concatenate(found), np.concatenate(true)
    laid = transform_points(rigid_fit(one, other), one)
    for name, off in (("as they are", one - other), ("after one rigid move", laid - other)):
        middle, most = np.quantile(np.hypot(*off.T), [0.5, 0.95])
        print(f"poses {name}: {middle:.2f} m median, {most:.2f} m 95 %")


if __name__ == "__main__":
    asked = sys.argv[1:4]
    km, count, chosen = (*asked, *("10", "2", "1")[len(asked) :])
    main(float(km), int(count), int(chosen))
