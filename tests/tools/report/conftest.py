"""Synthetic courses, trajectories of known lateral noise, and run folders made of them."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from tools.report.trajectory import Trajectory, tum_text
from vehicle.pose import wrap_angle

Floats = NDArray[np.float64]


class Course:
    """A smooth closed course r(theta) = 60 + 8 cos(3 theta): about 394 m, both ways curved."""

    def __init__(self) -> None:
        self._angle = np.linspace(0.0, 2.0 * np.pi, 20001)
        points = self._points(self._angle)
        self._length = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))])
        self.length_m = float(self._length[-1])

    @staticmethod
    def _points(angle: Floats) -> Floats:
        radius = 60.0 + 8.0 * np.cos(3.0 * angle)
        return np.column_stack([radius * np.cos(angle), radius * np.sin(angle)])

    def poses(self, distance_m: Floats, lateral_m: Floats | float = 0.0) -> Floats:
        """Poses `(n, 3)` after `distance_m` of travel, shifted to the left, along the course."""
        angle = np.interp(distance_m % self.length_m, self._length, self._angle)
        radius, slope = 60.0 + 8.0 * np.cos(3.0 * angle), -24.0 * np.sin(3.0 * angle)
        tangent = np.arctan2(
            slope * np.sin(angle) + radius * np.cos(angle),
            slope * np.cos(angle) - radius * np.sin(angle),
        )
        normal = np.column_stack([-np.sin(tangent), np.cos(tangent)])
        points = self._points(angle) + np.reshape(lateral_m, (-1, 1)) * normal
        return np.column_stack([points, wrap_angle(tangent)])


def smooth_noise(rng: np.random.Generator, count: int, sd: float, correlation: float) -> Floats:
    """Gaussian noise of known sd, correlated over about `correlation` samples (0: white)."""
    if correlation <= 0.0:
        return np.asarray(sd * rng.standard_normal(count))
    margin = int(5 * correlation)
    raw = gaussian_filter1d(rng.standard_normal(count + 2 * margin), correlation)
    return np.asarray(
        sd * raw[margin : margin + count] * np.sqrt(2.0 * correlation * np.sqrt(np.pi))
    )


@dataclass(frozen=True)
class Driven:
    """A drive on the course: `lateral_m` is what the driver did."""

    truth: Trajectory
    distance_m: Floats
    lateral_m: Floats


@pytest.fixture(scope="session")
def course() -> Course:
    return Course()


@pytest.fixture(scope="session")
def drive_course(course: Course) -> Callable[..., Driven]:
    """Drive laps with known lateral noise: `drive_course(seed, laps=6, sd=0.15, ...)`."""

    def make(
        seed: int,
        laps: int = 6,
        sd: float = 0.15,
        correlation_m: float = 8.0,
        lap_sd: float = 0.0,
        rate_hz: float = 20.0,
        speed_mps: float = 8.0,
        swerve: tuple[int, float, float] | None = None,
    ) -> Driven:
        rng = np.random.default_rng(seed)
        count = int((laps * course.length_m + 5.0) / speed_mps * rate_hz)
        stamp = np.arange(count) / rate_hz
        distance = stamp * speed_mps
        step = speed_mps / rate_hz
        lateral = smooth_noise(rng, count, sd, correlation_m / step)
        offsets = lap_sd * rng.standard_normal(laps + 1)
        lateral += offsets[np.minimum((distance // course.length_m).astype(int), laps)]
        if swerve is not None:
            lap, at_m, size_m = swerve
            lateral += size_m * np.exp(
                -0.5 * ((distance - lap * course.length_m - at_m) / 8.0) ** 2
            )
        poses = course.poses(distance, lateral)
        if correlation_m > 0:
            poses[:, 2] = wrap_angle(poses[:, 2] + np.arctan(np.gradient(lateral, distance)))
        return Driven(Trajectory(stamp, poses), distance, lateral)

    return make


def shifted(track: Trajectory, lateral_m: Floats, ahead_m: Floats | float = 0.0) -> Trajectory:
    """A trajectory moved to its own left and ahead."""
    poses = track.poses.copy()
    cos, sin = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    poses[:, 0] += -sin * lateral_m + cos * ahead_m
    poses[:, 1] += cos * lateral_m + sin * ahead_m
    return Trajectory(track.stamp_s, poses)


def write_run_folder(
    folder: Path,
    pf: Trajectory,
    kf: Trajectory,
    seed: int,
    drive: Path | None,
    map_file: Path | None,
    metrics: dict[str, Any] | None = None,
    **settings: Any,
) -> Path:
    """A run folder of CONTRACT.md."""
    folder.mkdir(parents=True)
    (folder / "pf.tum").write_text(tum_text(pf))
    (folder / "kf.tum").write_text(tum_text(kf))
    rng = np.random.default_rng(seed)
    rows = ["stamp_s,matched,seen,in_view,n_eff,position_sd_major_m,position_sd_minor_m,"
            "exploration_ratio,gate,lag_s"]  # fmt: skip
    rows += [
        f"{stamp},{rng.integers(1, 6)},{rng.integers(2, 7)},7,{rng.uniform(300, 900):.1f},0.12,"
        f"0.08,0.0,accepted,{rng.uniform(0.08, 0.12):.4f}"
        for stamp in pf.stamp_s.tolist()
    ]
    (folder / "health.csv").write_text("\n".join(rows) + "\n")
    content = {
        "reinitializations": int(rng.integers(0, 2)),
        "exploration_events": int(rng.integers(0, 5)),
        "gate_rejections": int(rng.integers(0, 9)),
        "late_dropped": 0,
        "timing_ms": {
            "perception": {"median": 30.1, "p95": 38.0, "p99": 44.0},
            "particle_filter": {"median": 1.9, "p95": 2.6, "p99": 4.0},
            "output_filter": {"median": 0.2, "p95": 0.3, "p99": 0.5},
        },
        "real_time_factor": 2.1,
        "pf": {"nees_mean": 1.1},
        "kf": {"nees_mean": 0.9},
        **(metrics or {}),
    }
    (folder / "metrics.json").write_text(json.dumps(content))
    config = {
        "polemap_version": "0.1.0",
        "drive": str(drive) if drive else None,
        "map": str(map_file) if map_file else None,
        "lap": None,
        "settings": {"localize": {"particles": 1000, **settings}},
        "seed": seed,
    }
    (folder / "config.yaml").write_text(yaml.safe_dump(config, sort_keys=False))
    return folder


@pytest.fixture(scope="session")
def make_runs(course: Course, drive_course: Callable[..., Driven]) -> Callable[..., Path]:
    """Write a drive, a map and a Monte Carlo set of runs; return the run folder."""

    def make(
        root: Path,
        name: str = "synthetic",
        runs: int = 3,
        laps: int = 6,
        seed: int = 0,
        pf_sd: float = 0.08,
        kf_sd: float = 0.06,
        wander_sd: float = 0.12,
        reference_sd: float = 0.4,
        with_truth: bool = True,
        swerve: tuple[int, float, float] | None = None,
        drive_name: str | None = None,
        notes: tuple[str, ...] = (),
        origin_m: tuple[float, float] = (0.0, 0.0),
    ) -> Path:
        rng = np.random.default_rng([seed, 1])
        driven = drive_course(seed, laps=laps, sd=wander_sd, correlation_m=15.0, swerve=swerve)
        truth = driven.truth
        truth.poses[:, :2] += origin_m
        drive = root / f"{name}_drive"
        drive.mkdir(parents=True)
        head = {
            "format_version": 1,
            "name": drive_name or name,
            "frame": {"kind": "local", "name": "test_plane"},
            "vehicle": {"wheelbase_m": 2.7},
            "type": "test course",
        }
        if notes:
            head["notes"] = list(notes)
        (drive / "drive.yaml").write_text(yaml.safe_dump(head, sort_keys=False))
        count = len(truth)
        drift = smooth_noise(rng, count, reference_sd, 20.0 * 60.0)
        reference = shifted(truth, drift)
        _write_poses(drive / "reference.csv", reference, ",0.3", "sd_m")
        if with_truth:
            _write_poses(drive / "truth.csv", truth)
        speed = np.full(count, 8.0)
        rate = np.gradient(np.unwrap(truth.poses[:, 2]), truth.stamp_s)
        (drive / "odometry.csv").write_text(
            "stamp_s,speed_mps,yaw_rate_radps\n"
            + "".join(
                f"{t:.6f},{v:.4f},{w:.6f}\n"
                for t, v, w in zip(truth.stamp_s, speed, rate, strict=True)
            )
        )
        poles = course.poses(np.arange(0.0, course.length_m, 13.0), 5.0)[:, :2] + origin_m
        map_file = root / f"{name}_map.csv"
        map_file.write_text(
            "east_m,north_m,width_m\n"
            + "".join(f"{x:.3f},{y:.3f},0.2\n" for x, y in poles.tolist())
        )
        folder = root / name
        for number in range(runs):
            part = Trajectory(truth.stamp_s[::2], truth.poses[::2])
            pf = shifted(
                part, smooth_noise(rng, len(part), pf_sd, 3.0), rng.normal(0, 0.1, len(part))
            )
            kf = shifted(truth, smooth_noise(rng, count, kf_sd, 20.0))
            write_run_folder(
                folder / f"{number:03d}" if runs > 1 else folder, pf, kf, number, drive, map_file
            )
        return folder

    return make


@pytest.fixture(scope="session")
def make_sensor_drive(course: Course, drive_course: Callable[..., Driven]) -> Callable[..., Path]:
    """A plain drive folder with odometry, GNSS and detected poles; the map lies beside it."""

    def make(folder: Path, laps: int = 2, seed: int = 0) -> Path:
        rng = np.random.default_rng([seed, 3])
        driven = drive_course(
            seed, laps=laps, sd=0.12, correlation_m=20.0, rate_hz=20.0, speed_mps=13.0
        )
        truth, count, step_s = driven.truth, len(driven.truth), 0.05
        folder.mkdir(parents=True)
        head = {
            "format_version": 1,
            "name": folder.name,
            "frame": {"kind": "local", "name": "test_plane"},
            "vehicle": {"wheelbase_m": 2.7},
        }
        (folder / "drive.yaml").write_text(yaml.safe_dump(head))
        moved = np.hypot(*np.diff(truth.poses[:, :2], axis=0, append=truth.poses[-1:, :2]).T)
        speed = 1.005 * moved / step_s + rng.normal(0.0, 0.03, count)
        rate = np.gradient(np.unwrap(truth.poses[:, 2]), step_s) + rng.normal(0.0, 0.003, count)
        _write_table(
            folder / "odometry.csv", "stamp_s,speed_mps,yaw_rate_radps", truth.stamp_s, speed, rate
        )
        fixes = truth.poses[::20, :2] + rng.normal(0.0, 1.0, (len(truth.poses[::20]), 2))
        hdop = np.ones(len(fixes))
        _write_table(
            folder / "gnss.csv", "stamp_s,east_m,north_m,hdop", truth.stamp_s[::20], *fixes.T, hdop
        )
        _write_poses(folder / "reference.csv", truth, ",0.02", "sd_m")
        places = np.arange(0.0, course.length_m, 9.0)
        sides = np.where(np.arange(len(places)) % 2, 5.0, -5.0) + rng.normal(0, 1.0, len(places))
        poles = course.poses(places + rng.normal(0.0, 2.0, len(places)), sides)[:, :2]
        seen = []
        for stamp, (x, y, yaw) in zip(truth.stamp_s[::2], truth.poses[::2], strict=True):
            cos, sin = np.cos(yaw), np.sin(yaw)
            around = (poles - (x, y)) @ np.array([[cos, -sin], [sin, cos]])
            distance, bearing = np.hypot(*around.T), np.arctan2(around[:, 1], around[:, 0])
            here = (distance < 25.0) & (distance > 3.0) & (np.abs(bearing) < 0.6)
            here &= rng.random(len(poles)) < 0.85
            for px, py in around[here] + rng.normal(0.0, 0.12, (int(here.sum()), 2)):
                seen.append((stamp, px, py, 0.0144, 0.0144, 0.0, 0.2))
        names = "stamp_s,x_m,y_m,var_x_m2,var_y_m2,cov_xy_m2,width_m"
        _write_table(folder / "poles.csv", names, *np.array(seen).T)
        _write_table(folder / "scans.csv", "stamp_s", truth.stamp_s[::2])
        _write_table(folder.with_suffix(".csv"), "east_m,north_m", *poles.T)
        return folder

    return make


def _write_table(path: Path, header: str, *columns: Floats) -> None:
    rows = (",".join(f"{value:.6f}" for value in row) for row in zip(*columns, strict=True))
    path.write_text(header + "\n" + "\n".join(rows) + "\n")


def _write_poses(path: Path, track: Trajectory, tail: str = "", extra: str = "") -> None:
    header = "stamp_s,east_m,north_m,yaw_rad" + (f",{extra}" if extra else "")
    lines = [
        f"{t:.6f},{x:.6f},{y:.6f},{a:.8f}{tail}"
        for t, (x, y, a) in zip(track.stamp_s.tolist(), track.poses.tolist(), strict=True)
    ]
    path.write_text(header + "\n" + "\n".join(lines) + "\n")
