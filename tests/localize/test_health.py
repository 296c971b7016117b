"""The whole localizer on drives whose odometry, poles or fixes lie: right, or it says so."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from polemap.drivelog.detections import Detections
from polemap.localize.config import LocalizeConfig
from polemap.localize.localizer import Localizer
from polemap.localize.replay import Run, replay
from polemap.simulate.config import DetectorConfig
from polemap.simulate.points.drive import PointDrive, PointScenario, gnss, simulate_points
from polemap.simulate.points.motion import GivenPoses

FEW = LocalizeConfig(particles=300)


def circling(seconds: float, seed: int = 0) -> PointDrive:
    """A circle of 40 m radius at 8 m/s among poles on all sides."""
    angle = 0.02 * np.arange(round(seconds * 10) + 2)
    poses = np.column_stack([40.0 * np.cos(angle), 40.0 * np.sin(angle), angle + np.pi / 2])
    poses[:, 2] = np.mod(poses[:, 2] + np.pi, 2.0 * np.pi) - np.pi
    scenario = PointScenario(
        duration_s=seconds, motion=GivenPoses(poses), pole_spacing_m=None, poles_per_m2=0.01,
        gnss=gnss(2.0), detector=DetectorConfig(rate_hz=8.0, half_view_rad=0.7),
    )  # fmt: skip
    return simulate_points(scenario, np.random.default_rng(seed))


def localized(points: PointDrive, speed=lambda t, v: v, rate=lambda t, w: w, keep=None) -> Run:
    """A replay with the odometry changed, and only the samples of `keep` (by stamp)."""
    odometry = points.drive.odometry
    assert odometry is not None
    odometry = replace(
        odometry,
        speed_mps=speed(odometry.stamp_s, odometry.speed_mps),
        yaw_rate_radps=rate(odometry.stamp_s, odometry.yaw_rate_radps),
    )
    if keep is not None:
        odometry = odometry.take(keep(odometry.stamp_s))
    drive = replace(points.drive, odometry=odometry)
    return replay(drive, points.pole_map, points.scans, FEW, seed=1)


def during(from_s, seconds, change):
    return lambda t, v: np.where((t >= from_s) & (t < from_s + seconds), change(v), v)


def silently_wrong_s(points: PointDrive, run: Run) -> float:
    """Longest time healthy while more than 0.5 m and three stated deviations off."""
    longest = 0.0
    healthy = np.array([not reason for reason in run.distrust])
    filters = [(run.kf, healthy)]
    pf = {u.estimate.stamp_s: u.estimate.healthy for u in run.updates}
    filters.append((run.pf, np.array([pf[t] for t in run.pf.stamp_s.tolist()])))
    for track, said in filters:
        assert track.covariance is not None
        error = np.hypot(*(track.poses[:, :2] - points.motion.at(track.stamp_s)[:, :2]).T)
        sd = np.sqrt(np.linalg.eigvalsh(track.covariance[:, :2, :2])[:, 1])
        since = None
        wrong = (error > 0.5) & (error > 3.0 * sd) & said
        for stamp, bad in zip(track.stamp_s, wrong, strict=True):
            since = (stamp if since is None else since) if bad else None
            longest = max(longest, stamp - since) if since is not None else longest
    return longest


def is_back(points: PointDrive, run: Run) -> bool:
    error = np.hypot(*(run.kf.poses[-1] - points.motion.at(run.kf.stamp_s[-1])[0])[:2])
    return bool(error < 0.3) and not run.distrust[-1]


@pytest.mark.parametrize("factor", [0.0, 1.3, 1.8])
@pytest.mark.parametrize("seconds", [0.1, 2.0])
def test_a_wheel_that_slips_or_locks_leads_nobody_away(factor: float, seconds: float) -> None:
    points = circling(20.0)
    run = localized(points, during(9.0, seconds, lambda v: factor * v))
    assert silently_wrong_s(points, run) <= 1.0
    assert is_back(points, run)
    assert run.counts["odometry_doubted"] == pytest.approx(50 * seconds, abs=2)
    assert "odometry_doubted" in run.distrust
    assert abs(run.updates[-1].estimate.health.yaw_rate_offset_radps) < 0.005


def test_a_silent_odometry_is_said_and_outlived() -> None:
    points = circling(20.0)
    run = localized(points, keep=lambda t: (t < 8.0) | (t >= 13.0))
    assert silently_wrong_s(points, run) <= 1.0
    assert is_back(points, run)
    silent = (run.kf.stamp_s > 8.6) & (run.kf.stamp_s < 13.0)
    assert all(np.array(run.distrust)[silent] != "")


def test_a_yaw_rate_of_the_other_sign_is_never_believed() -> None:
    points = circling(20.0)
    run = localized(points, rate=during(9.0, 4.0, lambda w: -w))
    assert silently_wrong_s(points, run) <= 1.0
    assert is_back(points, run)


def test_a_clean_drive_raises_no_alarm() -> None:
    for seed in range(3):
        points = circling(20.0, seed)
        run = localized(points)
        assert run.counts["odometry_doubted"] == 0
        begun = run.kf.stamp_s > 8.0
        assert np.mean([not r for r in np.array(run.distrust)[begun]]) > 0.97


@pytest.mark.parametrize("looks", [True, False])
def test_poles_after_minutes_without_any_bring_it_back(looks: bool) -> None:
    points = circling(120.0)
    localizer = Localizer(points.pole_map, FEW, 2.7, np.random.default_rng(0))
    nothing = np.empty(0, dtype=np.int64)
    back_s = np.inf
    for sample in points.samples:
        if isinstance(sample, Detections) and 15.0 < sample.stamp_s < 100.0:
            if not looks:
                continue
            sample = sample.take(nothing)
        localizer.add_sample(sample)
        if sample.arrival_s > 100.0:
            answer = localizer.pose_at(sample.arrival_s)
            assert answer is not None
            truth = points.motion.at(answer.stamp_s)[0]
            right = answer.healthy and np.hypot(*(np.array(answer.pose) - truth)[:2]) < 0.5
            back_s = min(back_s, sample.arrival_s) if right else np.inf
    assert back_s < 110.0
    assert localizer.summary().get("pf_stale_restarts", 0) == (not looks)
