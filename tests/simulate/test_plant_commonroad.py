"""The plant against the single-track model of commonroad-vehicle-models, where they overlap.

Both are driven through the same small sine of steering at constant speed. There the tyres are
linear and the load transfer small, so the two models describe the same car.
"""

from __future__ import annotations

import numpy as np
from scipy.integrate import solve_ivp
from vehiclemodels.parameters_vehicle2 import parameters_vehicle2
from vehiclemodels.vehicle_dynamics_st import vehicle_dynamics_st

from polemap.simulate.plant import GRAVITY_MPS2, Plant, PlantInput, PlantParameters

SPEED_MPS, STEER_RAD, PERIOD_S, SECONDS = 15.0, 0.002, 2.0, 4.0


def _steer(time_s: float) -> float:
    return STEER_RAD * np.sin(2 * np.pi * time_s / PERIOD_S)


def _commonroad() -> tuple[np.ndarray, np.ndarray]:
    """Yaw rate and side-slip at 100 Hz."""
    car = parameters_vehicle2()

    def slope(time_s: float, x: np.ndarray) -> list[float]:
        rate = STEER_RAD * 2 * np.pi / PERIOD_S * np.cos(2 * np.pi * time_s / PERIOD_S)
        return list(vehicle_dynamics_st(list(x), [rate, 0.0], car))

    times = np.arange(0, SECONDS, 0.01)
    start = [0, 0, 0, SPEED_MPS, 0, 0, 0]
    run = solve_ivp(slope, (0, SECONDS), start, t_eval=times, rtol=1e-9, atol=1e-11)
    return run.y[5], run.y[6]


def _plant() -> tuple[np.ndarray, np.ndarray]:
    car = parameters_vehicle2()
    # axle force of the single-track model: mu C_S F_z alpha, with C_S = -p_ky1 / p_dy1
    per_load = -car.tire.p_ky1 / car.tire.p_dy1 * 1.0489 / 2.0
    length = car.a + car.b
    plant = Plant(
        PlantParameters(
            mass_kg=car.m,
            yaw_inertia_kgm2=car.I_z,
            front_m=car.a,
            rear_m=car.b,
            track_m=car.T_f,
            height_m=car.h_cg,
            wheel_radius_m=car.R_w,
            wheel_inertia_kgm2=car.I_y_w,
            cornering_front_n=per_load * car.m * GRAVITY_MPS2 * car.b / length,
            cornering_rear_n=per_load * car.m * GRAVITY_MPS2 * car.a / length,
            slip_stiffness_n=60000.0,
            torque_limit_nm=2000.0,
            steer_lag_s=0.0,
            drag_n_per_mps2=0.0,
            rolling_coefficient=0.0,
        ),
        lambda _east, _north: 1.0489,
    )
    state, yaw_rate, sideslip = plant.rolling(SPEED_MPS), [], []
    for k in range(round(SECONDS * 1000)):
        if k % 10 == 0:
            yaw_rate.append(state.yaw_rate_radps)
            sideslip.append(state.sideslip_rad())
        hold = 3000.0 * (SPEED_MPS - state.vx_mps)
        state = plant.step(state, PlantInput(_steer(k * 0.001), (0.0, 0.0, hold, hold)))
    return np.array(yaw_rate), np.array(sideslip)


def test_a_small_sine_of_steering_moves_both_cars_alike() -> None:
    (yaw_rate, sideslip), (other_rate, other_slip) = _plant(), _commonroad()
    # what is left: the discrete step, and the brush tyre that bends from the first degree on
    assert np.abs(yaw_rate - other_rate).max() <= 0.02 * np.abs(other_rate).max()
    assert np.abs(sideslip - other_slip).max() <= 0.03 * np.abs(other_slip).max()
