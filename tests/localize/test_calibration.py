"""What the odometry gets wrong is learned: offsets at standstill and while driving, scales."""

from __future__ import annotations

import numpy as np
import pytest

from polemap.drivelog.samples import OdometrySample
from polemap.localize.calibration import OdometryCalibration
from polemap.localize.config import OdometryConfig
from polemap.vehicle.motion import move_along_arc


def stand(
    calibration: OdometryCalibration, rate: float, seconds: float, rng: np.random.Generator
) -> OdometrySample:
    for k in range(int(50 * seconds)):
        measured = rate + 0.002 * rng.standard_normal()
        last = calibration.correct(OdometrySample(0.02 * k, 0.02 * k, 0.0, measured))
    return last


def drive(
    calibration: OdometryCalibration,
    rng: np.random.Generator,
    *,
    seconds: float = 300.0,
    scale: float = 1.0,
    offset: float = 0.0,
    curvature: float = 0.0,
    pose_sd: float = 0.05,
) -> None:
    """Odometry measures (true / scale) and the filter's poses scatter around the truth."""
    pose = np.zeros(3)
    covariance = np.diag([pose_sd**2, pose_sd**2, 0.003**2])
    for k in range(int(50 * seconds)):
        t = 0.02 * k
        speed = 8.0 + 2.0 * np.sin(t / 7)
        rate = 0.15 * np.sin(t / 5)
        pose = move_along_arc(pose, speed * 0.02, rate * 0.02)
        measured_speed = speed / (1 + scale - 1)
        measured = rate + offset - curvature * measured_speed + 0.002 * rng.standard_normal()
        calibration.correct(OdometrySample(t, t, measured_speed, measured))
        if k % 5 == 4:
            seen = pose + rng.normal(0, [pose_sd, pose_sd, 0.003])
            calibration.learn_from_pose(t, seen, covariance)


def test_the_offset_is_learned_at_standstill() -> None:
    calibration = OdometryCalibration(OdometryConfig())
    last = stand(calibration, 0.004, 20.0, np.random.default_rng(0))
    # half of 20 s at 50 Hz counts, and the white noise that is assumed is 0.005 rad/s
    assert calibration.correction.yaw_rate_offset_radps == pytest.approx(
        0.004, abs=5 * 0.005 / np.sqrt(450)
    )
    assert (last.speed_mps, last.yaw_rate_radps) == (0.0, 0.0)


def test_a_turntable_is_no_standstill() -> None:
    calibration = OdometryCalibration(OdometryConfig())
    stand(calibration, 0.3, 20.0, np.random.default_rng(0))
    assert calibration.correction.yaw_rate_offset_radps == 0.0
    rng = np.random.default_rng(1)
    for k in range(1000):
        calibration.correct(OdometrySample(0.02 * k, 0.02 * k, 0.0, 0.2 * rng.standard_normal()))
    assert calibration.correction.yaw_rate_offset_radps == 0.0


def test_short_stops_teach_nothing() -> None:
    calibration = OdometryCalibration(OdometryConfig())
    for k in range(2000):
        speed = 0.0 if k % 75 < 50 else 2.0  # one second of standstill at a time
        calibration.correct(OdometrySample(0.02 * k, 0.02 * k, speed, 0.01))
    assert calibration.correction.yaw_rate_offset_radps == 0.0


@pytest.mark.parametrize("seed", range(3))
def test_scale_and_curvature_are_learned_on_the_way(seed: int) -> None:
    calibration = OdometryCalibration(OdometryConfig())
    drive(calibration, np.random.default_rng(seed), scale=1.03, curvature=0.0015)
    assert calibration.correction.speed_scale == pytest.approx(0.03, abs=0.006)
    corrected = calibration.correct(OdometrySample(301.0, 301.0, 8.0, 0.0))
    # offset and curvature look alike at one speed: what counts is their sum
    assert corrected.yaw_rate_radps == pytest.approx(0.0015 * 8.0, abs=0.0015)


def test_right_odometry_stays_as_it_is() -> None:
    calibration = OdometryCalibration(OdometryConfig())
    drive(calibration, np.random.default_rng(5))
    corrected = calibration.correct(OdometrySample(301.0, 301.0, 8.0, 0.05))
    assert corrected.speed_mps == pytest.approx(8.0, rel=0.006)
    assert corrected.yaw_rate_radps == pytest.approx(0.05, abs=0.0015)


def test_late_and_doubled_samples_are_not_counted_twice() -> None:
    """A car at 10 m/s whose odometry is right; one sample in 25 comes again, after its next."""
    calibration = OdometryCalibration(OdometryConfig())
    for k in range(5000):
        t = 0.02 * k
        for stamp in (t, t - 0.02) if k % 25 == 24 else (t,):
            calibration.correct(OdometrySample(stamp, t, 10.0, 0.0))
        calibration.learn_from_pose(t, np.array([10.0 * t, 0.0, 0.0]), np.eye(3) * 1e-4)
    assert calibration.correction.speed_scale == pytest.approx(0.0, abs=1e-6)


def test_poses_that_are_not_trusted_teach_nothing() -> None:
    calibration = OdometryCalibration(OdometryConfig())
    for k in range(5000):
        t = 0.02 * k
        calibration.correct(OdometrySample(t, t, 10.0, 0.0))
        calibration.learn_from_pose(t, np.array([20.0 * t, 0.0, 0.0]), np.eye(3) * 1e-4)
        calibration.interrupt()
    assert calibration.correction.speed_scale == 0.0


def test_a_stretch_runs_over_a_gap_without_poles() -> None:
    """Poles hold the pose for a second in every four: never for the 20 m of a stretch."""
    calibration = OdometryCalibration(OdometryConfig())
    before, _ = calibration.uncertainty(10.0, 0.0)
    for k in range(3000):
        t = 0.02 * k
        calibration.correct(OdometrySample(t, t, 10.0, 0.0))
        if k % 200 < 50 and k % 5 == 0:
            calibration.learn_from_pose(t, np.array([10.2 * t, 0.0, 0.0]), np.eye(3) * 1e-4)
    after, _ = calibration.uncertainty(10.0, 0.0)
    assert calibration.correction.speed_scale == pytest.approx(0.02, abs=3.0 * after)
    assert after < 0.3 * before


def test_learning_can_be_switched_off() -> None:
    calibration = OdometryCalibration(OdometryConfig(learn_offsets=False))
    drive(calibration, np.random.default_rng(0), seconds=60.0, scale=1.1)
    sample = OdometrySample(61.0, 61.0, 8.0, 0.05)
    assert calibration.correct(sample) == sample


def test_poses_of_late_scans_belong_to_their_own_moment() -> None:
    """A car that speeds up and brakes; its scans come 0.2 s after their pictures were taken."""
    calibration = OdometryCalibration(OdometryConfig())
    late = 10
    way = [0.0]
    for k in range(10_000):
        t = 0.02 * k
        speed = 6.0 + 5.0 * np.sin(t / 4.0)
        calibration.correct(OdometrySample(t, t, speed, 0.0))
        way.append(way[-1] + 0.02 * speed)
        if k > late:
            pose = np.array([way[k - late], 0.0, 0.0])
            calibration.learn_from_pose(t - 0.02 * late, pose, np.eye(3) * 1e-4)
    # summed over a wrong 0.2 s, stretches of 20 m would be up to a metre too long or too short
    assert calibration.correction.speed_scale == pytest.approx(0.0, abs=1e-3)
