"""The plant's sensors, with rates, delays and noise, and how they feed an estimator as it runs."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from math import atan2, cos, hypot, sin
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from polemap.electric.estimators.base import (
    CAMERA,
    GPS,
    LATERAL_ACCELERATION,
    WHEEL_SPEED,
    YAW_RATE,
    Estimator,
    Inputs,
)
from polemap.simulate.plant import GRAVITY_MPS2, REAR_LEFT, REAR_RIGHT, PlantParameters, PlantState

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class SensorModel:
    """Noise (sd), bias, rates and delays.

    The accelerometer reads `ay + g sin(roll)` with the body's roll proportional to ay. The camera
    looks along a straight lane on the line north = 0 that runs east.

    Source: camera and gyro of errata.md, What simulation reproduces; GPS N13 2.1 and 5.1 (20 Hz
    receiver, thinned to 5 Hz and 100 ms late in the paper's tests); the rest are assumptions.
    """

    gyro_sd_radps: float = 0.003
    acceleration_sd_mps2: float = 0.3
    acceleration_bias_mps2: float = 0.1
    roll_rad_per_mps2: float = 0.007
    steering_sd_rad: float = 0.0005
    wheel_sd_radps: float = 0.05
    preview_m: float = 0.0
    camera_period_s: float = 0.033
    camera_delay_s: float = 0.033
    heading_sd_rad: float = 0.002
    offset_sd_m: float = 0.005
    gps_period_s: float = 0.2
    gps_delay_s: float = 0.1
    course_sd_rad: float = 0.003
    gps_speed_sd_mps: float = 0.05


class Measured(NamedTuple):
    """What the fast sensors say at one step."""

    steering_rad: float
    speed_mps: float
    yaw_rate_radps: float
    ax_mps2: float
    ay_mps2: float
    yaw_moment_nm: float
    wheel_radps: tuple[float, float, float, float]
    late: frozenset[str] = frozenset()
    gps_speed_mps: float | None = None


class SensorFeed:
    """Measures a plant step by step and hands everything to an estimator as it arrives.

    Args:
        late: the late sensors that the car has.
    """

    def __init__(
        self,
        parameters: PlantParameters,
        model: SensorModel,
        rng: np.random.Generator,
        estimator: Estimator | None = None,
        late: tuple[str, ...] = (GPS,),
    ) -> None:
        self._parameters, self._model, self._rng = parameters, model, rng
        self._estimator = estimator
        self._inputs: Inputs | None = None
        self._waiting: deque[tuple[float, str, tuple[float, float], float]] = deque()
        periods = {GPS: model.gps_period_s, CAMERA: model.camera_period_s}
        self._next = {kind: periods[kind] for kind in late}

    def step(self, state: PlantState) -> Measured:
        """The measurements at the state's stamp; the estimator has taken them in."""
        p, m = self._parameters, self._model
        e = self._rng.standard_normal(9).tolist()
        left, right, *rear = (
            w + m.wheel_sd_radps * n for w, n in zip(state.wheel_radps, e, strict=False)
        )
        steering = state.steer_rad + m.steering_sd_rad * e[4]
        # the free front wheels roll along their own plane
        speed = p.wheel_radius_m * 0.5 * (left + right) * cos(steering)
        yaw_rate = state.yaw_rate_radps + m.gyro_sd_radps * e[5]
        ax = state.ax_mps2 + m.acceleration_sd_mps2 * e[6]
        ay = state.ay_mps2 + GRAVITY_MPS2 * sin(m.roll_rad_per_mps2 * state.ay_mps2)
        ay += m.acceleration_bias_mps2 + m.acceleration_sd_mps2 * e[7]
        moment = (state.torque_nm[REAR_RIGHT] - state.torque_nm[REAR_LEFT]) * p.track_m
        moment /= 2.0 * p.wheel_radius_m
        inputs = Inputs(steering, speed, moment, ax, ay, yaw_rate)
        stamp, estimator = state.time_s, self._estimator
        if estimator is not None:
            estimator.step(stamp, self._inputs or inputs)
            estimator.measure(YAW_RATE, yaw_rate, stamp, stamp)
            estimator.measure(LATERAL_ACCELERATION, ay, stamp, stamp)
            estimator.measure(WHEEL_SPEED, speed, stamp, stamp)
        self._inputs = inputs
        late, gps_speed = self._arrivals(stamp)
        self._capture(state)
        return Measured(
            steering,
            speed,
            yaw_rate,
            ax,
            ay,
            moment,
            (left, right, rear[0], rear[1]),
            late,
            gps_speed,
        )

    def _arrivals(self, stamp: float) -> tuple[frozenset[str], float | None]:
        late, speed = set(), None
        while self._waiting and self._waiting[0][0] <= stamp + 1e-9:
            _, kind, value, taken = self._waiting.popleft()
            late.add(kind)
            if kind == GPS:
                speed = value[1]
            if self._estimator is not None:
                self._estimator.measure(kind, value, taken, stamp)
        return frozenset(late), speed

    def _capture(self, state: PlantState) -> None:
        stamp, m = state.time_s, self._model
        for kind, due in self._next.items():
            if stamp + 1e-9 < due:
                continue
            a, b = self._rng.standard_normal(2).tolist()
            if kind == CAMERA:
                period, delay = m.camera_period_s, m.camera_delay_s
                offset = state.north_m + m.preview_m * state.yaw_rad
                value = (state.yaw_rad + m.heading_sd_rad * a, offset + m.offset_sd_m * b)
            else:
                period, delay = m.gps_period_s, m.gps_delay_s
                course = state.yaw_rad + atan2(state.vy_mps, state.vx_mps)
                speed = hypot(state.vx_mps, state.vy_mps)
                value = (course + m.course_sd_rad * a, speed + m.gps_speed_sd_mps * b)
            self._next[kind] = due + period
            if self._estimator is not None:
                self._estimator.capture(kind, stamp)
            self._waiting.append((stamp + delay, kind, value, stamp))
        if len(self._waiting) > 1:
            self._waiting = deque(sorted(self._waiting))
