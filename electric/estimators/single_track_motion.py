"""How the state of `NonlinearKalman` moves in a step, and by what slopes: on tyres, and rolling."""

from __future__ import annotations

from math import exp

import numpy as np
from numpy.typing import NDArray

from polemap.electric.estimators.process_noise import (
    BANK,
    BETA,
    FORCE,
    GAMMA,
    LEAST_SLOPE,
    MOMENT,
    PSI,
    SCALE,
    SIZE,
    STEERING,
    ProcessNoise,
)
from polemap.vehicle.axles import GRAVITY_MPS2, Axles
from polemap.vehicle.parameters import Car
from polemap.vehicle.single_track import lateral

Floats = NDArray[np.float64]
Moved = tuple[float, float, float]


class SingleTrackMotion:
    """Side-slip, yaw rate and heading after a step.

    Args:
        noise: is told how large the forces are.

    Attributes:
        transition: `(11, 11)` of the step; the rows of side-slip and yaw rate are written here, the
            leaks of the others by `ProcessNoise.step`.
    """

    def __init__(self, car: Car, noise: ProcessNoise) -> None:
        self._car, self._axles, self._noise = car, Axles(car), noise
        self._limits = self._axles.limits(0.0)
        self.transition = np.eye(SIZE)

    def pushed(self, ax_mps2: float) -> None:
        """The acceleration ahead moves load from one axle to the other and uses up friction."""
        self._limits = self._axles.limits(ax_mps2)

    def forces(
        self, x: Floats, steering_rad: float, speed_mps: float
    ) -> tuple[float, float, float, float]:
        """Front force, slope, rear force, slope at a state, slopes at least `LEAST_SLOPE`."""
        limits = self._limits
        front, front_slope, rear, rear_slope = self._axles.forces(
            x.item(BETA), x.item(GAMMA), steering_rad - x.item(STEERING), speed_mps, limits
        )
        scale = exp(x.item(SCALE))
        return (
            scale * front,
            scale * min(front_slope, -LEAST_SLOPE * limits[0]),
            scale * rear,
            scale * min(rear_slope, -LEAST_SLOPE * limits[2]),
        )

    def on_tyres(
        self, t: float, x: Floats, steering_rad: float, v: float, along_mps2: float,
        moment_nm: float,
    ) -> Moved:  # fmt: skip
        """A step of `t` seconds by the linearly implicit midpoint rule."""
        car, g = self._car, self.transition
        m, inertia = car.mass_kg, car.yaw_inertia_kgm2
        lf, lr = car.cg_to_front_m, car.cg_to_rear_m
        front, front_slope, rear, rear_slope = self.forces(x, steering_rad, v)
        beta, gamma = x.item(BETA), x.item(GAMMA)
        force, turning = (front + rear) / (m * v), (lf * front - lr * rear) / inertia
        self._noise.on_tyres(abs(front) + abs(rear))
        lacking = x.item(FORCE) - GRAVITY_MPS2 * x.item(BANK)
        beta_rate = force + lacking / v - gamma - beta * along_mps2 / v
        gamma_rate = turning + x.item(MOMENT) + moment_nm / inertia
        # A of the rates by beta and gamma; W = t (I - t/2 A)^-1; x+ = x + W f(x), G = I + W A
        moment_slope = (lf * front_slope - lr * rear_slope) / inertia
        a00 = (front_slope + rear_slope) / (m * v) - along_mps2 / v
        a01 = moment_slope * inertia / (m * v * v) - 1.0
        a11 = (lf * lf * front_slope + lr * lr * rear_slope) / (inertia * v)
        h = 0.5 * t
        b00, b01, b10, b11 = 1.0 - h * a00, -h * a01, -h * moment_slope, 1.0 - h * a11
        inverse = t / (b00 * b11 - b01 * b10)
        w00, w01, w10, w11 = inverse * b11, -inverse * b01, -inverse * b10, inverse * b00
        steered, steered_turn = front_slope / (m * v), lf * front_slope / inertia
        g[0, 0], g[0, 1] = 1.0 + w00 * a00 + w01 * moment_slope, w00 * a01 + w01 * a11
        g[1, 0], g[1, 1] = w10 * a00 + w11 * moment_slope, 1.0 + w10 * a01 + w11 * a11
        g[0, FORCE], g[1, FORCE] = w00 / v, w10 / v
        g[0, BANK], g[1, BANK] = -GRAVITY_MPS2 * w00 / v, -GRAVITY_MPS2 * w10 / v
        g[0, MOMENT], g[1, MOMENT] = w01, w11
        g[0, SCALE], g[1, SCALE] = w00 * force + w01 * turning, w10 * force + w11 * turning
        g[0, STEERING] = w00 * steered + w01 * steered_turn
        g[1, STEERING] = w10 * steered + w11 * steered_turn
        return (
            beta + w00 * beta_rate + w01 * gamma_rate,
            gamma + w10 * beta_rate + w11 * gamma_rate,
            x.item(PSI) + t * (gamma + 0.5 * (w10 * beta_rate + w11 * gamma_rate)),
        )

    def rolling(self, t: float, x: Floats, steering_rad: float, speed_mps: float) -> Moved:
        """Too slow for tyres: side-slip and yaw rate relax to those of rolling without slip."""
        g = self.transition
        a, b = lateral(self._car, max(speed_mps, 0.0))
        steering = steering_rad - x.item(STEERING)
        g[:2, FORCE:] = 0.0
        ends = []
        for index in (BETA, GAMMA):
            leak = exp(a[index, index] * t)
            answer = b[index, 0] / -a[index, index]
            g[index, :2] = 0.0
            g[index, index] = leak
            g[index, STEERING] = -(1.0 - leak) * answer
            ends.append(leak * x.item(index) + (1.0 - leak) * answer * steering)
            self._noise.rolling(index, answer * steering, leak)
        return ends[0], ends[1], x.item(PSI) + t * x.item(GAMMA)
