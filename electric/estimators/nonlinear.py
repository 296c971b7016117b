"""Beyond the papers: a single track on brush tyres that knows where its model and sensors end."""

from __future__ import annotations

from math import exp

import numpy as np
from numpy.typing import NDArray

from polemap.electric.config import (
    INITIAL_HEADING_SD_RAD,
    INITIAL_SIDESLIP_SD_RAD,
    INITIAL_YAW_RATE_SD_RADPS,
    EstimatorConfig,
)
from polemap.electric.estimators.base import (
    GPS,
    LATERAL_ACCELERATION,
    YAW_RATE,
    Clock,
    Estimate,
    Inputs,
    OutputBridge,
    Value,
    pair,
)
from polemap.vehicle.axles import Axles
from polemap.vehicle.delay import ClonedFilter
from polemap.vehicle.parameters import Car
from polemap.vehicle.pose import wrap_angle
from polemap.vehicle.single_track import KINEMATIC_SPEED_MPS, lateral

Floats = NDArray[np.float64]

_N = 9
_BETA, _GAMMA, _PSI, _FORCE, _MOMENT, _AY_BIAS, _SCALE, _STEERING, _GYRO_BIAS = range(_N)

# What the tyres' model lacks, one sigma, and how long it lasts: transients and load transfer
# across, shorter than a bend
FORCE_DISTURBANCE_MPS2, FORCE_TIME_S = 0.8, 1.0
MOMENT_DISTURBANCE_RADPS2, MOMENT_TIME_S = 0.3, 0.5
# the road's friction and the tyres' stiffness together, as the logarithm of a common factor
SCALE_SD, SCALE_TIME_S = 0.04, 30.0
# accelerometer: bank of the road, roll and bias, 2.5 degrees of g
AY_BIAS_MPS2, AY_BIAS_TIME_S = 0.5, 5.0
STEERING_OFFSET_SD_RAD, STEERING_OFFSET_WALK_RAD = 0.003, 1e-5
GYRO_BIAS_SD_RADPS, GYRO_BIAS_WALK_RADPS = 2e-3, 1e-5
SIDESLIP_WALK_RAD, YAW_RATE_WALK_RADPS = 0.005, 0.15
# noise of the accelerometer: measured from the changes between its values over this time, and never
# below a density that roll and vibration have at any rate
_NOISE_TIME_S, _NOISE_START_MPS2, _NOISE_DENSITY = 2.0, 1.5, 0.1
# a tyre at its limit still answers the linear model by this share of its stiffness, else the filter
# would hold its side-slip for unobservable there
_LEAST_SLOPE = 0.08
_AY_SPEED_MPS, _COURSE_SPEED_MPS = 3.0, 2.0
# beyond this many deviations a value is weighed down as if it stood there (Huber)
_OUTLIER_SD = 4.0
_SIDESLIP_MAX_RAD, _SCALE_MAX = 0.6, 0.7
_ALONG_TIME_S = 0.1


class NonlinearKalman:
    """Extended Kalman filter of a single track on brush tyres with load transfer.

    State `[beta, gamma, psi, d_y, d_z, b_y, kappa, delta_0, b_gamma]`: side-slip, yaw rate,
    heading; what the model lacks in lateral and yaw acceleration (leaky, so that the accelerometer
    moves the side-slip at once: beta' = a_y / v - gamma); bias of the accelerometer with bank and
    roll; logarithm of a common factor of all tyre forces; offsets of steering and gyro.

    Measured: yaw rate gamma + b_gamma, lateral acceleration, course psi + beta of a GPS, exact for
    its delay by clones. Accelerometer and GPS are used where the log has them. Below
    `KINEMATIC_SPEED_MPS` the car rolls without slip as in `lateral`.

    Source: single track, brush tyres and ellipse as in Pacejka, Tyre and Vehicle Dynamics, 3rd
    ed., ch. 1 and 3; disturbance states as N13 (18), (19); step: linearly implicit midpoint rule.
    """

    fields = (
        "sideslip_rad",
        "yaw_rate_radps",
        "heading_rad",
        "force_disturbance_mps2",
        "moment_disturbance_radps2",
        "acceleration_bias_mps2",
        "tyre_force_log_scale",
        "steering_offset_rad",
        "gyro_bias_radps",
    )

    def __init__(self, car: Car, config: EstimatorConfig) -> None:
        self._car, self._config, self._axles = car, config, Axles(car)
        self._limits = self._axles.limits(0.0)
        sds = (
            INITIAL_SIDESLIP_SD_RAD,
            INITIAL_YAW_RATE_SD_RADPS,
            INITIAL_HEADING_SD_RAD,
            FORCE_DISTURBANCE_MPS2,
            MOMENT_DISTURBANCE_RADPS2,
            AY_BIAS_MPS2,
            SCALE_SD,
            STEERING_OFFSET_SD_RAD,
            GYRO_BIAS_SD_RADPS,
        )
        selection = np.zeros((1, _N))
        selection[0, _BETA] = selection[0, _PSI] = 1.0
        self._filter = ClonedFilter(
            np.zeros(_N), np.diag(np.square(sds)), selection, config.gps_slots
        )
        self._transition = np.eye(_N)
        self._timed = float("nan")
        self._noise = np.zeros((_N, _N))
        self._gyro_row, self._ay_row = np.zeros(self._filter.size), np.zeros(self._filter.size)
        self._gyro_row[_GAMMA] = self._gyro_row[_GYRO_BIAS] = 1.0
        self._ay_row[_FORCE] = self._ay_row[_AY_BIAS] = 1.0
        self._gyro_variance = config.gyro_sd_radps**2
        self._clock = Clock(config.step_s)
        self._bridge = OutputBridge(_N)
        self._steering = self._along = 0.0
        self._speed = KINEMATIC_SPEED_MPS
        self._ay_last = float("nan")
        self._ay_variance = _NOISE_START_MPS2**2
        self._step_s = config.step_s
        self._headed = False
        self.dropped: dict[str, int] = {}

    def step(self, stamp_s: float, inputs: Inputs) -> None:
        t = self._clock.advance(stamp_s)
        if not t:
            self._steering, self._speed = inputs.road_wheel_angle_rad, abs(inputs.speed_mps)
            return
        self._step_s = t
        self._along += (inputs.ax_mps2 - self._along) * min(1.0, t / _ALONG_TIME_S)
        self._limits = self._axles.limits(self._along)
        self._steering, self._speed = inputs.road_wheel_angle_rad, inputs.speed_mps
        if t != self._timed:
            self._time(t)
        if self._speed >= KINEMATIC_SPEED_MPS:
            self._on_tyres(t, inputs.yaw_moment_nm)
        else:
            self._rolling(t)
        x = self._filter.x
        x[_BETA] = min(max(x.item(_BETA), -_SIDESLIP_MAX_RAD), _SIDESLIP_MAX_RAD)
        x[_SCALE] = min(max(x.item(_SCALE), -_SCALE_MAX), _SCALE_MAX)

    def _time(self, t: float) -> None:
        """Leaks and noise of a step."""
        self._timed, g, q = t, self._transition, self._noise
        for index, sd, time_s in (
            (_FORCE, FORCE_DISTURBANCE_MPS2, FORCE_TIME_S),
            (_MOMENT, MOMENT_DISTURBANCE_RADPS2, MOMENT_TIME_S),
            (_AY_BIAS, AY_BIAS_MPS2, AY_BIAS_TIME_S),
            (_SCALE, SCALE_SD, SCALE_TIME_S),
        ):
            leak = exp(-t / time_s)
            g[index, index] = leak
            q[index, index] = sd * sd * (1.0 - leak * leak)
        for index, walk in (
            (_BETA, SIDESLIP_WALK_RAD),
            (_GAMMA, YAW_RATE_WALK_RADPS),
            (_PSI, self._config.heading_walk_rad),
            (_STEERING, STEERING_OFFSET_WALK_RAD),
            (_GYRO_BIAS, GYRO_BIAS_WALK_RADPS),
        ):
            q[index, index] = walk * walk * t
        g[_PSI, _GAMMA] = t

    def _forces(self) -> tuple[float, float, float, float]:
        """Front force, slope, rear force, slope at the state, slopes at least `_LEAST_SLOPE`."""
        x, limits = self._filter.x, self._limits
        front, front_slope, rear, rear_slope = self._axles.forces(
            x.item(_BETA), x.item(_GAMMA), self._steering - x.item(_STEERING), self._speed, limits
        )
        scale = exp(x.item(_SCALE))
        return (
            scale * front,
            scale * min(front_slope, -_LEAST_SLOPE * limits[0]),
            scale * rear,
            scale * min(rear_slope, -_LEAST_SLOPE * limits[2]),
        )

    def _on_tyres(self, t: float, moment_nm: float) -> None:
        f, car, v, g = self._filter, self._car, self._speed, self._transition
        x, m, inertia = f.x, car.mass_kg, car.yaw_inertia_kgm2
        lf, lr = car.cg_to_front_m, car.cg_to_rear_m
        front, front_slope, rear, rear_slope = self._forces()
        beta, gamma = x.item(_BETA), x.item(_GAMMA)
        force, turning = (front + rear) / (m * v), (lf * front - lr * rear) / inertia
        beta_rate = force + x.item(_FORCE) / v - gamma - beta * self._along / v
        gamma_rate = turning + x.item(_MOMENT) + moment_nm / inertia
        # A of the rates by beta and gamma; W = t (I - t/2 A)^-1; x+ = x + W f(x), G = I + W A
        moment_slope = (lf * front_slope - lr * rear_slope) / inertia
        a00 = (front_slope + rear_slope) / (m * v) - self._along / v
        a01 = moment_slope * inertia / (m * v * v) - 1.0
        a11 = (lf * lf * front_slope + lr * lr * rear_slope) / (inertia * v)
        h = 0.5 * t
        b00, b01, b10, b11 = 1.0 - h * a00, -h * a01, -h * moment_slope, 1.0 - h * a11
        inverse = t / (b00 * b11 - b01 * b10)
        w00, w01, w10, w11 = inverse * b11, -inverse * b01, -inverse * b10, inverse * b00
        steered, steered_turn = front_slope / (m * v), lf * front_slope / inertia
        g[0, 0], g[0, 1] = 1.0 + w00 * a00 + w01 * moment_slope, w00 * a01 + w01 * a11
        g[1, 0], g[1, 1] = w10 * a00 + w11 * moment_slope, 1.0 + w10 * a01 + w11 * a11
        g[0, _FORCE], g[1, _FORCE] = w00 / v, w10 / v
        g[0, _MOMENT], g[1, _MOMENT] = w01, w11
        g[0, _SCALE], g[1, _SCALE] = w00 * force + w01 * turning, w10 * force + w11 * turning
        g[0, _STEERING] = w00 * steered + w01 * steered_turn
        g[1, _STEERING] = w10 * steered + w11 * steered_turn
        self._predict(
            beta + w00 * beta_rate + w01 * gamma_rate,
            gamma + w10 * beta_rate + w11 * gamma_rate,
            x.item(_PSI) + t * (gamma + 0.5 * (w10 * beta_rate + w11 * gamma_rate)),
        )

    def _rolling(self, t: float) -> None:
        """Too slow for tyres: side-slip and yaw rate relax to those of rolling without slip."""
        f, g = self._filter, self._transition
        a, b = lateral(self._car, max(self._speed, 0.0))
        steering = self._steering - f.x.item(_STEERING)
        g[:2, _FORCE:] = 0.0
        ends = []
        for index in (_BETA, _GAMMA):
            leak = exp(a[index, index] * t)
            answer = b[index, 0] / -a[index, index]
            g[index, :2] = 0.0
            g[index, index] = leak
            g[index, _STEERING] = -(1.0 - leak) * answer
            ends.append(leak * f.x.item(index) + (1.0 - leak) * answer * steering)
        self._predict(ends[0], ends[1], f.x.item(_PSI) + t * f.x.item(_GAMMA))

    def _predict(self, beta: float, gamma: float, psi: float) -> None:
        f, g = self._filter, self._transition
        driven = -(g @ f.x[:_N])
        driven[_BETA] += beta
        driven[_GAMMA] += gamma
        driven[_PSI] += psi
        driven[_FORCE:] = 0.0
        f.predict(g, driven, self._noise)

    def capture(self, kind: str, stamp_s: float) -> None:
        if kind == GPS:
            # the course of the antenna: psi + beta + x gamma / v
            ahead = self._car.gps_point_m / max(self._speed, KINEMATIC_SPEED_MPS)
            self._filter.selection[0, _GAMMA] = ahead
            self._filter.capture(stamp_s)

    def measure(self, kind: str, value: Value, stamp_s: float, arrival_s: float) -> None:
        if kind == YAW_RATE:
            x = self._filter.x
            residual = float(value) - x.item(_GAMMA) - x.item(_GYRO_BIAS)  # type: ignore[arg-type]
            self._take(self._gyro_row, residual, self._gyro_variance, "gyro")
        elif kind == LATERAL_ACCELERATION:
            self._lateral(float(value))  # type: ignore[arg-type]
        elif kind == GPS:
            course, speed = pair(kind, value)
            self._course(course, speed, stamp_s)

    def _lateral(self, ay_mps2: float) -> None:
        change, self._ay_last = ay_mps2 - self._ay_last, ay_mps2
        if change == change and change != 0.0:
            share = min(1.0, self._step_s / _NOISE_TIME_S)
            self._ay_variance += share * (0.5 * change * change - self._ay_variance)
        if self._speed < _AY_SPEED_MPS:
            return
        front, front_slope, rear, rear_slope = self._forces()
        car, m, v, row = self._car, self._car.mass_kg, self._speed, self._ay_row
        x = self._filter.x
        across = (front + rear) / m
        row[_BETA] = (front_slope + rear_slope) / m
        row[_GAMMA] = (car.cg_to_front_m * front_slope - car.cg_to_rear_m * rear_slope) / (m * v)
        row[_SCALE], row[_STEERING] = across, front_slope / m
        residual = ay_mps2 - across - x.item(_FORCE) - x.item(_AY_BIAS)
        least = _NOISE_DENSITY * _NOISE_DENSITY / self._step_s
        self._take(row, residual, max(self._ay_variance, least), "lateral acceleration")

    def _take(self, row: Floats, residual: float, variance: float, what: str) -> None:
        """One number, weighed down where it stands too far off."""
        if self._filter.row(row, residual, variance, _OUTLIER_SD):
            self._count(f"{what} beyond {_OUTLIER_SD:g} deviations, weighed down")

    def _course(self, course_rad: float, speed_mps: float, stamp_s: float) -> None:
        f = self._filter
        rows = f.clone(stamp_s)
        if rows is None:
            self._count("gps value without a capture")
            return
        if speed_mps >= _COURSE_SPEED_MPS:
            before = f.x[:_N].copy()
            residual = float(wrap_angle(course_rad - f.x.item(rows.start)))
            if not self._headed:
                # before the first course the heading is anything; later steps are small
                self._headed = True
                f.x[_PSI] += residual
                f.x[_N:] += residual
                residual = 0.0
            row = np.zeros(f.size)
            row[rows.start] = 1.0
            sd = max(self._config.course_sd_rad, self._config.speed_sd_mps / speed_mps)
            self._take(row, residual, sd * sd, "gps course")
            self._bridge.corrected(self._clock.stamp_s, before, f.x[:_N])
        f.release(stamp_s)

    def _count(self, reason: str) -> None:
        self.dropped[reason] = self.dropped.get(reason, 0) + 1

    def estimate(self) -> Estimate:
        f = self._filter
        return self._bridge.output(self._clock.stamp_s, self.fields, f.x[:_N].copy(), f.p[:_N, :_N])

    def covariance(self) -> Floats:
        return self._filter.p[:_N, :_N].copy()
