"""Drives of points: repeatable, physically consistent, with errors of the size that is stated."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from polemap.drivelog.detections import Detections
from polemap.drivelog.samples import GnssFix, OdometrySample
from polemap.simulate.config import DetectorConfig
from polemap.simulate.detector import PoleDetector
from polemap.simulate.points.drive import PointScenario, simulate_points
from polemap.simulate.points.motion import (
    CityTraffic,
    GivenPoses,
    MotionModel,
    Slip,
    WhiteAccelerations,
    WindingRoad,
    put_ahead,
)
from polemap.simulate.points.poles import scattered_poles
from polemap.simulate.points.pose_source import PoseSource
from polemap.simulate.sensors import REFERENCES
from polemap.simulate.stream_faults import GnssDropout
from polemap.vehicle.pose import wrap_angle
from tests.polemap.town import town_poles, town_route

SHORT = PointScenario(duration_s=6.0)
MOTIONS = [WindingRoad(), CityTraffic(slip=Slip()), WhiteAccelerations(10.0, 1.0, 0.01)]


def test_the_same_generator_gives_the_same_drive() -> None:
    scenario = replace(SHORT, pose_source=PoseSource(jitter_s=0.02), reference=REFERENCES["good"])
    one, again, other = (
        simulate_points(scenario, np.random.default_rng(seed)) for seed in (4, 4, 5)
    )
    assert np.array_equal(one.motion.states, again.motion.states)
    assert np.array_equal(one.pole_map.points_m, again.pole_map.points_m)
    assert [repr(s) for s in one.samples] == [repr(s) for s in again.samples]
    assert repr(one.poses) == repr(again.poses)
    assert not np.array_equal(one.motion.states, other.motion.states)


@pytest.mark.parametrize("motion", MOTIONS, ids=lambda motion: type(motion).__name__)
def test_the_path_is_that_of_speed_yaw_rate_and_slip(motion: MotionModel) -> None:
    drawn = motion.drawn(5.0, np.random.default_rng(1))
    states, dt = drawn.states, np.diff(drawn.stamp_s)
    assert drawn.stamp_s[-1] >= 5.0
    step = np.diff(states[:, :2], axis=0)
    np.testing.assert_allclose(np.hypot(*step.T), np.abs(states[:-1, 3]) * dt, atol=1e-6)
    np.testing.assert_allclose(
        wrap_angle(np.diff(states[:, 2]) - states[:-1, 4] * dt), 0.0, atol=1e-12
    )
    moving = np.abs(states[:-1, 3]) > 1.0
    slip = wrap_angle(np.arctan2(step[:, 1], step[:, 0]) - states[:-1, 2])
    assert np.abs(slip[moving]).max() < 0.05


def test_a_car_on_given_poses_is_there_at_each_of_them() -> None:
    poses = town_route(np.array([1e5, 2e5]), 1)[:200]
    motion = GivenPoses(poses, 0.1).drawn(60.0, np.random.default_rng(0))
    assert len(motion.stamp_s) == 200
    np.testing.assert_allclose(motion.at(motion.stamp_s), poses, atol=1e-9)


def test_a_car_put_ahead_stays_on_its_path() -> None:
    motion = WindingRoad().drawn(40.0, np.random.default_rng(2))
    moved = put_ahead(motion, 10.0, 50.0)
    rows = np.flatnonzero(moved.stamp_s >= 10.0)
    at = np.searchsorted(motion.stamp_s, 10.0)
    way = np.hypot(*np.diff(motion.states[:, :2], axis=0).T)
    jump = int(np.flatnonzero((motion.states == moved.states[rows[0]]).all(axis=1))[0])
    assert way[at:jump].sum() == pytest.approx(50.0, abs=0.1)
    with pytest.raises(ValueError, match=r"no 1e\+06 m|no 1000000.0 m"):
        put_ahead(motion, 10.0, 1e6)


def test_sensors_err_as_much_as_stated() -> None:
    """200 drives: sd of a constant error known to 5 %, tolerances of four times that."""
    scales, biases, fixes = [], [], []
    for seed in range(200):
        scenario = replace(SHORT, duration_s=3.0, detector=None)
        drive = simulate_points(scenario, np.random.default_rng(seed))
        odometry, gnss = drive.drive.odometry, drive.drive.gnss
        assert odometry is not None
        assert gnss is not None
        true = drive.motion.states_at(odometry.stamp_s)
        scales.append(np.mean(odometry.speed_mps / true[:, 3]) - 1.0)
        biases.append(np.mean(odometry.yaw_rate_radps - true[:, 4]))
        fixes.append(
            np.array([gnss.east_m[0], gnss.north_m[0]]) - drive.motion.at(gnss.stamp_s)[0, :2]
        )
    assert np.std(scales) == pytest.approx(0.01, rel=0.2)
    assert np.std(biases) == pytest.approx(0.001, rel=0.2)
    assert np.std(fixes) == pytest.approx(np.hypot(2.5, 0.2), rel=0.2)


def test_poses_lie_where_their_covariance_says() -> None:
    scenario = replace(SHORT, duration_s=40.0, detector=None, pose_source=PoseSource())
    drive = simulate_points(scenario, np.random.default_rng(3))
    true = drive.motion.at(np.array([pose.stamp_s for pose in drive.poses]))
    squares = []
    for pose, at in zip(drive.poses, true, strict=True):
        off = pose.pose - at
        off[2] = wrap_angle(off[2])
        squares.append(off @ np.linalg.solve(pose.covariance, off) / 3)
        assert pose.arrival_s == pytest.approx(pose.stamp_s + 0.11)
    # chi-square with 3 degrees of freedom, divided by 3: variance 2 / 3
    assert np.mean(squares) == pytest.approx(1.0, abs=4 * np.sqrt(2 / 3 / len(squares)))


def test_a_scan_shows_poles_where_they_stand() -> None:
    drive = simulate_points(
        replace(SHORT, detector=DetectorConfig(clutter_share=0.0)), np.random.default_rng(6)
    )
    seen = 0
    for scan in drive.scans:
        pose = drive.motion.at(scan.stamp_s)[0]
        c, s = np.cos(pose[2]), np.sin(pose[2])
        world = scan.points_vehicle_m @ np.array([[c, s], [-s, c]]) + pose[:2]
        for point, covariance in zip(world, scan.covariance_m2, strict=True):
            gap = np.hypot(*(drive.poles.points_m - point).T).min()
            assert gap < 5 * np.sqrt(np.linalg.eigvalsh(covariance)[-1])
            seen += 1
    assert seen > 50


def test_errors_of_a_pole_last_as_long_as_stated() -> None:
    config = DetectorConfig(detected_share=1.0, clutter_share=0.0, correlated_share=1.0)
    lagged = {}
    for time_s in (np.inf, 0.3):
        detector = PoleDetector(
            np.array([[12.0, 1.0]]), np.array([0.2]), config, np.random.default_rng(1),
            error_time_s=time_s,
        )  # fmt: skip
        x = np.array(
            [detector.scan(0.1 * k, np.zeros(3)).points_vehicle_m[0, 0] for k in range(2000)]
        )
        x = x - 12.0
        lagged[time_s] = np.mean(x[3:] * x[:-3]) / np.mean(x * x)
    assert lagged[np.inf] == pytest.approx(1.0)
    # 2000 scans of 0.1 s hold about 300 independent ones
    assert lagged[0.3] == pytest.approx(np.exp(-1.0), abs=4 / np.sqrt(300))


def test_poles_that_cannot_be_seen_are_not() -> None:
    rng = np.random.default_rng(0)
    town = town_poles(np.zeros(2), 1, rng)
    hidden = replace(town, visibility=np.zeros(len(town)))
    scenario = replace(
        SHORT, motion=GivenPoses(town_route(np.zeros(2), 1)),
        detector=DetectorConfig(clutter_share=0.0),
    )  # fmt: skip
    assert sum(len(scan) for scan in simulate_points(scenario, rng, town).scans) > 20
    assert sum(len(scan) for scan in simulate_points(scenario, rng, hidden).scans) == 0


def test_works_in_the_streets_change_the_poles() -> None:
    town = town_poles(np.zeros(2), 1, np.random.default_rng(0))
    new = np.array([[500.0, 500.0]])
    after = town.changed(np.array([0, 1]), new, {2: np.array([0.0, 2.0])})
    assert len(after) == len(town) - 1
    np.testing.assert_array_equal(after.points_m[0], town.points_m[2] + [0.0, 2.0])
    np.testing.assert_array_equal(after.points_m[-1], new[0])


def test_strewn_poles_leave_the_path_free() -> None:
    poses = WindingRoad().drawn(20.0, np.random.default_rng(1)).states[::50, :3]
    poles = scattered_poles(poses, 0.01, np.random.default_rng(1))
    gap = np.hypot(*(poles.points_m[:, None] - poses[None, :, :2]).T).min()
    assert gap > 3.5


def test_samples_come_in_order_of_arrival_and_on_the_clock_of_the_drive() -> None:
    scenario = replace(
        SHORT, start_s=500.0, gnss_outage_s=(2.0, 3.0), reference=REFERENCES["good"],
        pose_source=PoseSource(),
    )  # fmt: skip
    drive = simulate_points(scenario, np.random.default_rng(0))
    arrivals = [sample.arrival_s for sample in drive.samples]  # type: ignore[union-attr]
    assert arrivals == sorted(arrivals)
    assert {type(sample) for sample in drive.samples} == {OdometrySample, GnssFix, Detections}
    assert 500.0 <= min(sample.stamp_s for sample in drive.samples) < 500.1
    assert drive.motion.stamp_s[0] == 500.0
    assert min(pose.stamp_s for pose in drive.poses) > 500.0
    assert drive.drive.reference is not None
    assert drive.drive.reference.stamp_s[0] == 500.0
    fixes = [s.stamp_s for s in drive.samples if isinstance(s, GnssFix)]
    assert not any(502.0 <= stamp <= 503.0 for stamp in fixes)


def test_faults_of_drives_work_on_drives_of_points() -> None:
    drive = simulate_points(SHORT, np.random.default_rng(0))
    broken = GnssDropout(from_s=2.0, until_s=4.0).apply(drive.drive, np.random.default_rng(0))
    assert broken.gnss is not None
    assert not ((broken.gnss.stamp_s >= 2.0) & (broken.gnss.stamp_s < 4.0)).any()
