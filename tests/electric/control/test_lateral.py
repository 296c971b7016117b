"""Lateral stability and body-slip control on the linear single-track model."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from polemap.electric.control.body_slip import (
    BodySlipController,
    FeedForwardSchedule,
    PiGains,
    distribute_torque,
    feed_forward_gain,
    place_pi,
)
from polemap.electric.control.lateral_stability import (
    GripGuard,
    LateralCommand,
    LateralLimits,
    LateralStabilityController,
    allocate,
    neutral_reference,
)
from polemap.vehicle.errors import VehicleError
from polemap.vehicle.io import load_car
from polemap.vehicle.single_track import lateral

COMS = load_car("coms")

# W14 Table I at 25 km/h
MASS, FRONT, REAR, CF, CR, INERTIA, SPEED = 380.0, 0.8, 0.6, 6000.0, 6000.0, 136.08, 25.0 / 3.6
A = np.array(
    [
        [
            -2 * (CF + CR) / (MASS * SPEED),
            -1 - 2 * (CF * FRONT - CR * REAR) / (MASS * SPEED**2),
        ],
        [
            -2 * (CF * FRONT - CR * REAR) / INERTIA,
            -2 * (CF * FRONT**2 + CR * REAR**2) / (INERTIA * SPEED),
        ],
    ]
)
B = np.array([[2 * CF / (MASS * SPEED), 0.0], [2 * CF * FRONT / INERTIA, 1 / INERTIA]])


def test_the_loop_is_decoupled_first_order_and_rejects_a_constant_disturbance() -> None:
    controller = LateralStabilityController((8.0, 12.0), LateralLimits(10.0, 1e6))
    reference, disturbance = np.array([0.02, 0.3]), np.array([0.4, -3.0])
    state, dt = np.zeros(2), 1e-4
    for _ in range(2000):
        u = controller.step(A, B, reference, state, disturbance)
        state = state + dt * (A @ state + B @ [u.steer_rad, u.yaw_moment_nm] + disturbance)
        assert not u.saturated
    expected = reference * (1 - np.exp(-np.array([8.0, 12.0]) * 0.2))
    np.testing.assert_allclose(state, expected, rtol=2e-3)


def test_without_rejection_the_disturbance_stays() -> None:
    controller = LateralStabilityController((8.0, 12.0), LateralLimits(10.0, 1e6))
    state, disturbance = np.zeros(2), np.array([0.4, -3.0])
    for _ in range(20000):
        u = controller.step(A, B, np.zeros(2), state, np.zeros(2))
        state = state + 1e-4 * (A @ state + B @ [u.steer_rad, u.yaw_moment_nm] + disturbance)
    np.testing.assert_allclose(state, disturbance / [8.0, 12.0], rtol=1e-3)


finite = st.floats(-5.0, 5.0)


@given(st.lists(finite, min_size=6, max_size=6))
# both inputs do the same; one does nothing
@example([-3.0, -3.0, -5.0, -5.0, 0.3, -0.2])
@example([-8.0, 1.0, 0.0, -5.0, 0.3, -0.2])
def test_allocation_is_the_best_command_within_the_limits(values: list[float]) -> None:
    b = np.array([[values[0] + 8.0, values[1]], [values[2], values[3] + 8.0]])
    wanted, limits = np.array(values[4:]) * 10, np.array([0.7, 1.3])
    command = allocate(b, wanted, limits, np.ones(2))
    assert (np.abs(command) <= limits + 1e-12).all()
    grid = np.stack(np.meshgrid(*(np.linspace(-v, v, 41) for v in limits)), -1).reshape(-1, 2)
    best = np.sum((grid @ b.T - wanted) ** 2, axis=1).min()
    assert np.sum((b @ command - wanted) ** 2) <= best + 1e-9


def test_saturation_is_reported_and_stays_within_the_limits() -> None:
    limits = LateralLimits(0.1, 372.7)
    u = LateralStabilityController((8.0, 12.0), limits).step(
        A, B, np.array([0.5, 3.0]), np.zeros(2), np.zeros(2)
    )
    assert u.saturated
    assert abs(u.steer_rad) <= 0.1
    assert abs(u.yaw_moment_nm) <= 372.7


def test_neutral_reference_is_the_steady_state_of_a_neutral_car() -> None:
    cf = CR * REAR / FRONT
    a = np.array(
        [
            [-2 * (cf + CR) / (MASS * SPEED), -1.0],
            [0.0, -2 * (cf * FRONT**2 + CR * REAR**2) / (INERTIA * SPEED)],
        ]
    )
    b = np.array([2 * cf / (MASS * SPEED), 2 * cf * FRONT / INERTIA])
    expected = np.linalg.solve(-a, b * 0.05)
    reference = neutral_reference(
        0.05, SPEED, mass_kg=MASS, front_m=FRONT, rear_m=REAR, rear_stiffness_n=CR
    )
    np.testing.assert_allclose(reference, expected, rtol=1e-9)


def test_feed_forward_is_the_published_closed_form() -> None:
    # errata.md, 2DOF slip control: -2652 N m / rad at 25 km/h for Table I
    assert feed_forward_gain(A, B) == pytest.approx(-2652.0, abs=0.5)


def test_pole_placement_puts_the_poles() -> None:
    gains = place_pi(A, B, 2 * np.pi)
    closed = np.zeros((3, 3))
    closed[:2, :2] = A
    closed[:2, 0] -= B[:, 1] * gains.proportional_nm_per_rad
    closed[:2, 2] = B[:, 1]
    closed[2, 0] = -gains.integral_nm_per_rads
    poles = np.sort(np.linalg.eigvals(closed).real)
    expected = np.sort([np.trace(A) + 4 * np.pi, -2 * np.pi, -2 * np.pi])
    np.testing.assert_allclose(poles, expected, rtol=1e-4)


def test_three_poles_at_two_hertz_are_refused() -> None:
    with pytest.raises(VehicleError, match="leave the third at"):
        place_pi(A, B, 2 * np.pi * 2.0)


def test_body_slip_integral_does_not_wind_up() -> None:
    controller = BodySlipController(0.0, PiGains(-1000.0, -50000.0), 100.0)
    for _ in range(5000):
        assert abs(controller.step(0.0, 0.5, 1e-3)) <= 100.0
    # the error turns round: the command leaves its limit within a few steps, not after 5 s
    turned = [controller.step(0.0, -0.05, 1e-3) for _ in range(60)]
    assert turned[-1] > 0.0


def test_torque_distribution_gives_the_moment_and_keeps_the_limits() -> None:
    car = {"mass_kg": MASS, "radius_m": 0.22, "rear_track_m": 0.82, "torque_limit_nm": 100.0}
    left, right = distribute_torque(200.0, 0.5, **car)
    assert (right - left) / 0.22 * 0.82 / 2 == pytest.approx(200.0)
    assert (left + right) / 0.22 == pytest.approx(MASS * 0.5)
    left, right = distribute_torque(1e4, 3.0, **car)
    assert (left, right) == (-100.0, 100.0)
    assert (right - left) / 0.22 * 0.82 / 2 == pytest.approx(372.7, abs=0.1)


@pytest.mark.parametrize("limits", [LateralLimits(0.0, 1.0), LateralLimits(1.0, -1.0)])
def test_refuses_impossible_limits(limits: LateralLimits) -> None:
    with pytest.raises(VehicleError, match="must be positive"):
        LateralStabilityController((1.0, 1.0), limits)


def test_the_guard_hands_back_what_the_wheels_cannot_carry_and_says_so() -> None:
    guard, asked = GripGuard(), LateralCommand(0.2, 300.0, False)
    assert guard.step(asked, 0.1, 0.05, 1e-3) == asked
    for _ in range(60):  # release takes 50 ms
        given = guard.step(asked, 0.1, -0.3, 1e-3)
    assert given == LateralCommand(0.1, 0.0, True)
    steps = 0
    while guard.step(asked, 0.1, 0.05, 1e-3).saturated:
        steps += 1
    assert steps == pytest.approx(1000, abs=2)  # the return takes a second


@pytest.mark.parametrize("kmh", [10.0, 20.0, 25.0, 40.0, 60.0])
def test_the_scheduled_feed_forward_is_the_dc_gain_of_each_speed(kmh: float) -> None:
    scheduled = FeedForwardSchedule(COMS)(kmh / 3.6)
    assert scheduled == pytest.approx(feed_forward_gain(*lateral(COMS, kmh / 3.6)), rel=1e-9)


def test_a_scheduled_feed_forward_takes_the_speed_of_each_step() -> None:
    controller = BodySlipController(FeedForwardSchedule(COMS), PiGains(0.0, 0.0), 1e6)
    at_25 = controller.step(0.01, 0.0, 1e-3, 25.0 / 3.6)
    assert at_25 == pytest.approx(-26.52, abs=0.01)
    assert controller.step(0.01, 0.0, 1e-3, 10.0 / 3.6) != at_25
    with pytest.raises(VehicleError, match="needs the speed"):
        controller.step(0.01, 0.0, 1e-3)
