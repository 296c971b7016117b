"""Drives along a course, and run folders made of them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import yaml

from polemap.vehicle.pose import wrap_angle
from polemap.vehicle.trajectory import Trajectory
from tests.courses import (
    Course,
    Driven,
    shifted,
    smooth_noise,
    write_poses,
    write_run_folder,
    write_table,
)


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
        epsg: int | None = None,
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
            "frame": (
                {"kind": "utm", "epsg": epsg} if epsg else {"kind": "local", "name": "test_plane"}
            ),
            "vehicle": {"wheelbase_m": 2.7},
            "type": "test course",
        }
        if notes:
            head["notes"] = list(notes)
        (drive / "drive.yaml").write_text(yaml.safe_dump(head, sort_keys=False))
        count = len(truth)
        drift = smooth_noise(rng, count, reference_sd, 20.0 * 60.0)
        reference = shifted(truth, drift)
        write_poses(drive / "reference.csv", reference, ",0.3", "sd_m")
        if with_truth:
            write_poses(drive / "truth.csv", truth)
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
        write_table(
            folder / "odometry.csv", "stamp_s,speed_mps,yaw_rate_radps", truth.stamp_s, speed, rate
        )
        fixes = truth.poses[::20, :2] + rng.normal(0.0, 1.0, (len(truth.poses[::20]), 2))
        hdop = np.ones(len(fixes))
        write_table(
            folder / "gnss.csv", "stamp_s,east_m,north_m,hdop", truth.stamp_s[::20], *fixes.T, hdop
        )
        write_poses(folder / "reference.csv", truth, ",0.02", "sd_m")
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
        write_table(folder / "poles.csv", names, *np.array(seen).T)
        write_table(folder / "scans.csv", "stamp_s", truth.stamp_s[::2])
        write_table(folder.with_suffix(".csv"), "east_m,north_m", *poles.T)
        return folder

    return make
