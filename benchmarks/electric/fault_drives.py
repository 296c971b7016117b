"""Drives with every sensor of the estimators, and faults put into them.

The plant is a single track on brush tyres, integrated by Heun's rule, whose tyres, mass and sensors
differ from what the car file says by what production cars differ: nothing in it is shared with the
filters but the tyre's formula. The road bends as the car drives, is banked and hilly.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from polemap.electric.signals import SignalLog
from polemap.vehicle.axles import GRAVITY_MPS2
from polemap.vehicle.parameters import Car
from polemap.vehicle.tyre import brush_lateral

Floats = NDArray[np.float64]
STEP_S = 0.01
GYRO_SD_RADPS, AY_SD_MPS2, WHEEL_SD_MPS, STEERING_SD_RAD = 0.003, 0.15, 0.03, 3e-4
COURSE_SD_RAD, GPS_SPEED_SD_MPS, GPS_DELAY_S, GPS_EVERY = 0.005, 0.05, 0.1, 20
HEADING_SD_RAD, OFFSET_SD_M, CURVATURE_SD = 0.002, 0.02, 3e-4
CAMERA_DELAY_S, CAMERA_EVERY = 0.06, 6
# how hard and how fast: (slowest, fastest m/s, lateral m/s^2, seconds from bend to bend)
STYLES = {
    "town": (4.0, 14.0, 2.5, 7.0),
    "country": (14.0, 24.0, 3.0, 9.0),
    "motorway": (26.0, 33.0, 0.8, 14.0),
    "brisk": (12.0, 24.0, 6.0, 6.0),
}


@dataclass(frozen=True, slots=True)
class Driven:
    """A log whose `sideslip_rad` is the truth at the centre of gravity, and the road it was on.

    Attributes:
        bank_rad: `(n,)`, positive where the left side is higher.
        grade_rad: `(n,)`, positive uphill.
    """

    log: SignalLog
    style: str
    bank_rad: Floats
    grade_rad: Floats


def driven(car: Car, style: str, seconds: float, seed: int) -> Driven:
    """A drive of a style by a car that is nearly `car`."""
    rng = np.random.default_rng([seed, 20])
    slow, fast, hard, bend_s = STYLES[style]
    n = round(seconds / STEP_S)
    t: Floats = np.asarray(STEP_S * np.arange(n), dtype=np.float64)
    speed = 0.5 * (slow + fast) + 0.5 * (fast - slow) * _waves(rng, t, 25.0)
    ax = np.gradient(speed, t)
    actual = _actual(car, rng)
    wave = _waves(rng, t, bend_s)
    steering = hard * wave * (car.wheelbase_m + max(car.understeer_s2pm, 0.0) * speed**2)
    steering /= np.maximum(speed, 8.0) ** 2
    bank, grade = 0.03 * _waves(rng, t, 20.0), 0.05 * _waves(rng, t, 40.0)
    vy, rate, ay = _plant(actual, steering, speed, ax, GRAVITY_MPS2 * bank)
    slip = np.arctan2(vy, speed)
    heading = np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]) * STEP_S)])
    draw = rng.standard_normal
    gyro_bias, ay_bias, ax_bias = 0.003 * draw(), 0.1 * draw(), 0.1 * draw()
    columns = {
        "road_wheel_angle_rad": steering + 0.002 * draw() + STEERING_SD_RAD * draw(n),
        "yaw_rate_radps": rate + gyro_bias + GYRO_SD_RADPS * draw(n),
        "ax_mps2": ax - rate * vy + GRAVITY_MPS2 * grade + ax_bias + AY_SD_MPS2 * draw(n),
        # the body rolls outwards by 4 degrees at 1 g
        "ay_mps2": ay * 1.07 + ay_bias + AY_SD_MPS2 * draw(n),
        "vx_mps": speed * (1.0 + 0.01 * draw()) + WHEEL_SD_MPS * draw(n),
        "sideslip_rad": slip,
        "vx_reference_mps": speed,
        "vy_mps": vy,
    }
    columns |= _gps(rng, t, heading + slip + car.gps_point_m * rate / speed, np.hypot(speed, vy))
    columns |= _camera(rng, car, t, speed, rate, slip)
    return Driven(SignalLog(t, columns), style, bank, grade)


def _waves(rng: np.random.Generator, t: Floats, period_s: float) -> Floats:
    """A smooth course `(n,)` within [-1, 1] of several rhythms, and quiet stretches."""
    total = np.zeros(len(t))
    for share in (1.0, 0.6, 0.35):
        phase, stretch = rng.uniform(0.0, 2.0 * np.pi), rng.uniform(0.8, 1.25)
        total += share * np.sin(2.0 * np.pi * t / (period_s * share * stretch) + phase)
    quiet = 0.5 + 0.5 * np.sin(2.0 * np.pi * t / (4.0 * period_s) + rng.uniform(0.0, 6.3))
    return np.asarray(np.tanh(total) * np.clip(1.5 * quiet, 0.0, 1.0))


def _actual(car: Car, rng: np.random.Generator) -> tuple[float, ...]:
    """Mass, inertia, arms, axle stiffness and friction limits of the car that drives."""
    mass = car.mass_kg * rng.uniform(0.97, 1.12)
    inertia = car.yaw_inertia_kgm2 * rng.uniform(0.95, 1.15)
    weight = mass * GRAVITY_MPS2 / car.wheelbase_m
    front = 2.0 * (car.front_slip_stiffness_nprad or car.front_stiffness_nprad)
    rear = 2.0 * (car.rear_slip_stiffness_nprad or car.rear_stiffness_nprad)
    return (
        mass, inertia, car.cg_to_front_m, car.cg_to_rear_m,
        front * rng.uniform(0.9, 1.12), rear * rng.uniform(0.9, 1.12),
        weight * car.cg_to_rear_m * car.front_friction,
        weight * car.cg_to_front_m * car.rear_friction,
    )  # fmt: skip


def _plant(
    actual: tuple[float, ...], steering: Floats, speed: Floats, ax: Floats, bank: Floats
) -> tuple[Floats, Floats, Floats]:
    """Lateral speed, yaw rate and what a lateral accelerometer feels, `(n,)` each."""
    mass, inertia, lf, lr, front_c, rear_c, front_limit, rear_limit = actual

    def rates(vy: float, rate: float, angle: float, v: float, side: float) -> tuple[float, ...]:
        front = brush_lateral((vy + lf * rate) / v - angle, front_c, front_limit)[0]
        rear = brush_lateral((vy - lr * rate) / v, rear_c, rear_limit)[0]
        felt = (front + rear) / mass
        return felt - side - rate * v, (lf * front - lr * rear) / inertia, felt

    out = np.zeros((len(steering), 3))
    vy = rate = 0.0
    rows = zip(steering.tolist(), speed.tolist(), bank.tolist(), strict=True)
    for k, (angle, v, side) in enumerate(rows):
        first = rates(vy, rate, angle, v, side)
        out[k] = vy, rate, first[2]
        second = rates(vy + STEP_S * first[0], rate + STEP_S * first[1], angle, v, side)
        vy += 0.5 * STEP_S * (first[0] + second[0])
        rate += 0.5 * STEP_S * (first[1] + second[1])
    return out[:, 0], out[:, 1], out[:, 2]


def _gps(rng: np.random.Generator, t: Floats, course: Floats, speed: Floats) -> dict[str, Floats]:
    rows = np.arange(GPS_EVERY, len(t), GPS_EVERY)
    sd = np.maximum(COURSE_SD_RAD, GPS_SPEED_SD_MPS / speed[rows])
    return {
        "course_rad": _at(len(t), rows, course[rows] + sd * rng.standard_normal(len(rows))),
        "speed_mps": _at(
            len(t), rows, speed[rows] + GPS_SPEED_SD_MPS * rng.standard_normal(len(rows))
        ),
        "gnss_arrival_s": _at(len(t), rows, t[rows] + GPS_DELAY_S),
    }


def _camera(
    rng: np.random.Generator, car: Car, t: Floats, speed: Floats, rate: Floats, slip: Floats
) -> dict[str, Floats]:
    """A lane that bends after the car, with what the models ask of its geometry."""
    heading, offset = 0.0, 0.0
    path = float(rate[0] / speed[0])
    states = np.zeros((len(t), 3))
    for k, (v, r, b) in enumerate(zip(speed.tolist(), rate.tolist(), slip.tolist(), strict=True)):
        # the road follows the car's path and brings it back to the lane within seconds
        path += (r / v - path) * STEP_S / 1.5
        bend = path + (0.25 * offset + 0.8 * v * heading) / (v * v)
        states[k] = heading, offset, bend
        offset += STEP_S * (v * (b + heading) + car.preview_m * r - 0.5 * STEP_S * v * v * bend)
        heading += STEP_S * (r - v * bend)
    rows = np.arange(CAMERA_EVERY, len(t), CAMERA_EVERY)
    noisy = states[rows] + rng.standard_normal((len(rows), 3)) * (
        HEADING_SD_RAD, OFFSET_SD_M, CURVATURE_SD
    )  # fmt: skip
    names = ("heading_rad", "lateral_offset_m", "road_curvature_per_m")
    columns = {name: _at(len(t), rows, noisy[:, i]) for i, name in enumerate(names)}
    columns["camera_arrival_s"] = _at(len(t), rows, t[rows] + CAMERA_DELAY_S)
    return columns


def _at(n: int, rows: NDArray[np.int64], values: Floats) -> Floats:
    column = np.full(n, np.nan)
    column[rows] = values
    return column


GYRO, ACCELEROMETER, STEERING = "gyro", "accelerometer", "steering"
WHEEL, GPS, CAMERA = "wheel speed", "GPS", "camera"
CHANNELS = {
    GYRO: ("yaw_rate_radps",),
    ACCELEROMETER: ("ay_mps2",),
    STEERING: ("road_wheel_angle_rad",),
    WHEEL: ("vx_mps",),
    GPS: ("course_rad", "speed_mps"),
    CAMERA: ("heading_rad", "lateral_offset_m", "road_curvature_per_m"),
}
# what a step is, what a drift gains in a second, and a spike, by channel
STEP = {"yaw_rate_radps": 0.15, "ay_mps2": 3.0, "road_wheel_angle_rad": 0.05, "vx_mps": 4.0,
        "course_rad": 0.25, "speed_mps": 0.0, "heading_rad": 0.12, "lateral_offset_m": 0.8,
        "road_curvature_per_m": 0.0}  # fmt: skip
DRIFT = {"yaw_rate_radps": 0.03, "ay_mps2": 0.6, "road_wheel_angle_rad": 0.01, "vx_mps": 1.0,
         "course_rad": 0.06, "speed_mps": 0.0, "heading_rad": 0.05, "lateral_offset_m": 0.0,
         "road_curvature_per_m": 0.0}  # fmt: skip
NOISE = {"yaw_rate_radps": GYRO_SD_RADPS, "ay_mps2": AY_SD_MPS2, "vx_mps": WHEEL_SD_MPS,
         "road_wheel_angle_rad": STEERING_SD_RAD, "course_rad": COURSE_SD_RAD,
         "speed_mps": GPS_SPEED_SD_MPS, "heading_rad": HEADING_SD_RAD,
         "lateral_offset_m": OFFSET_SD_M, "road_curvature_per_m": CURVATURE_SD}  # fmt: skip
SCALE, DELAY_S, SPIKE_EVERY_S, SPIKE = 1.4, 0.4, 0.5, 6.0
KINDS = ("step", "drift", "stuck", "noise", "scale", "silence", "spikes", "sign", "delay")


def faulty(
    log: SignalLog, sensor: str, kind: str, from_s: float, to_s: float, rng: np.random.Generator
) -> SignalLog:
    """The log with a fault of a sensor between two stamps; the reference stays."""
    columns = dict(log.columns)
    for name in CHANNELS[sensor]:
        values = columns[name].copy()
        rows = np.flatnonzero(np.isfinite(values) & (log.stamp_s >= from_s) & (log.stamp_s < to_s))
        if kind == "delay":
            known = np.isfinite(values)
            values[rows] = np.interp(log.stamp_s[rows] - DELAY_S, log.stamp_s[known], values[known])
        else:
            values[rows] = _FAULTS[kind](name, log.stamp_s[rows] - from_s, values[rows], rng)
        columns[name] = values
    return SignalLog(log.stamp_s, columns)


Fault = Callable[[str, Floats, Floats, np.random.Generator], Floats]


def _spikes(name: str, age: Floats, values: Floats, rng: np.random.Generator) -> Floats:
    hit = np.unique(np.floor(age / SPIKE_EVERY_S), return_index=True)[1]
    values = values.copy()
    values[hit] += SPIKE * STEP[name] * np.sign(rng.standard_normal(len(hit)))
    return values


_FAULTS: dict[str, Fault] = {
    "step": lambda name, _age, values, _rng: values + STEP[name],
    "drift": lambda name, age, values, _rng: values + DRIFT[name] * age,
    "stuck": lambda _name, _age, values, _rng: np.full_like(values, values[0]),
    "noise": lambda name, _age, values, rng: (
        values + 10.0 * NOISE[name] * rng.standard_normal(len(values))
    ),
    "scale": lambda _name, _age, values, _rng: SCALE * values,
    "silence": lambda _name, _age, values, _rng: np.full_like(values, np.nan),
    "spikes": _spikes,
    "sign": lambda _name, _age, values, _rng: -values,
}
