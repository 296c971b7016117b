"""The output filter: time per event, what latency costs, and consistency.

`run()` times it (for `python -m benchmarks`); `python -m benchmarks.localize.output_filter` also
prints the figures of docs/output_filter.md but those of faults
(`benchmarks.localize.output_filter_faults`).
"""

from __future__ import annotations

import math
import time
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.harness import show, summary
from polemap.evaluation.errors import nees, pose_errors
from polemap.localize.config import LocalizeConfig
from polemap.localize.output_filter.config import OutputConfig
from polemap.localize.output_filter.filter import OutputFilter
from polemap.localize.output_filter.noise_model import NoiseModel
from polemap.localize.replay import replay
from polemap.simulate.config import DetectorConfig
from polemap.simulate.points.drive import POSES_IN_CITY, STREWN_CITY, PointDrive, simulate_points
from polemap.simulate.points.motion import CityTraffic, WhiteAccelerations
from polemap.simulate.points.pose_source import PointPose, PoseSource
from polemap.vehicle.packed import unpack

Floats = NDArray[np.float64]
Event = tuple[float, int, Any]
CAR = NoiseModel()


def run() -> dict[str, dict[str, float]]:
    """Median and p95 of one odometry event, one late pose replayed over 110 ms, and one tick."""
    odometry: list[float] = []
    poses: list[float] = []
    ticks: list[float] = []
    for seed in range(3):
        drive = city_drive(seed, duration_s=20.0)
        output, tick = OutputFilter(OutputConfig()), 0
        for arrival, kind, sample in events_of(drive):
            while tick / 100 < arrival:
                if output.started:
                    begin = time.perf_counter()
                    output.predicted_to(tick / 100)
                    ticks.append(time.perf_counter() - begin)
                tick += 1
            begin = time.perf_counter()
            _give(output, kind, sample)
            spent = time.perf_counter() - begin
            if output.started:
                (poses if kind else odometry).append(spent)
    result = {}
    for name, values in (("odometry", odometry), ("late_pose_110ms", poses), ("tick", ticks)):
        result[f"output_filter.{name}"] = summary(values)
    odometry_ms = result["output_filter.odometry"]["median_ms"]
    late_ms = result["output_filter.late_pose_110ms"]["median_ms"]
    result["output_filter.late_pose_110ms"]["ratio_to_odometry"] = late_ms / odometry_ms
    return result


def latency(seeds: int = 20) -> dict[str, dict[str, float]]:
    """RMSE at 100 Hz with poses of 22 Hz, 110 ms late: replayed, at once, and delay ignored."""
    table: dict[str, list[list[float]]] = {"no latency": [], "110 ms late": [], "delay ignored": []}
    for seed in range(seeds):
        for name, late in (("no latency", 1e-6), ("110 ms late", 0.11), ("delay ignored", 0.11)):
            drive = city_drive(seed, duration_s=25.0, pose_source=PoseSource(latency_s=late))
            events = events_of(drive)
            if name == "delay ignored":
                events = [(a, k, replace(s, stamp_s=a) if k else s) for a, k, s in events]
            error, _ = _track(drive, events, OutputConfig(pose_errors="independent"))
            table[name].append([_rms(error[:, 0]), _rms(error[:, 1]), _rms(error[:, 2])])
    return {
        name: {
            "along_m": float(np.mean(rows, axis=0)[0]),
            "across_m": float(np.mean(rows, axis=0)[1]),
            "yaw_rad": float(np.mean(rows, axis=0)[2]),
            "position_m": float(np.mean([math.hypot(r[0], r[1]) for r in rows])),
            "sd_m": float(np.std([math.hypot(r[0], r[1]) for r in rows], ddof=1)),
        }
        for name, rows in table.items()
    }


def matched(seeds: int = 50) -> dict[str, dict[str, float]]:
    """NEES per degree of freedom where the filter's noise is the drive's: 22 Hz, 110 ms late."""
    config = OutputConfig(pose_errors="independent", yaw_rate_sd_radps=0.002)
    noise = NoiseModel(
        pose_floor_m=0.0, pose_floor_rad=0.0, acceleration_mps2=1.0,
        yaw_acceleration_radps2=0.1, slip_rad_per_mps2=0.0, speed_error_share=0.0,
        yaw_rate_error_radps=0.0, turn_error_share=0.0,
        speed_scale_sd=0.01, yaw_rate_offset_sd_radps=0.001, odometry_drift_s=1e6,
    )  # fmt: skip
    densities = noise.densities(2.5, 60.0)[:2]
    rows: dict[str, list[float]] = {"ctrv": [], "city": []}
    for seed in range(seeds):
        for name, motion in (
            ("ctrv", WhiteAccelerations(15.0, *densities)),
            ("city", CityTraffic(15.0)),
        ):
            drive = city_drive(seed, duration_s=15.0, motion=motion)
            _, values = _track(drive, events_of(drive), config, after_s=3.0, noise=noise)
            rows[name].append(float(values.mean() / 3))
    return {
        name: {"mean": float(np.mean(values)), "sd": float(np.std(values, ddof=1))}
        for name, values in rows.items()
    }


def consistency(seeds: int = 50, particles: int = 300) -> dict[str, dict[str, float]]:
    """NEES per degree of freedom behind the particle filter, 22 Hz and 110 ms, point-level street.

    The first eight seconds, in which the particle filter finds itself, are left out.
    """
    rows: dict[str, list[float]] = {"pf": [], "kf": [], "kf_independent": [], "rmse": []}
    lost = 0
    detector = STREWN_CITY.detector or DetectorConfig()
    scenario = replace(
        STREWN_CITY,
        poles_per_m2=0.012,
        detector=detector.model_copy(update={"rate_hz": 22.0}),
    )
    for seed in range(seeds):
        street = simulate_points(scenario, np.random.default_rng(seed))
        config = LocalizeConfig(particles=particles)
        done = replay(street.drive, street.pole_map, street.scans, config, seed=seed)
        pf_late = done.pf.stamp_s > 8.0
        kf_late = done.kf.stamp_s > 8.0
        pf_true = street.motion.at(done.pf.stamp_s[pf_late])
        kf_true = street.motion.at(done.kf.stamp_s[kf_late])
        error = pose_errors(done.kf.poses[kf_late], kf_true)
        distance = np.hypot(error[:, 0], error[:, 1])
        if np.median(distance) > 2.0:
            lost += 1
            continue
        rows["rmse"].append(_rms(distance))
        for name, true, late, path in (
            ("pf", pf_true, pf_late, done.pf),
            ("kf", kf_true, kf_late, done.kf),
        ):
            assert path.covariance is not None
            rows[name].append(
                float(np.nanmean(nees(path.poses[late], true, path.covariance[late])) / 3)
            )
        rows["kf_independent"].append(_independent_nees(done.updates, street, config))
    return {
        name: {
            "mean": float(np.mean(values)),
            "median": float(np.median(values)),
            "sd": float(np.std(values, ddof=1)),
        }
        for name, values in rows.items()
    } | {"lost": {"runs": float(lost), "of": float(seeds)}}


def _independent_nees(updates: Any, street: Any, config: LocalizeConfig) -> float:
    """What the NEES would be if each pose were taken as news."""
    events = odometry_events(street)
    for update in updates:
        estimate = update.estimate
        if estimate.healthy:
            pose = PointPose(estimate.stamp_s, update.taken_s, estimate.pose, estimate.covariance)
            events.append((update.taken_s, 1, pose))
    settings = config.output.model_copy(update={"pose_errors": "independent"})
    _, values = _track(street, sorted(events, key=lambda e: e[:2]), settings, after_s=8.0)
    return float(values.mean() / 3)


def city_drive(seed: int, **changes: Any) -> PointDrive:
    """A drive through a city with odometry, GNSS and poses; `changes` are the scenario's."""
    return simulate_points(replace(POSES_IN_CITY, **changes), np.random.default_rng(seed))


def odometry_events(drive: PointDrive) -> list[Event]:
    """Odometry by arrival: `(arrival, 0, sample)`."""
    stream = drive.drive.odometry
    samples = [stream.sample(row) for row in range(len(stream))] if stream is not None else []
    return [(sample.arrival_s, 0, sample) for sample in samples]


def events_of(drive: PointDrive) -> list[Event]:
    """Odometry (kind 0) and poses (kind 1) by arrival: `(arrival, kind, sample)`."""
    events = odometry_events(drive)
    events += [(pose.arrival_s, 1, pose) for pose in drive.poses]
    return sorted(events, key=lambda event: event[:2])


def _give(output: OutputFilter, kind: int, sample: Any) -> None:
    if kind == 0:
        output.add_odometry(sample.stamp_s, sample.speed_mps, sample.yaw_rate_radps)
    else:
        output.add_pose(sample.stamp_s, sample.pose, sample.covariance)


def _track(
    drive: PointDrive,
    events: list[Event],
    config: OutputConfig,
    *,
    after_s: float = 5.0,
    noise: NoiseModel = CAR,
) -> tuple[Floats, Floats]:
    """Errors and NEES at 100 Hz."""
    output, tick = OutputFilter(config, noise=noise), 0
    stamps, means, covariances = [], [], []
    for arrival, kind, sample in events:
        while tick / 100 < arrival:
            stamp = tick / 100
            tick += 1
            if output.started and stamp > after_s:
                state = output.predicted_to(stamp)
                stamps.append(stamp)
                means.append(state.mean[:3])
                covariances.append(unpack(state.upper)[:3, :3])
        _give(output, kind, sample)
    true = drive.motion.at(np.array(stamps))
    return (
        pose_errors(np.array(means), true),
        nees(np.array(means), true, np.array(covariances)),
    )


def _rms(values: Floats) -> float:
    return float(np.sqrt(np.mean(values**2)))


if __name__ == "__main__":
    show("time", run())
    show("latency, 20 seeds", latency())
    show("NEES per degree of freedom, matched noise, 50 seeds", matched())
    show("NEES per degree of freedom behind the particle filter, 50 seeds", consistency())
