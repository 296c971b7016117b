"""A course, trajectories of known lateral noise along it, and the files made of them."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from polemap.drivelog.tum import tum_text
from polemap.vehicle.pose import wrap_angle
from polemap.vehicle.trajectory import Trajectory

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
    """A run folder as `polemap localize` writes it."""
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


def write_table(path: Path, header: str, *columns: Floats) -> None:
    """A CSV file of a drive folder."""
    rows = (",".join(f"{value:.6f}" for value in row) for row in zip(*columns, strict=True))
    path.write_text(header + "\n" + "\n".join(rows) + "\n")


def write_poses(path: Path, track: Trajectory, tail: str = "", extra: str = "") -> None:
    """`reference.csv` or `truth.csv`, with `tail` behind every row."""
    header = "stamp_s,east_m,north_m,yaw_rad" + (f",{extra}" if extra else "")
    lines = [
        f"{t:.6f},{x:.6f},{y:.6f},{a:.8f}{tail}"
        for t, (x, y, a) in zip(track.stamp_s.tolist(), track.poses.tolist(), strict=True)
    ]
    path.write_text(header + "\n" + "\n".join(lines) + "\n")
