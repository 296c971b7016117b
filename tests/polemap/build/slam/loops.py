"""Drives round a block of streets, as the tests of building without a reference need them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from polemap.build.config import MappingConfig
from polemap.build.slam.config import SlamConfig
from polemap.build.slam.motion import MotionNoise
from polemap.build.slam.slam import SlamResult, solve_slam
from polemap.drivelog.drive import Drive
from polemap.drivelog.writers.folder import folder_writer
from polemap.simulate.config import DetectorConfig, GnssConfig, OdometryConfig
from polemap.simulate.points.drive import ODOMETRY, PointScenario, simulate_points
from polemap.simulate.points.motion import GivenPoses
from polemap.simulate.points.poles import Poles
from polemap.vehicle.pose import rigid_fit, transform_points, wrap_angle

Floats = NDArray[np.float64]

DETECTOR = DetectorConfig(
    rate_hz=5.0, half_view_rad=1.2, range_max_m=30.0, detected_share=0.85, clutter_share=0.05,
    bearing_sd_rad=0.003, correlated_share=0.5, latency_s=0.0,
)  # fmt: skip
GNSS = GnssConfig(
    rate_hz=1.0, wander_sd_m=1.5, multipath_per_min=0.0, outages_per_min=0.0, antenna_x_m=1.0,
    latency_s=0.0,
)  # fmt: skip
SCALED = ODOMETRY.model_copy(update={"speed_scale_sd": 0.03})


def rounded(corners: Floats, step_m: float, laps: float = 1.0) -> Floats:
    """Poses `(n, 3)` round a polygon, its corners rounded, every `step_m`."""
    closed = np.concatenate([np.tile(corners, (int(np.ceil(laps)), 1)), corners[:1]])
    station = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(closed, axis=0).T))])
    s = np.arange(0.0, station[-1] * laps / np.ceil(laps), step_m)
    xy = np.column_stack([np.interp(s, station, closed[:, axis]) for axis in (0, 1)])
    width = int(10.0 / step_m) | 1
    kernel = np.ones(width) / width
    padded = np.pad(xy, ((width // 2, width // 2), (0, 0)), mode="edge")
    xy = np.column_stack([np.convolve(padded[:, axis], kernel, mode="valid") for axis in (0, 1)])
    ahead = np.gradient(xy, axis=0)
    return np.column_stack([xy, np.arctan2(ahead[:, 1], ahead[:, 0])])


def block(laps: float = 2.5, speed_mps: float = 8.0) -> Floats:
    """Poses ten times a second round a block of 80 by 50 m."""
    corners = np.array([[0.0, 0.0], [80.0, 0.0], [80.0, 50.0], [0.0, 50.0]])
    return rounded(corners, speed_mps / 10.0, laps)


def beside(
    poses: Floats, spacing_m: float, rng: np.random.Generator, offset_m: float = 6.0
) -> Poles:
    """Poles on both sides of a path's first lap, unevenly."""
    way = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(poses[:, :2], axis=0).T))])
    points: list[Floats] = []
    at = 2.0
    while at < way[-1]:
        row = int(np.searchsorted(way, at))
        side = 1.0 if rng.random() < 0.5 else -1.0
        east, north, yaw = poses[min(row, len(poses) - 1)]
        off = side * (offset_m + rng.uniform(-2.0, 2.0))
        point = np.array([east - np.sin(yaw) * off, north + np.cos(yaw) * off])
        clear = np.hypot(*(poses[:, :2] - point).T).min() > 2.5
        if clear and all(np.hypot(*(point - other)) > 1.5 for other in points):
            points.append(point)
        at += rng.exponential(spacing_m)
    n = len(points)
    return Poles(np.array(points).reshape(-1, 2), rng.uniform(0.1, 0.5, n), rng.beta(6.0, 2.0, n))


@dataclass(frozen=True)
class Simulated:
    drive: Drive
    poles: Poles
    truth: Floats


def simulated(
    poses: Floats,
    poles: Poles,
    rng: np.random.Generator,
    *,
    gnss: GnssConfig | None = GNSS,
    odometry: OdometryConfig = SCALED,
) -> Simulated:
    """A drive along poses ten times a second, without its reference."""
    scenario = PointScenario(
        duration_s=0.1 * len(poses), motion=GivenPoses(poses), odometry=odometry, gnss=gnss,
        detector=DETECTOR, detector_error_time_s=0.5,
    )  # fmt: skip
    made = simulate_points(scenario, rng, poles)
    antenna = np.array([gnss.antenna_x_m if gnss is not None else 0.0, 0.0])
    return Simulated(replace(made.drive, gnss_antenna_m=antenna), poles, poses)


def solve(*drives: Drive, config: SlamConfig | None = None) -> SlamResult:
    """The poses of drives without their reference."""
    bare = [(f"drive {k}", replace(drive, reference=None)) for k, drive in enumerate(drives)]
    scans = [drive.scans for drive in drives]
    frame = drives[0].frame
    return solve_slam(bare, scans, MappingConfig(), config or SlamConfig(), MotionNoise(), frame)


def pose_errors(result: SlamResult, truth: Floats, number: int = 0) -> tuple[Floats, Floats]:
    """Distances `(n,)` from the truth, ten poses a second, as they are and once laid onto it."""
    stamps = 0.1 * np.arange(len(truth))
    poses = result.references[number].at(stamps)
    known = np.isfinite(poses).all(axis=1)
    off = np.hypot(*(poses - truth)[known, :2].T)
    move = rigid_fit(poses[known, :2], truth[known, :2])
    laid = np.hypot(*(transform_points(move, poses[known, :2]) - truth[known, :2]).T)
    return off, laid


def yaw_errors(result: SlamResult, truth: Floats) -> Floats:
    stamps = 0.1 * np.arange(len(truth))
    poses = result.references[0].at(stamps)
    known = np.isfinite(poses).all(axis=1)
    return np.abs(wrap_angle(poses[known, 2] - truth[known, 2]))


def write_simulated(folder: Path, sim: Simulated, *, reference: bool = False) -> Path:
    """The drive as a plain folder."""
    drive = sim.drive
    with folder_writer(
        folder, name=folder.name, frame=drive.frame, wheelbase_m=drive.wheelbase_m,
        pole_view=drive.scans[0].view, gnss_antenna_m=drive.gnss_antenna_m,
    ) as writer:  # fmt: skip
        assert drive.odometry is not None
        assert drive.gnss is not None
        writer.odometry(drive.odometry)
        writer.gnss(drive.gnss)
        writer.scans(drive.scans)
        if reference:
            assert drive.reference is not None
            writer.reference(drive.reference)
    return folder
