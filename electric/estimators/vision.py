"""What the camera filters share: the model's schedule, the start and the noise."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from polemap.electric.config import (
    INITIAL_HEADING_SD_RAD,
    INITIAL_OFFSET_SD_M,
    INITIAL_SIDESLIP_SD_RAD,
    INITIAL_YAW_RATE_SD_RADPS,
    EstimatorConfig,
)
from polemap.electric.estimators.base import Clock, Estimate, Inputs, OutputBridge
from polemap.electric.estimators.gate import Gate
from polemap.vehicle.parameters import Car
from polemap.vehicle.single_track import bend_of_lane, combined_vision, schedule

Floats = NDArray[np.float64]
SEEN = np.array([[0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
"""Rows of heading and lateral offset in `[beta, gamma, psi, y_l]`."""
ALL_ROWS = np.array([[0.0, 1.0, 0.0, 0.0], *SEEN])
"""Rows of yaw rate, heading and lateral offset."""

CURVATURE_ERROR_S = 0.5
"""How long an error of the camera's road curvature lasts."""


def vision_density(config: EstimatorConfig) -> tuple[float, ...]:
    """Diagonal of the process noise: vehicle part, and vision part (none by default).

    Source: W14 (23), Q_veh and Q_vis.
    """
    return (
        config.sideslip_walk_rad**2,
        config.yaw_rate_walk_radps**2,
        config.heading_walk_rad**2,
        config.lateral_offset_walk_m**2,
    )


def initial_covariance(config: EstimatorConfig) -> Floats:
    """`(4, 4)`."""
    return np.diag(
        [
            INITIAL_SIDESLIP_SD_RAD**2,
            INITIAL_YAW_RATE_SD_RADPS**2,
            INITIAL_HEADING_SD_RAD**2,
            INITIAL_OFFSET_SD_M**2,
        ]
    )


class VisionFilter:
    """Base of the camera filters: clock, model, noise, and the bridge over a lost camera."""

    fields = ("sideslip_rad", "yaw_rate_radps", "heading_rad", "lateral_offset_m")

    def __init__(self, car: Car, config: EstimatorConfig) -> None:
        self._config = config
        self._schedule = schedule(combined_vision, car, vision_density(config), config.step_s)
        self._clock = Clock(config.step_s)
        self._gyro_variance = config.gyro_sd_radps**2
        self._camera_noise = np.diag([config.heading_sd_rad**2, config.lateral_offset_sd_m**2])
        self._bridge = OutputBridge(4)
        self.dropped: dict[str, int] = {}
        self.gate = Gate(config, self.dropped)

    def _model(self, stamp_s: float, inputs: Inputs) -> tuple[Floats, Floats, Floats] | None:
        """G, H u and Q of the step to `stamp_s`, or None at the first."""
        elapsed = self._clock.advance(stamp_s)
        if not elapsed:
            return None
        g, h, q = self._schedule.at(inputs.speed_mps, elapsed)
        driven = h[:, 0] * inputs.road_wheel_angle_rad
        if inputs.yaw_moment_nm:
            driven += h[:, 1] * inputs.yaw_moment_nm
        curvature = inputs.road_curvature_per_m
        if curvature:
            driven[2:] += bend_of_lane(inputs.speed_mps, curvature, elapsed)
            # its error lasts as a bank or a rolling body does, as white noise of that length
            wrong = inputs.speed_mps * self._config.curvature_sd_per_m
            q[2, 2] += wrong * wrong * CURVATURE_ERROR_S * elapsed
        return g, driven, q

    def _wild(
        self, kind: str, stamp_s: float, residual: Floats, covariance: Floats, noise: Floats
    ) -> bool:
        """Whether the gate refuses a value: `residual` `(m,)`, its prior and noise `(m, m)`."""
        variances = np.diag(covariance) + np.diag(noise)
        numbers = zip(residual.tolist(), variances.tolist(), strict=True)
        return self.gate.refuses(kind, stamp_s, *numbers)

    def _drop(self, reason: str) -> None:
        self.dropped[reason] = self.dropped.get(reason, 0) + 1

    def _output(self, mean: Floats, covariance: Floats) -> Estimate:
        return self._bridge.output(self._clock.stamp_s, self.fields, mean, covariance)
