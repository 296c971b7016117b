"""The papers' yardstick: a Kalman filter on the single-track model that hears only the gyro."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from polemap.electric.config import (
    INITIAL_SIDESLIP_SD_RAD,
    INITIAL_YAW_RATE_SD_RADPS,
    EstimatorConfig,
)
from polemap.electric.estimators.base import YAW_RATE, Clock, Estimate, Inputs, Value
from polemap.electric.estimators.gate import Gate
from polemap.vehicle.delay import ClonedFilter
from polemap.vehicle.parameters import Car
from polemap.vehicle.single_track import lateral, schedule

Floats = NDArray[np.float64]


class BicycleKalman:
    """State `[beta, gamma]`, measured: yaw rate.

    Source: W12 (1), W14 (1), (2) as corrected in errata.md.
    """

    fields = ("sideslip_rad", "yaw_rate_radps")

    def __init__(self, car: Car, config: EstimatorConfig) -> None:
        density = (config.sideslip_walk_rad**2, config.yaw_rate_walk_radps**2)
        self._schedule = schedule(lateral, car, density, config.step_s)
        self._clock = Clock(config.step_s)
        self._variance = config.gyro_sd_radps**2
        start = np.diag([INITIAL_SIDESLIP_SD_RAD**2, INITIAL_YAW_RATE_SD_RADPS**2])
        self._filter = ClonedFilter(np.zeros(2), start, np.zeros((1, 2)), 0)
        self.dropped: dict[str, int] = {}
        self.gate = Gate(config, self.dropped)

    def step(self, stamp_s: float, inputs: Inputs) -> None:
        elapsed = self._clock.advance(stamp_s)
        if elapsed:
            g, h, q = self._schedule.at(inputs.speed_mps, elapsed)
            driven = h[:, 0] * inputs.road_wheel_angle_rad + h[:, 1] * inputs.yaw_moment_nm
            self._filter.predict(g, driven, q)

    def capture(self, kind: str, stamp_s: float) -> None:
        """Nothing here is late."""

    def measure(self, kind: str, value: Value, stamp_s: float, arrival_s: float) -> None:
        if kind == YAW_RATE:
            f, gyro = self._filter, float(value)  # type: ignore[arg-type]
            variance = self.gate.variance(YAW_RATE, self._variance)
            residual = gyro - f.x.item(1)
            if not self.gate.refuses(YAW_RATE, stamp_s, (residual, f.p.item(1, 1) + variance)):
                f.scalar(1, gyro, variance)

    def estimate(self) -> Estimate:
        f = self._filter
        return Estimate(self._clock.stamp_s, self.fields, f.x.copy(), np.sqrt(np.diag(f.p)))

    def covariance(self) -> Floats:
        return self._filter.p.copy()
