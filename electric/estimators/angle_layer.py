"""Layer 1 of N13: side-slip, yaw rate and heading from a gyro and a GPS's course."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from polemap.electric.config import (
    INITIAL_HEADING_SD_RAD,
    INITIAL_SIDESLIP_SD_RAD,
    INITIAL_YAW_RATE_SD_RADPS,
    EstimatorConfig,
)
from polemap.electric.estimators.base import GPS, YAW_RATE, Inputs
from polemap.electric.estimators.gate import Gate
from polemap.vehicle.delay import ClonedFilter
from polemap.vehicle.parameters import Car
from polemap.vehicle.pose import wrap_angle
from polemap.vehicle.single_track import disturbed_course, schedule

Floats = NDArray[np.float64]
# how long what the model lacks lasts, about a bend; errata.md says why it leaks
DISTURBANCE_TIME_S = 2.0
COURSE_ROW = np.array([[1.0, 0.0, 1.0, 0.0, 0.0]])
"""A course is psi + beta."""
_CAPTURED = np.array([[1.0, 0.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0, 0.0]])  # beta, psi


class AngleLayer:
    """Kalman filter of `[beta, gamma, psi, d_beta, d_gamma]`; the disturbances leak.

    Args:
        slots: captures that may be on their way at once.
        gate: leaves out values that cannot be.

    Attributes:
        filter: the states of now and of the captures.
        headed: whether a course has told the heading.
    """

    def __init__(self, car: Car, config: EstimatorConfig, slots: int, gate: Gate) -> None:
        tau = DISTURBANCE_TIME_S
        # a leaky disturbance of standard deviation s is driven by white noise of density 2 s^2/tau
        density = (
            config.sideslip_walk_rad**2,
            config.yaw_rate_walk_radps**2,
            config.heading_walk_rad**2,
            2.0 * config.sideslip_disturbance_radps**2 / tau,
            2.0 * config.yaw_disturbance_radps2**2 / tau,
        )
        self._schedule = schedule(_CourseModel(tau), car, density, config.step_s)
        start = np.diag(
            [
                INITIAL_SIDESLIP_SD_RAD**2,
                INITIAL_YAW_RATE_SD_RADPS**2,
                INITIAL_HEADING_SD_RAD**2,
                config.sideslip_disturbance_radps**2,
                config.yaw_disturbance_radps2**2,
            ]
        )
        self.filter = ClonedFilter(np.zeros(5), start, _CAPTURED, slots)
        self._gyro_variance = config.gyro_sd_radps**2
        self._gate = gate
        self.headed = False

    def step(self, elapsed_s: float, inputs: Inputs) -> tuple[Floats, Floats]:
        """Predict; the transition `(5, 5)` and what drives it `(5,)`."""
        g, h, q = self._schedule.at(inputs.speed_mps, elapsed_s)
        driven = h[:, 0] * inputs.road_wheel_angle_rad
        if inputs.yaw_moment_nm:
            driven += h[:, 1] * inputs.yaw_moment_nm
        self.filter.predict(g, driven, q)
        return g, driven

    def turned(self, gyro_radps: float, stamp_s: float) -> None:
        """A yaw rate."""
        f = self.filter
        variance = self._gate.variance(YAW_RATE, self._gyro_variance)
        residual = gyro_radps - f.x.item(1)
        if not self._gate.refuses(YAW_RATE, stamp_s, (residual, f.p.item(1, 1) + variance)):
            f.scalar(1, gyro_radps, variance)

    def ahead(self, jacobian: Floats, course_rad: float) -> float:
        """What a course is ahead of the one that is held, as `jacobian` `(1, n)` sees it."""
        return float(wrap_angle(course_rad - float((jacobian @ self.filter.x)[0])))

    def course(self, jacobian: Floats, ahead_rad: float, sd_rad: float, stamp_s: float) -> None:
        """A course that is `ahead_rad` of the one that is held, unless it cannot be."""
        variance = float(jacobian[0] @ self.filter.p @ jacobian[0]) + sd_rad**2
        if not self._gate.refuses(GPS, stamp_s, (ahead_rad, variance)):
            self.correct(jacobian, ahead_rad, sd_rad)

    def correct(self, jacobian: Floats, ahead_rad: float, sd_rad: float) -> None:
        """A course that is believed."""
        self.filter.update(jacobian, np.array([ahead_rad]), np.array([[sd_rad**2]]))

    def head(self, change_rad: float) -> None:
        """Before the first course the heading is anything; later steps are small and linear."""
        self.headed = True
        f = self.filter
        f.x[2] += change_rad
        # the captures still on their way saw the same heading
        f.x[f.n + 1 :: 2] += change_rad


class _CourseModel:
    """`disturbed_course` with its time constant bound; equal ones share their tables."""

    def __init__(self, time_constant_s: float) -> None:
        self.time_constant_s = time_constant_s

    def __call__(self, car: Car, speed_mps: float) -> tuple[Floats, Floats]:
        return disturbed_course(car, speed_mps, self.time_constant_s)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _CourseModel) and other.time_constant_s == self.time_constant_s

    def __hash__(self) -> int:
        return hash(self.time_constant_s)
