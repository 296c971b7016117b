"""Motion of the particles: the statistics of the noise, and exact arcs from late odometry."""

from __future__ import annotations

import numpy as np
import pytest

from polemap.drivelog.samples import OdometrySample
from polemap.extras import kernel
from polemap.localize.config import LocalizeConfig
from polemap.localize.odometry_history import Arc, OdometryHistory
from polemap.localize.particle_filter import motion_model
from polemap.localize.particle_filter.motion_model import (
    noise_of_arc,
    sample_motion,
    tight_turn_sd,
)
from polemap.localize.particle_filter.odometry_faults import OdometryFaults
from polemap.localize.particle_filter.persistent_errors import KERNEL
from polemap.vehicle.motion import move_along_arc
from polemap.vehicle.pose import move_reference_point

SILENT = LocalizeConfig(
    alpha1_speed_mps=0,
    alpha1_relative=0,
    alpha2_yaw_rate_radps=0,
    alpha3_rotation_s=0,
    alpha4_rotation_rad=0,
    alpha5_slip_m_per_sqrt_m=0,
)


def circle(speed: float, yaw_rate: float, hz: float, until_s: float) -> OdometryHistory:
    history = OdometryHistory()
    for k in range(int(until_s * hz) + 1):
        assert history.append(OdometrySample(k / hz, k / hz, speed, yaw_rate))
    return history


def test_without_noise_the_front_axle_follows_the_arc() -> None:
    poses = np.array([[3.0, -2.0, 0.4], [100.0, 50.0, -3.0]])
    arcs = [Arc(0.1, 8.0, 0.3, 0.0), Arc(0.05, 7.0, 0.0, 0.0), Arc(0.1, -2.0, -0.4, 0.0)]
    moved = sample_motion(poses, arcs, 2.7, SILENT, np.random.default_rng(0))
    rear = move_reference_point(poses, -2.7)
    for arc in arcs:
        rear = move_along_arc(rear, arc.speed_mps * arc.dt_s, arc.yaw_rate_radps * arc.dt_s)
    expected = move_reference_point(rear, 2.7)
    np.testing.assert_allclose(moved[:, :2], expected[:, :2], atol=1e-12)
    np.testing.assert_allclose(np.cos(moved[:, 2]), np.cos(expected[:, 2]), atol=1e-12)


def test_the_rear_axle_slips_outward_as_much_as_each_particle_thinks() -> None:
    arcs = [Arc(0.1, 8.0, 0.3, 0.0), Arc(0.1, 8.0, 0.3, 0.0)]
    start = np.tile([3.0, -2.0, 0.4], (2, 1))
    slips = np.array([0.0, 0.006])
    moved = sample_motion(start, arcs, 2.7, SILENT, np.random.default_rng(0), slips)
    assert moved[0, 2] == moved[1, 2]
    aside = (moved[1] - moved[0])[:2] @ np.array([-np.sin(0.43), np.cos(0.43)])
    # a left turn at 2.4 m/s^2 carries it to the right: 1.6 m of way by 0.0144 rad
    assert aside == pytest.approx(-1.6 * 0.006 * 8.0 * 0.3, rel=1e-3)
    history = OdometryHistory(slip_rad_per_mps2=0.006)
    for k in range(3):
        history.append(OdometrySample(0.1 * k, 0.1 * k, 8.0, 0.3))
    odometry_pose = history.odometry_pose(0.2)
    rear = moved[1, :2] - 2.7 * np.array([np.cos(moved[1, 2]), np.sin(moved[1, 2])])
    begin = start[1, :2] - 2.7 * np.array([np.cos(0.4), np.sin(0.4)])
    assert np.hypot(*odometry_pose[:2]) == pytest.approx(np.hypot(*(rear - begin)), rel=1e-9)
    assert odometry_pose[2] == pytest.approx(moved[1, 2] - 0.4)


@pytest.mark.parametrize("pieces", [1, 4])
def test_spread_per_second_does_not_depend_on_the_length_of_the_arcs(pieces: int) -> None:
    config = LocalizeConfig(alpha5_slip_m_per_sqrt_m=0.02)
    n = 40_000
    arcs = [Arc(0.4 / pieces, 10.0, 0.05, 0.0)] * pieces
    moved = sample_motion(np.zeros((n, 3)), arcs, 2.7, config, np.random.default_rng(0))
    rear_x = moved[:, 0] - 2.7 * np.cos(moved[:, 2])
    speed_sd = np.hypot(config.alpha1_speed_mps, 10.0 * config.alpha1_relative)
    along = speed_sd * np.sqrt(0.02 * 0.4)
    turn = np.sqrt(
        config.alpha2_yaw_rate_radps**2 * 0.02 * 0.4
        + min(config.alpha3_rotation_s * 0.05, config.alpha4_rotation_rad) ** 2 * 0.4 / 0.02
    )
    tolerance = 5 / np.sqrt(2 * n) + 0.01  # 0.01: the arc turns a little
    assert rear_x.std() == pytest.approx(along, rel=tolerance)
    assert moved[:, 2].std() == pytest.approx(turn, rel=tolerance)
    if pieces == 1:
        # seen across its middle heading, a single arc shows the slip alone
        rear_y = moved[:, 1] - 2.7 * np.sin(moved[:, 2])
        half = 0.5 * moved[:, 2]
        across = -np.sin(0.01) * (rear_x - rear_x.mean()) + np.cos(0.01) * rear_y - 4.0 * half
        assert across.std() == pytest.approx(0.02 * np.sqrt(4.0), rel=0.1)


def test_rotation_noise_is_limited_and_a_standing_car_stays() -> None:
    config = LocalizeConfig()
    assert noise_of_arc(Arc(0.02, 5.0, 100.0, 0.0), config)[2] == config.alpha4_rotation_rad
    assert noise_of_arc(Arc(0.02, 5.0, 0.1, 0.0), config)[2] == pytest.approx(
        config.alpha3_rotation_s * 0.1
    )
    poses = np.random.default_rng(0).normal(size=(50, 3))
    # a tight turn is not as limited, and nothing learned on the road makes it less
    tight = tight_turn_sd(Arc(0.02, 2.0, 0.5, 0.0), config)
    assert tight == pytest.approx(1.4 * config.alpha3_rotation_s * 0.5)
    assert tight_turn_sd(Arc(0.02, 10.0, 0.5, 0.0), config) == pytest.approx(0.25 * tight)
    stood = sample_motion(poses, [Arc(1.0, 0.0, 0.0, 0.0)], 2.7, config, np.random.default_rng(1))
    np.testing.assert_allclose(stood, poses, atol=1e-12)


def test_a_gap_of_the_odometry_is_blind_from_half_a_second_on() -> None:
    history = OdometryHistory()
    for stamp in (0.0, 0.1, 2.1, 2.2):
        history.append(OdometrySample(stamp, stamp, 8.0, 0.0))
    assert sum(arc.blind_s for arc in history.arcs(0.0, 2.2, 10.0)) == pytest.approx(1.5)
    assert sum(arc.blind_s for arc in history.arcs(0.0, 0.1, 10.0)) == 0.0
    # beyond the newest sample its value holds as long as a gap may be, then it is blind
    assert sum(arc.blind_s for arc in history.arcs(2.2, 3.2, 10.0)) == pytest.approx(0.5)


def test_arcs_between_any_two_stamps_are_exact_on_a_circle() -> None:
    history = circle(6.0, 0.2, 50.0, 10.0)
    for start, end in ((0.0, 10.0), (1.2345, 1.2349), (3.001, 7.777), (9.5, 10.4)):
        arcs = history.arcs(start, end, 0.06)
        assert sum(arc.dt_s for arc in arcs) == pytest.approx(end - start)
        assert max(arc.dt_s for arc in arcs) <= 0.06 + 0.02 or end > 10.0
        moved = sample_motion(np.zeros((1, 3)), arcs, 0.0, SILENT, np.random.default_rng(0))[0]
        turn = 0.2 * (end - start)
        np.testing.assert_allclose(
            moved, [30 * np.sin(turn), 30 * (1 - np.cos(turn)), turn], atol=1e-9
        )
        a, b = history.odometry_pose(start), history.odometry_pose(end)
        assert b[2] - a[2] == pytest.approx(turn)
        assert np.hypot(*(b - a)[:2]) == pytest.approx(np.hypot(*moved[:2]), abs=1e-9)
        assert history.travelled_m(end) - history.travelled_m(start) == pytest.approx(
            6 * (end - start)
        )
    assert history.arcs(5.0, 5.0, 0.06) == []


def test_samples_that_cannot_be_used_are_refused() -> None:
    history = circle(1.0, 0.0, 10.0, 1.0)
    assert not history.append(OdometrySample(0.95, 1.1, 1.0, 0.0))
    assert not history.append(OdometrySample(1.0, 1.1, 1.0, 0.0))
    assert not history.append(OdometrySample(1.2, 1.2, float("nan"), 0.0))
    assert not history.append(OdometrySample(float("inf"), 1.2, 1.0, 0.0))
    assert history.append(OdometrySample(1.1, 1.1, 1.0, 0.0))
    empty = OdometryHistory()
    assert empty.rates_at(3.0) == (0.0, 0.0)
    np.testing.assert_array_equal(empty.odometry_pose(3.0), np.zeros(3))
    assert empty.arcs(0.0, 1.0, 1.0)[0].speed_mps == 0.0


def test_old_samples_are_forgotten_without_a_jump() -> None:
    history = circle(5.0, 0.0, 20.0, 400.0)
    assert len(history) < 200 * 20
    step = history.odometry_pose(400.0) - history.odometry_pose(350.0)
    np.testing.assert_allclose(step, [250.0, 0.0, 0.0], atol=1e-6)


def test_the_kernel_moves_particles_as_plain_numpy(monkeypatch: pytest.MonkeyPatch) -> None:
    native = kernel(KERNEL)
    if native is None:
        pytest.skip("the kernel was not built here")
    rng = np.random.default_rng(5)
    poses = rng.normal(0.0, [1e5, 1e6, 2.0], (300, 3))
    slips, faults = np.abs(rng.normal(0.0, 0.005, 300)), OdometryFaults(300, rng)
    for _ in range(20):
        faults.step(0.5, 3.0, 0.4)
    assert faults.faulty.any()
    arcs = [Arc(0.06, 9.0, 0.3, 0.0), Arc(0.02, 0.0, 0.0, 0.0), Arc(0.05, -2.0, 0.0, 0.0)]
    moved = []
    for one in (native, None):
        monkeypatch.setattr(
            motion_model,
            "kernel",
            {KERNEL: one}.get,
        )
        moved.append(
            sample_motion(
                poses, arcs, 2.7, LocalizeConfig(), np.random.default_rng(1), slips,
                (0.8, 1.2, 0.9), faults=faults,
            )
        )  # fmt: skip
    # the same bits where products and sums are not fused
    np.testing.assert_allclose(moved[0], moved[1], rtol=1e-14)
