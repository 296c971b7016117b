import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from polemap.vehicle.discretize import van_loan
from polemap.vehicle.motion import arc_displacement, move_along_arc, sinc
from polemap.vehicle.pose import wrap_angle
from tests.vehicle.ctrv_arrays import (
    arc_jacobians,
    ctrv_jacobian,
    ctrv_process_noise,
    ctrv_step,
    sinc_slope,
)

turns = st.one_of(st.floats(-3.0, 3.0), st.sampled_from([0.0, 1e-12, -1e-12, 1e-7, 0.0499, 0.0501]))
yaws = st.floats(-3.1, 3.1)
distances = st.floats(-30.0, 30.0)


def integrated(x, y, yaw, distance, turn, steps=20000):
    """The arc by the midpoint rule: no sinc, no closed form."""
    middles = yaw + turn * (np.arange(steps) + 0.5) / steps
    piece = distance / steps
    return np.array([x + piece * np.cos(middles).sum(), y + piece * np.sin(middles).sum()])


@given(yaws, distances, turns)
def test_the_arc_is_the_integral_of_its_tangent(yaw, distance, turn):
    moved = move_along_arc([1.0, -2.0, yaw], distance, turn)
    assert np.allclose(moved[:2], integrated(1.0, -2.0, yaw, distance, turn), atol=1e-6)
    assert wrap_angle(moved[2] - yaw - turn) == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("turn", [0.0, 1e-12, -1e-12])
def test_a_straight_arc_is_exact(turn):
    moved = move_along_arc([0.0, 0.0, 0.3], 20.0, turn)
    assert np.allclose(moved[:2], [20.0 * math.cos(0.3), 20.0 * math.sin(0.3)], atol=3e-11, rtol=0)


@given(turns)
def test_sinc_and_its_slope_belong_together(h):
    step = 1e-6
    difference = (sinc(h + step) - sinc(h - step)) / (2 * step)
    assert float(sinc_slope(h)) == pytest.approx(float(difference), abs=2e-9)


def test_the_slope_has_no_step_where_series_and_quotient_meet():
    around = sinc_slope(np.array([0.05 - 1e-13, 0.05, 0.05 + 1e-13]))
    assert np.ptp(around) < 1e-13


@given(yaws, distances, turns)
def test_going_back_along_the_arc_returns(yaw, distance, turn):
    start = np.array([3.0, 4.0, yaw])
    back = move_along_arc(move_along_arc(start, distance, turn), -distance, -turn)
    assert np.allclose(back[:2], start[:2], atol=1e-10)
    assert wrap_angle(back[2] - yaw) == pytest.approx(0.0, abs=1e-12)


def finite_difference(function, at, step=1e-6):
    columns = []
    for i in range(len(at)):
        offset = np.zeros(len(at))
        offset[i] = step
        difference = function(at + offset) - function(at - offset)
        difference[2] = wrap_angle(difference[2])
        columns.append(difference / (2 * step))
    return np.stack(columns, axis=1)


@given(yaws, distances, turns, st.floats(-0.2, 0.2), st.floats(-1.0, 1.0))
def test_sideslip_turns_the_way_and_not_the_car(yaw, distance, turn, sideslip, left):
    plain = move_along_arc([1.0, 2.0, yaw + sideslip], distance, turn)
    slipped = move_along_arc([1.0, 2.0, yaw], distance, turn, sideslip)
    assert np.allclose(slipped[:2], plain[:2], atol=1e-11)
    assert wrap_angle(slipped[2] - yaw - turn) == pytest.approx(0.0, abs=1e-12)
    way = yaw + 0.5 * turn + sideslip
    aside = arc_displacement(yaw, distance, turn, sideslip, left) - (plain[:2] - [1.0, 2.0])
    assert np.allclose(aside, [-left * math.sin(way), left * math.cos(way)], atol=1e-11)


@given(yaws, distances, turns)
def test_arc_jacobians_equal_finite_differences(yaw, distance, turn):
    pose = np.array([1.0, 2.0, yaw])
    by_pose, by_input = arc_jacobians(pose, distance, turn)
    assert np.allclose(
        by_pose, finite_difference(lambda p: move_along_arc(p, distance, turn), pose), atol=1e-6
    )
    numeric = finite_difference(
        lambda u: move_along_arc(pose, u[0], u[1]), np.array([distance, turn])
    )
    assert np.allclose(by_input, numeric, atol=1e-6)


@given(yaws, st.floats(-20, 40), turns, st.sampled_from([0.01, 0.1, -0.05]))
def test_ctrv_jacobian_equals_finite_differences(yaw, speed, rate, dt):
    state = np.array([10.0, -5.0, yaw, speed, rate])
    for slip in (0.0, 0.006):
        numeric = finite_difference(lambda s, k=slip: ctrv_step(s, dt, k), state)
        assert np.allclose(ctrv_jacobian(state, dt, slip), numeric, atol=1e-6)


def test_many_states_at_once_equal_one_after_the_other():
    rng = np.random.default_rng(5)
    states = rng.normal(0.0, [30.0, 30.0, 1.0, 10.0, 0.5], (64, 5))
    dt = rng.uniform(0.0, 0.2, 64)
    noise = {"acceleration_m2ps3": 2.0, "yaw_acceleration_rad2ps3": 0.3, "lateral_m2ps": 0.01}
    stepped, jacobians = ctrv_step(states, dt), ctrv_jacobian(states, dt)
    noises = ctrv_process_noise(states, dt, **noise)
    for i, (state, step) in enumerate(zip(states, dt, strict=True)):
        assert np.allclose(stepped[i], ctrv_step(state, step), atol=1e-14, rtol=0)
        assert np.allclose(jacobians[i], ctrv_jacobian(state, step), atol=1e-14, rtol=0)
        assert np.allclose(noises[i], ctrv_process_noise(state, step, **noise), atol=1e-14)


@given(yaws, st.floats(0.0, 40.0), st.floats(0.001, 0.3))
def test_process_noise_on_a_straight_is_van_loans(yaw, speed, dt):
    state = np.array([0.0, 0.0, yaw, speed, 0.0])
    a = np.zeros((5, 5))
    a[0, 2], a[1, 2] = -speed * math.sin(yaw), speed * math.cos(yaw)
    a[0, 3], a[1, 3], a[2, 4] = math.cos(yaw), math.sin(yaw), 1.0
    density = np.diag([0.0, 0.0, 0.0, 2.0, 0.3])
    across = np.array([-math.sin(yaw), math.cos(yaw), 0.0, 0.0, 0.0])
    _, exact = van_loan(a, density, dt)
    ours = ctrv_process_noise(
        state, dt, acceleration_m2ps3=2.0, yaw_acceleration_rad2ps3=0.3, lateral_m2ps=0.02
    )
    assert np.allclose(ours - 0.02 * dt * np.outer(across, across), exact, rtol=1e-9, atol=1e-12)


@given(yaws, st.floats(-40.0, 40.0), turns, st.floats(0.0, 1.0))
def test_process_noise_is_positive_semi_definite(yaw, speed, rate, dt):
    q = ctrv_process_noise(
        np.array([0.0, 0.0, yaw, speed, rate]),
        dt,
        acceleration_m2ps3=2.0,
        yaw_acceleration_rad2ps3=0.3,
    )
    assert np.allclose(q, q.T, atol=0)
    assert np.linalg.eigvalsh(q).min() >= -1e-12 * max(1.0, np.abs(q).max())
