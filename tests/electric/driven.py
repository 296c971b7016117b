"""A car on brush tyres driven through bends near its limits, and what its sensors say of it."""

from __future__ import annotations

import numpy as np

from polemap.electric.signals import SignalLog
from polemap.vehicle.axles import GRAVITY_MPS2
from polemap.vehicle.parameters import Car
from polemap.vehicle.tyre import brush_force

STEP_S = 0.01


def driven(
    car: Car,
    seconds: float,
    *,
    seed: int = 0,
    lateral_mps2: float = 6.0,
    bank_mps2: float = 0.0,
    bank_rad: float = 0.0,
    grade_rad: float = 0.0,
    gyro_sd_radps: float = 0.003,
    ay_sd_mps2: float = 0.3,
) -> SignalLog:
    """Steering of several rhythms to `lateral_mps2`, gas and brake; reference of no error.

    The road leans by `bank_rad` and climbs by `grade_rad` up and down within 15 and 40 s; what the
    accelerometer shows is off by `bank_mps2` all the time.

    The plant is made of the tyre of the plant and Heun's rule, nothing of the models under test.
    """
    rng = np.random.default_rng(seed)
    t = STEP_S * np.arange(round(seconds / STEP_S))
    speed = 18.0 + 6.0 * np.sin(2 * np.pi * t / 23.0) + 2.0 * np.sin(2 * np.pi * t / 7.1)
    ax = np.gradient(speed, t)
    wave = 0.6 * np.sin(2 * np.pi * t / 9.0) + 0.4 * np.sin(2 * np.pi * t / 2.3 + 1.0)
    ramp = np.minimum(t / 5.0, 1.0)
    steering = ramp * wave * lateral_mps2 * (car.wheelbase_m + 0.004 * speed**2) / speed**2
    bank, grade = bank_of(t, bank_rad), grade_of(t, grade_rad)
    state, states, lateral = np.zeros(2), np.zeros((len(t), 2)), np.zeros(len(t))
    for k in range(len(t)):
        side = np.array([GRAVITY_MPS2 * bank[k], 0.0])
        first, lateral[k] = _rates(car, state, steering[k], speed[k], ax[k])
        first = first - side
        states[k] = state
        second, _ = _rates(car, state + STEP_S * first, steering[k], speed[k], ax[k])
        state = state + 0.5 * STEP_S * (first + second - side)
    vy, rate = states.T
    place = vy + car.sideslip_point_m * rate
    shown = steering / car.steering_scale + car.steering_offset_rad
    return SignalLog(
        t,
        {
            "road_wheel_angle_rad": shown,
            "yaw_rate_radps": rate + gyro_sd_radps * rng.standard_normal(len(t)),
            "ax_mps2": ax - rate * vy + GRAVITY_MPS2 * grade,
            "ay_mps2": lateral + bank_mps2 + ay_sd_mps2 * rng.standard_normal(len(t)),
            "vx_mps": speed,
            "sideslip_rad": np.arctan2(place, speed),
        },
    )


def bank_of(t: np.ndarray, size_rad: float) -> np.ndarray:
    """Bank of the road at each stamp, the left side higher."""
    return np.asarray(size_rad * np.sin(2 * np.pi * t / 15.0 + 0.7))


def grade_of(t: np.ndarray, size_rad: float) -> np.ndarray:
    """Grade of the road at each stamp, uphill positive."""
    return np.asarray(size_rad * np.sin(2 * np.pi * t / 40.0 + 0.4))


def _rates(
    car: Car, state: np.ndarray, steering: float, speed: float, ax: float
) -> tuple[np.ndarray, float]:
    """Rates of lateral speed and yaw rate, and the lateral acceleration."""
    vy, rate = state
    weight, length = car.mass_kg * GRAVITY_MPS2, car.wheelbase_m
    shift = car.mass_kg * car.cg_height_m * ax / length
    loads = (
        weight * car.cg_to_rear_m / length - shift,
        weight * car.cg_to_front_m / length + shift,
    )
    rest = (weight * car.cg_to_rear_m / length, weight * car.cg_to_front_m / length)
    along = car.mass_kg * ax
    front_along = along * (car.front_brake_share if along < 0.0 else car.front_drive_share)
    forces = []
    for slip, c, mu, load, still, fx in zip(
        (
            (vy + car.cg_to_front_m * rate) / speed - steering,
            (vy - car.cg_to_rear_m * rate) / speed,
        ),
        (
            2 * (car.front_slip_stiffness_nprad or car.front_stiffness_nprad),
            2 * (car.rear_slip_stiffness_nprad or car.rear_stiffness_nprad),
        ),
        (car.front_friction, car.rear_friction),
        loads,
        rest,
        (front_along, along - front_along),
        strict=True,
    ):
        limit = np.sqrt((mu * load) ** 2 - fx**2)
        stiffness = c * (1.0 + 0.5 * (load / still - 1.0))
        forces.append(brush_force(0.0, slip, stiffness, stiffness, limit)[1])
    front, rear = forces
    ay = (front + rear) / car.mass_kg
    turn = (car.cg_to_front_m * front - car.cg_to_rear_m * rear) / car.yaw_inertia_kgm2
    return np.array([ay - rate * speed, turn]), ay
