"""Maps without reference poses at length: time, memory and error of simulated drives in a town."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.drive import Drive
from polemap.simulate.config import DetectorConfig, GnssConfig
from polemap.simulate.points.drive import ODOMETRY, PointScenario, simulate_points
from polemap.simulate.points.motion import GivenPoses
from polemap.simulate.points.poles import Poles

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
