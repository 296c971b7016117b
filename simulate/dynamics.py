"""The car that the simulated driver steers: a linear single-track model with steering lag.

Source: Rajamani, "Vehicle Dynamics and Control", 2nd ed., eqs. (2.24)-(2.27); tyre and mass data of
a mid-size estate car, rounded. Below `_KINEMATIC_MPS` the tyres roll without slip.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import atan2, cos, sin, tan

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
_KINEMATIC_MPS = 2.5
_PREVIEW_S = 0.22


@dataclass(frozen=True, slots=True)
class Car:
    """Mass, yaw inertia, axle distances from the centre of gravity, cornering stiffness an axle."""

    mass_kg: float = 1560.0
    yaw_inertia_kgm2: float = 2650.0
    front_m: float = 1.22
    rear_m: float = 1.49
    front_stiffness_n: float = 98_000.0
    rear_stiffness_n: float = 118_000.0
    steering_lag_s: float = 0.12

    @property
    def wheelbase_m(self) -> float:
        """Rear axle to front axle."""
        return self.front_m + self.rear_m


@dataclass(frozen=True, slots=True)
class Ride:
    """What the car did; every array `(n,)`, the pose `(n, 3)` that of the rear axle."""

    pose: Floats
    speed_mps: Floats
    yaw_rate_radps: Floats
    sideslip_rad: Floats
    steering_rad: Floats


def follow(line: Floats, step_m: float, travelled_m: Floats, step_s: float, car: Car) -> Ride:
    """Drives along a line.

    Args:
        line: `(k, 2)` points that the rear axle should pass, `step_m` of stations apart.
        travelled_m: `(n,)` station that should be reached at every time step.

    The driver steers the curvature some way ahead and corrects position and heading.
    """
    tangent = np.gradient(line, axis=0)
    heading = np.unwrap(np.arctan2(tangent[:, 1], tangent[:, 0]))
    bend = np.gradient(heading) / np.maximum(np.hypot(*tangent.T), 1e-6)
    index = travelled_m / step_m
    count = len(travelled_m)
    grid = np.arange(len(line), dtype=np.float64)
    want_x, want_y = np.interp(index, grid, line[:, 0]), np.interp(index, grid, line[:, 1])
    want_yaw = np.interp(index, grid, heading)
    speed = np.hypot(np.gradient(want_x, step_s), np.gradient(want_y, step_s))
    speed[speed < 0.03] = 0.0
    ahead = np.interp(index + speed * _PREVIEW_S / step_m, grid, bend)
    out = np.empty((count, 7))
    x, y, yaw = want_x[0], want_y[0], want_yaw[0]
    slip, rate, steer = 0.0, 0.0, 0.0
    drift_gain = car.mass_kg * (
        car.rear_m * car.rear_stiffness_n - car.front_m * car.front_stiffness_n
    ) / (car.front_stiffness_n * car.rear_stiffness_n * car.wheelbase_m)  # fmt: skip
    for i in range(count):
        c, s = cos(want_yaw[i]), sin(want_yaw[i])
        dx, dy = x - want_x[i], y - want_y[i]
        along, across = c * dx + s * dy, -s * dx + c * dy
        v = speed[i] - 0.5 * along if speed[i] > 0.0 else 0.0
        v = max(v, 0.0)
        off = yaw - want_yaw[i]
        wish = (car.wheelbase_m + drift_gain * v * v) * (
            ahead[i] - 1.4 * off / max(v * 0.9, 3.0) - 0.7 * across / max(v * 0.9, 3.0) ** 1.5
        )
        wish = min(max(wish, -0.6), 0.6)
        steer += (wish - steer) * min(step_s / car.steering_lag_s, 1.0)
        if v < _KINEMATIC_MPS:
            rate = v * tan(steer) / car.wheelbase_m
            slip = car.rear_m * rate
        else:
            front = steer - atan2(slip + car.front_m * rate, v)
            rear = -atan2(slip - car.rear_m * rate, v)
            push_f, push_r = car.front_stiffness_n * front, car.rear_stiffness_n * rear
            slip += step_s * ((push_f + push_r) / car.mass_kg - v * rate)
            rate += step_s * (car.front_m * push_f - car.rear_m * push_r) / car.yaw_inertia_kgm2
        side = slip - car.rear_m * rate
        out[i] = (x, y, yaw, v, rate, atan2(slip, v) if v > 0.5 else 0.0, steer)
        cy, sy = cos(yaw), sin(yaw)
        x += step_s * (v * cy - side * sy)
        y += step_s * (v * sy + side * cy)
        yaw += step_s * rate
    return Ride(out[:, :3], out[:, 3], out[:, 4], out[:, 5], out[:, 6])
