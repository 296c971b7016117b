"""Each setting that takes a departure from the printed method back does so."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from polemap.drivelog.detections import pole_detections
from polemap.drivelog.samples import GnssFix
from polemap.localize.config import LocalizeConfig
from polemap.localize.gnss.outlier_mixture import GnssReceiver
from polemap.localize.gnss.particle_weights import FixWeights
from polemap.localize.odometry_history import OdometryHistory
from polemap.localize.odometry_watch import OdometryWatch
from polemap.localize.output_filter.config import OutputConfig
from polemap.localize.output_filter.limiter import OutputLimiter
from polemap.localize.output_filter.state import FilterState
from polemap.localize.particle_filter.particles import ParticleSet
from polemap.localize.particle_filter.pole_weigher import PoleWeigher, counted_share
from polemap.vehicle.packed import pack, unpack
from tests.localize.output_events import city_drive, run, started_with_odometry
from tests.localize.streets import street


def with_poles(**settings: object) -> LocalizeConfig:
    return LocalizeConfig.model_validate({"poles": settings})


@pytest.mark.parametrize("lateral_m", [2.0, 30.0])
def test_poses_that_fail_the_gate_are_ignored_until_they_pass(lateral_m) -> None:
    decisions = []
    output = started_with_odometry(OutputConfig(failed_gate="ignore"))
    for step in range(1, 100):
        stamp_s = 2.0 + 0.05 * step
        output.add_odometry(stamp_s, 10.0, 0.0)
        pose = np.array([10.0 * stamp_s, lateral_m, 0.0])
        output.add_pose(stamp_s + 1e-6, pose, np.diag([0.01, 0.01, 1e-4]))
        decisions.append(output.newest.decision)
    # the near ones pass once dead reckoning has become uncertain by as much
    passed = {"ignored", "accepted"} if lateral_m < 10.0 else {"ignored"}
    assert set(decisions[20:]) == passed
    assert set(decisions[:20]) == {"ignored"}
    counts = output.newest.counts
    assert counts.inflations == counts.reinitializations == counts.takeovers == 0


def test_five_states_learn_nothing_of_the_odometry() -> None:
    drive = city_drive(3, duration_s=10.0)
    _, means, _, output = run(drive, OutputConfig(learn_odometry=False))
    assert np.abs(means[:, 5:7]).max() < 1e-9
    assert np.abs(unpack(output.newest.upper)[5:7]).max() < 1e-12
    assert np.abs(run(drive, OutputConfig())[1][:, 5]).max() > 1e-4


def test_without_a_floor_a_pose_is_as_sure_as_it_says() -> None:
    spread = [
        unpack(started_with_odometry(OutputConfig(pose_floor=floor), 0.0).newest.upper)[0, 0]
        for floor in (True, False)
    ]
    assert spread == pytest.approx([0.01 + 0.03**2, 0.01])


def test_an_output_without_limit_is_the_filters_pose_at_once() -> None:
    limiter = OutputLimiter(limited=False)
    start = FilterState(0.0, (0.0,) * 3 + (10.0,) + (0.0,) * 5, pack(0.01 * np.eye(9)))
    limiter.limit(start)
    moved = start._replace(stamp_s=0.01, mean=(5.0, 3.0, 0.2, 10.0, 0.0, 0.0, 0.0, 0.0, 0.0))
    answer = limiter.limit(moved)
    assert answer.pose == (5.0, 3.0, 0.2)
    assert answer.flag == ""


def test_odometry_that_is_never_doubted() -> None:
    for doubts in (True, False):
        watch = OdometryWatch(doubts=doubts)
        for k in range(20):
            watch.check(0.02 * k, 10.0, 0.0)
        held = watch.check(0.4, 0.0, 0.0)
        watch.contradict(0.42)
        assert (held is not None) == (watch.held is not None) == doubts


def test_fixes_that_do_not_weigh_still_say_how_far_they_are() -> None:
    fixes = FixWeights(GnssReceiver(), weigh=False)
    history, poses = OdometryHistory(0.0), np.zeros((5, 3))
    for stamp_s in (0.0, 1.0):
        fixes.add_fix(GnssFix(stamp_s, stamp_s, 50.0, 0.0, 1.0))
        weights = fixes.weigh_by_fixes(np.zeros(5), poses, stamp_s, history)
    assert np.array_equal(weights, np.zeros(5))
    assert fixes.information_per_m2 == 0.0
    distance = fixes.distance_sd(np.zeros(3), np.zeros((3, 3)))
    assert distance is not None
    assert distance > 10.0


def test_exact_map_poles_that_all_exist() -> None:
    world = street(np.random.default_rng(0), 50, 20.0)
    world = replace(world, existence=np.full(len(world), 0.5))
    scan = pole_detections(0.0, 0.0, np.array([[5.0, 1.0]]), np.array([0.01 * np.eye(2)]),
                           probability=np.array([0.3]))  # fmt: skip
    found = {
        exact: PoleWeigher(world, with_poles(map_covariance=not exact, existence=not exact)).near(
            np.zeros((1, 3)), scan
        )
        for exact in (True, False)
    }
    assert found[False].covariance_m2[:, :2].min() > 0.0
    assert found[False].detection == pytest.approx(0.35)
    assert found[True].covariance_m2.max() == 0.0
    assert found[True].detection == pytest.approx(0.7)


def test_a_seen_pole_counts_whatever_its_probability_if_all_exist() -> None:
    world = street(np.random.default_rng(0), 50, 20.0)
    points = world.points_m[:1]
    values = []
    for existence in (True, False):
        weigher = PoleWeigher(world, with_poles(existence=existence))
        scans = [
            pole_detections(0.0, 0.0, points, np.array([0.01 * np.eye(2)]),
                            probability=np.array([share]))
            for share in (0.1, 1.0)
        ]  # fmt: skip
        low, high = (weigher.weigh(np.zeros((1, 3)), s).log_likelihood[0] for s in scans)
        values.append(high - low)
    assert values[0] == pytest.approx(np.log(10.0))
    assert values[1] == 0.0


def test_independent_scans_count_in_full() -> None:
    assert counted_share(0.1, 0.05, with_poles().poles) == pytest.approx(0.05)
    assert counted_share(0.1, 0.05, with_poles(scan_errors="independent").poles) == 1.0


def test_particles_without_slip_have_none() -> None:
    odometry = {"slip_rad_per_mps2": 0.0, "slip_sd_rad_per_mps2": 0.0}
    config = LocalizeConfig.model_validate({"odometry": odometry})
    particles = ParticleSet(config, 2.7, np.random.default_rng(0))
    particles.place_all(np.zeros((100, 3)), np.zeros(100))
    particles.resample_by_weight(1.0)
    assert particles.slip_rad_per_mps2 == 0.0
