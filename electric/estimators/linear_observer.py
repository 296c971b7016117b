"""A linear observer on yaw rate and lateral acceleration: no camera, no GPS."""

from __future__ import annotations

from math import exp

import numpy as np
from numpy.typing import NDArray

from polemap.electric.config import (
    INITIAL_SIDESLIP_SD_RAD,
    INITIAL_YAW_RATE_SD_RADPS,
    EstimatorConfig,
)
from polemap.electric.estimators.base import (
    LATERAL_ACCELERATION,
    YAW_RATE,
    Clock,
    Estimate,
    Inputs,
    Value,
)
from polemap.electric.estimators.gate import Gate
from polemap.vehicle.errors import VehicleError
from polemap.vehicle.kalman import symmetric
from polemap.vehicle.parameters import Car
from polemap.vehicle.single_track import (
    KINEMATIC_SPEED_MPS,
    lateral,
    lateral_acceleration_rows,
    schedule,
)

Floats = NDArray[np.float64]

# error poles of a tenth of a second: faster ones only pass the accelerometer's noise on
OBSERVER_POLE_RADPS = 10.0
# of a body-mounted accelerometer over a road
LATERAL_ACCELERATION_SD_MPS2 = 0.1


class LinearObserver:
    """State `[beta, gamma]`; both outputs `[gamma, ay]` invert to the state, so poles are free.

    With C square the gain `K = (G - exp(-pole T) I) C^-1` puts both error poles at
    `OBSERVER_POLE_RADPS`. Its standard deviation follows from the gain in use (Joseph form).

    Source: N13, section 5.1 and its reference (2), the comparison of the GPS estimator.
    """

    fields = ("sideslip_rad", "yaw_rate_radps")

    def __init__(self, car: Car, config: EstimatorConfig) -> None:
        density = (config.sideslip_walk_rad**2, config.yaw_rate_walk_radps**2)
        self._car = car
        self._schedule = schedule(lateral, car, density, config.step_s)
        self._clock = Clock(config.step_s)
        self._pole = OBSERVER_POLE_RADPS
        self._noise = np.diag([config.gyro_sd_radps**2, LATERAL_ACCELERATION_SD_MPS2**2])
        self._x = np.zeros(2)
        self._p = np.diag([INITIAL_SIDESLIP_SD_RAD**2, INITIAL_YAW_RATE_SD_RADPS**2])
        self._inputs: Inputs | None = None
        self._yaw_rate: float | None = None
        self._elapsed = 0.0
        self.dropped: dict[str, int] = {}
        self.gate = Gate(config, self.dropped)

    def step(self, stamp_s: float, inputs: Inputs) -> None:
        self._elapsed = self._clock.advance(stamp_s)
        self._inputs, self._yaw_rate = inputs, None
        if self._elapsed:
            g, h, q = self._schedule.at(inputs.speed_mps, self._elapsed)
            u = np.array([inputs.road_wheel_angle_rad, inputs.yaw_moment_nm])
            self._x = g @ self._x + h @ u
            self._p = g @ self._p @ g.T + q

    def capture(self, kind: str, stamp_s: float) -> None:
        """Nothing here is late."""

    def measure(self, kind: str, value: Value, stamp_s: float, arrival_s: float) -> None:
        if kind == YAW_RATE:
            self._yaw_rate = float(value)  # type: ignore[arg-type]
        elif kind == LATERAL_ACCELERATION and self._inputs is not None and self._elapsed:
            if self._yaw_rate is None:
                raise VehicleError("linear observer: the yaw rate must come before ay in a step")
            self._correct(self._inputs, np.array([self._yaw_rate, float(value)]))  # type: ignore[arg-type]

    def _correct(self, inputs: Inputs, measured: Floats) -> None:
        if inputs.speed_mps < KINEMATIC_SPEED_MPS:
            return
        row, direct = lateral_acceleration_rows(self._car, inputs.speed_mps)
        c = np.array([[0.0, 1.0], row])
        u = np.array([inputs.road_wheel_angle_rad, inputs.yaw_moment_nm])
        predicted = c @ self._x + (0.0, direct @ u)
        residual = measured - predicted
        s = np.diag(c @ self._p @ c.T + self._noise)
        stamp, wild = self._clock.stamp_s, False
        for index, kind in enumerate((YAW_RATE, LATERAL_ACCELERATION)):
            wild |= self.gate.refuses(kind, stamp, (float(residual[index]), float(s[index])))
        if wild:
            return
        g = self._schedule.transition
        # error after the update: (I - K C) G e, so K = (I - pole G^-1) C^-1
        fade = exp(-self._pole * self._elapsed)
        gain = (np.eye(2) - fade * np.linalg.inv(g)) @ np.linalg.inv(c)
        self._x = self._x + gain @ residual
        keep = np.eye(2) - gain @ c
        self._p = symmetric(keep @ self._p @ keep.T + gain @ self._noise @ gain.T)

    def estimate(self) -> Estimate:
        return Estimate(self._clock.stamp_s, self.fields, self._x.copy(), np.sqrt(np.diag(self._p)))

    def covariance(self) -> Floats:
        return self._p.copy()
