"""The plant against closed forms: load balance, friction circle, steady cornering, coast-down."""

from __future__ import annotations

from dataclasses import replace
from math import hypot

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from polemap.drivelog.errors import ConfigError
from polemap.simulate.plant import (
    GRAVITY_MPS2,
    Plant,
    PlantInput,
    PlantParameters,
    PlantState,
    patches,
)
from polemap.vehicle.tyre import brush_force

CAR = PlantParameters(
    mass_kg=380.0,
    yaw_inertia_kgm2=136.08,
    front_m=0.8,
    rear_m=0.6,
    track_m=0.82,
    height_m=0.4,
    wheel_radius_m=0.22,
    wheel_inertia_kgm2=0.5,
    cornering_front_n=6000.0,
    cornering_rear_n=6000.0,
    slip_stiffness_n=9000.0,
    torque_limit_nm=100.0,
)

slips = st.floats(-2.0, 2.0)


@given(slips, slips, st.floats(10.0, 5000.0))
def test_tyre_never_leaves_the_friction_circle_and_opposes_the_slip(
    slip_x: float, slip_y: float, limit_n: float
) -> None:
    along, across = brush_force(slip_x, slip_y, 9000.0, 6000.0, limit_n)
    assert hypot(along, across) <= limit_n * (1 + 1e-12)
    assert along * slip_x >= 0.0
    assert across * slip_y <= 0.0


def test_tyre_is_linear_with_its_stiffness_at_small_slip() -> None:
    along, across = brush_force(1e-5, 0.0, 9000.0, 6000.0, 1000.0)
    assert along == pytest.approx(0.09, rel=1e-3)
    assert across == 0.0
    assert brush_force(0.0, 1e-5, 9000.0, 6000.0, 1000.0)[1] == pytest.approx(-0.06, rel=1e-3)


@given(st.floats(-3.0, 3.0), st.floats(-3.0, 3.0))
def test_loads_carry_the_car_and_balance_its_moments(ax: float, ay: float) -> None:
    fl, fr, rl, rr = Plant(CAR).wheel_loads_n(ax, ay)
    if min(fl, fr, rl, rr) == 0.0:
        return  # a lifted wheel ends the linear range
    assert fl + fr + rl + rr == pytest.approx(CAR.mass_kg * GRAVITY_MPS2)
    pitch = CAR.rear_m * (rl + rr) - CAR.front_m * (fl + fr)
    assert pitch == pytest.approx(CAR.mass_kg * ax * CAR.height_m, abs=1e-6)
    roll = (fr + rr - fl - rl) * CAR.track_m / 2.0
    assert roll == pytest.approx(CAR.mass_kg * ay * CAR.height_m, abs=1e-6)


def _settle(car: PlantParameters, speed_mps: float, steer_rad: float) -> PlantState:
    plant = Plant(car)
    state = plant.rolling(speed_mps)
    for _ in range(3000):
        hold = 500.0 * (speed_mps - state.vx_mps)
        state = plant.step(state, PlantInput(steer_rad, (0.0, 0.0, hold, hold)))
    return state


@pytest.mark.parametrize("speed_mps", [4.0, 7.0, 10.0])
def test_steady_cornering_equals_the_single_track_model_at_small_angles(speed_mps: float) -> None:
    steer = 0.002
    state = _settle(CAR, speed_mps, steer)
    m, lf, lr = CAR.mass_kg, CAR.front_m, CAR.rear_m
    cf, cr, v = CAR.cornering_front_n, CAR.cornering_rear_n, state.vx_mps
    k0, k1 = 2 * (cf + cr), 2 * (cf * lf - cr * lr)
    k2, inertia = 2 * (cf * lf**2 + cr * lr**2), CAR.yaw_inertia_kgm2
    a = np.array([[-k0 / (m * v), -1 - k1 / (m * v**2)], [-k1 / inertia, -k2 / (inertia * v)]])
    b = np.array([2 * cf / (m * v), 2 * cf * lf / inertia])
    sideslip, yaw_rate = np.linalg.solve(-a, b * steer)
    assert state.yaw_rate_radps == pytest.approx(yaw_rate, rel=0.03)
    assert state.vy_mps / state.vx_mps == pytest.approx(sideslip, rel=0.05, abs=2e-5)


def test_friction_bounds_the_lateral_acceleration() -> None:
    plant = Plant(CAR, lambda _east, _north: 0.3)
    state = plant.rolling(8.0)
    for _ in range(1500):
        state = plant.step(state, PlantInput(steer_rad=0.3))
        assert hypot(state.ax_mps2, state.ay_mps2) <= 0.3 * GRAVITY_MPS2 + 0.1


def test_a_pull_away_accelerates_by_the_motor_force_over_mass_and_spin() -> None:
    car = replace(CAR, drag_n_per_mps2=0.0, rolling_coefficient=0.0, height_m=0.0)
    plant = Plant(car)
    state = plant.rolling(3.0)
    for _ in range(1000):
        state = plant.step(state, PlantInput(torque_nm=(0.0, 0.0, 20.0, 20.0)))
    inertia = 4 * car.wheel_inertia_kgm2 / car.wheel_radius_m**2
    expected = 2 * 20.0 / car.wheel_radius_m / (car.mass_kg + inertia)
    # lag and slip cost a little of the first second
    assert state.vx_mps - 3.0 == pytest.approx(expected, rel=0.02)


def test_on_split_friction_the_driven_car_turns_to_the_gripping_side() -> None:
    plant = Plant(CAR, patches(0.8, [(0.0, 50.0, 0.1)], split=True))
    state = plant.rolling(3.0)
    for _ in range(500):
        state = plant.step(state, PlantInput(torque_nm=(0.0, 0.0, 90.0, 90.0)))
    # the right wheel spins on ice, the left one pushes: the nose goes right
    assert state.yaw_rate_radps < -0.05


def test_halving_the_step_changes_little() -> None:
    ends = []
    for step_s in (0.001, 0.0005):
        plant = Plant(CAR, step_s=step_s)
        state = plant.rolling(6.0)
        for k in range(round(1.5 / step_s)):
            steer = 0.05 * np.sin(2 * np.pi * k * step_s)
            state = plant.step(state, PlantInput(float(steer), (0.0, 0.0, 30.0, 30.0)))
        ends.append(np.array([state.east_m, state.north_m, state.yaw_rad, state.vx_mps]))
    np.testing.assert_allclose(ends[0], ends[1], atol=0.01)


@pytest.mark.parametrize(
    ("name", "value"), [("mass_kg", 0.0), ("front_m", -1.0), ("track_m", np.nan)]
)
def test_refuses_impossible_cars(name: str, value: float) -> None:
    with pytest.raises(ConfigError, match=f"plant {name} is"):
        replace(CAR, **{name: value})
