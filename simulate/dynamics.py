"""The car that the simulated driver steers: the core's single-track model, with a steering lag.

The driver's law (preview of the bend, correction of place and heading) is this room's own; what
the car makes of it is `vehicle.single_track.lateral`, stepped exactly.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from polemap.vehicle.motion import velocity_at
from polemap.vehicle.packed import rotate, rotate_back
from polemap.vehicle.parameters import Car
from polemap.vehicle.single_track import lateral, schedule

Floats = NDArray[np.float64]
_PREVIEW_S = 0.22
_STEERING_LAG_S = 0.12
_STEERING_LIMIT_RAD = 0.6

CAR = Car(
    name="simulated",
    source="mass and tyres of a mid-size estate car, rounded; a guess that steers like one",
    mass_kg=1560.0,
    yaw_inertia_kgm2=2650.0,
    cg_to_front_m=1.22,
    cg_to_rear_m=1.49,
    front_stiffness_nprad=49_000.0,
    rear_stiffness_nprad=59_000.0,
    preview_m=10.0,
)


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
        line: `(k, 2)` points that the rear axle should pass, `step_m` of the way apart.
        travelled_m: `(n,)` part of the way that should be behind the car at every time step.

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
    understeer, rear = car.understeer_s2pm, car.cg_to_rear_m
    model = schedule(lateral, car, (0.0, 0.0), step_s)
    for i in range(count):
        along, across = rotate_back(x - want_x[i], y - want_y[i], want_yaw[i])
        v = max(speed[i] - 0.5 * along, 0.0) if speed[i] > 0.0 else 0.0
        off = yaw - want_yaw[i]
        wish = (car.wheelbase_m + understeer * v * v) * (
            ahead[i] - 1.4 * off / max(v * 0.9, 3.0) - 0.7 * across / max(v * 0.9, 3.0) ** 1.5
        )
        wish = min(max(wish, -_STEERING_LIMIT_RAD), _STEERING_LIMIT_RAD)
        steer += (wish - steer) * min(step_s / _STEERING_LAG_S, 1.0)
        (g00, g01), (g10, g11) = model.at(v)[0].tolist()
        h0, h1 = model.drive[0, 0], model.drive[1, 0]
        slip, rate = g00 * slip + g01 * rate + h0 * steer, g10 * slip + g11 * rate + h1 * steer
        if v == 0.0:
            # the model leaves a standing car what it turned with for some milliseconds
            slip = rate = 0.0
        velocity = velocity_at(v, v * slip, rate, -rear)
        out[i] = (x, y, yaw, v, rate, slip, steer)
        east, north = rotate(*velocity, yaw)
        x += step_s * east
        y += step_s * north
        yaw += step_s * rate
    return Ride(out[:, :3], out[:, 3], out[:, 4], out[:, 5], out[:, 6])
