"""What the nonlinear single track does not know: how large it is and how long it lasts."""

from __future__ import annotations

from math import exp

import numpy as np
from numpy.typing import NDArray

from polemap.electric.config import (
    INITIAL_HEADING_SD_RAD,
    INITIAL_SIDESLIP_SD_RAD,
    INITIAL_YAW_RATE_SD_RADPS,
)
from polemap.vehicle.parameters import Car

Floats = NDArray[np.float64]

SIZE = 11
BETA, GAMMA, PSI, FORCE, MOMENT, AY_BIAS, SCALE, STEERING, GYRO_BIAS, BANK, ROLL = range(SIZE)
"""Places of the states of `NonlinearKalman`."""

LEAST_SLOPE = 0.08
"""A tyre at its limit still answers by this share of its stiffness: else a filter would hold its
side-slip for unobservable there."""

# What the tyres' model lacks in lateral and yaw acceleration, one sigma, and how long it lasts
# (transients, shorter than a bend). A model of tyres errs by a share of the force that it tells:
# a straight car's forces are known to the floor. Both axles err alike (one road, one make of
# tyre), so that less of it is moment: a share of the forces at an arm of the wheelbase.
FORCE_FLOOR_MPS2, FORCE_SHARE, FORCE_TIME_S = 0.3, 0.1, 1.0
MOMENT_FLOOR_RADPS2, MOMENT_SHARE, MOMENT_TIME_S = 0.1, 0.02, 0.5
# the road's friction and the tyres' stiffness together, as the logarithm of a common factor: fits
# to parts of one drive of the GTI differ by so much in friction
SCALE_SD, SCALE_TIME_S = 0.06, 30.0
# accelerometer: bias with its mounting (1.1 degrees), and the body's roll as a share of what it
# feels (3 degrees at 1 g); both belong to the car and hardly change
AY_BIAS_SD_MPS2, AY_BIAS_TIME_S = 0.2, 60.0
ROLL_SHARE_SD, ROLL_TIME_S = 0.05, 300.0
# bank of the road: crossfall of 2.5 % and more in bends, for as long as one lasts
BANK_SD_RAD, BANK_TIME_S = 0.03, 5.0
STEERING_OFFSET_SD_RAD, STEERING_OFFSET_WALK_RAD = 0.003, 1e-5
GYRO_BIAS_SD_RADPS, GYRO_BIAS_WALK_RADPS = 2e-3, 1e-5
SIDESLIP_WALK_RAD, YAW_RATE_WALK_RADPS = 0.005, 0.15
# rolling without slip: place of the centre of gravity, steering of the inner and outer wheel
ROLLING_SHARE = 0.05

_LEAKY = (
    (AY_BIAS, AY_BIAS_SD_MPS2, AY_BIAS_TIME_S),
    (SCALE, SCALE_SD, SCALE_TIME_S),
    (BANK, BANK_SD_RAD, BANK_TIME_S),
    (ROLL, ROLL_SHARE_SD, ROLL_TIME_S),
)


def start_covariance() -> Floats:
    """`(11, 11)` of the start: side-slip, yaw rate and heading of any car, the rest as it lasts."""
    sds = np.zeros(SIZE)
    sds[[BETA, GAMMA, PSI]] = (
        INITIAL_SIDESLIP_SD_RAD,
        INITIAL_YAW_RATE_SD_RADPS,
        INITIAL_HEADING_SD_RAD,
    )
    sds[[FORCE, MOMENT]] = FORCE_FLOOR_MPS2, MOMENT_FLOOR_RADPS2
    sds[[STEERING, GYRO_BIAS]] = STEERING_OFFSET_SD_RAD, GYRO_BIAS_SD_RADPS
    for index, sd, _ in _LEAKY:
        sds[index] = sd
    return np.diag(np.square(sds))


class ProcessNoise:
    """Leaks and noise of a step.

    Attributes:
        covariance: `(11, 11)` of what is new in a step.
    """

    def __init__(self, car: Car, heading_walk_rad: float) -> None:
        self.covariance = np.zeros((SIZE, SIZE))
        self._heading_walk_rad = heading_walk_rad
        self._step_s = float("nan")
        self._force_share = FORCE_SHARE / car.mass_kg
        self._moment_share = MOMENT_SHARE * car.wheelbase_m / car.yaw_inertia_kgm2
        self._new_force = self._new_moment = self._walk_beta = self._walk_gamma = 0.0

    def step(self, t: float, transition: Floats) -> None:
        """Put the leaks of a step of `t` seconds into `transition`, and its noise in order."""
        if t == self._step_s:
            return
        self._step_s, q = t, self.covariance
        for index, sd, time_s in _LEAKY:
            leak = exp(-t / time_s)
            transition[index, index] = leak
            q[index, index] = sd * sd * (1.0 - leak * leak)
        for index, walk in (
            (PSI, self._heading_walk_rad),
            (STEERING, STEERING_OFFSET_WALK_RAD),
            (GYRO_BIAS, GYRO_BIAS_WALK_RADPS),
        ):
            q[index, index] = walk * walk * t
        transition[PSI, GAMMA] = t
        force, moment = exp(-t / FORCE_TIME_S), exp(-t / MOMENT_TIME_S)
        transition[FORCE, FORCE], transition[MOMENT, MOMENT] = force, moment
        self._new_force, self._new_moment = 1.0 - force * force, 1.0 - moment * moment
        self._walk_beta, self._walk_gamma = SIDESLIP_WALK_RAD**2 * t, YAW_RATE_WALK_RADPS**2 * t
        self.on_tyres(0.0)

    def rolling(self, index: int, value: float, leak: float) -> None:
        """Side-slip or yaw rate of rolling without slip is known to a share of its `value`."""
        walk = self._walk_beta if index == BETA else self._walk_gamma
        lacking = ROLLING_SHARE * value
        self.covariance[index, index] = walk + (1.0 - leak * leak) * lacking * lacking

    def on_tyres(self, total_n: float) -> None:
        """The disturbances' share of the sizes of both axles' forces."""
        force, moment = self._force_share * total_n, self._moment_share * total_n
        q = self.covariance
        q[BETA, BETA], q[GAMMA, GAMMA] = self._walk_beta, self._walk_gamma
        q[FORCE, FORCE] = self._new_force * (FORCE_FLOOR_MPS2 * FORCE_FLOOR_MPS2 + force * force)
        q[MOMENT, MOMENT] = self._new_moment * (
            MOMENT_FLOOR_RADPS2 * MOMENT_FLOOR_RADPS2 + moment * moment
        )
