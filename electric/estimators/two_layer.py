"""Side-slip, yaw and velocities from a slow, late GPS and fast inertial sensors, in two layers."""

from __future__ import annotations

from enum import Enum
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
    YAW_RATE,
    Clock,
    Estimate,
    Inputs,
    OutputBridge,
    Value,
    fix_spread,
    pair,
)
from polemap.electric.estimators.gate import GPS_SPEED, Gate
from polemap.vehicle.delay import ClonedFilter
from polemap.vehicle.packed import rotate
from polemap.vehicle.parameters import Car
from polemap.vehicle.pose import rotate_covariance, wrap_angle
from polemap.vehicle.single_track import disturbed_course, planar_velocity_step, schedule

Floats = NDArray[np.float64]
# how long what the model lacks lasts, about a bend; errata.md says why it leaks
DISTURBANCE_TIME_S = 2.0
# standard deviation of the accelerometer's bias, roll in it: about 2 degrees of g
ACCELERATION_DISTURBANCE_MPS2 = 0.3
COURSE_SPEED_MPS = 2.0
"""Below it a GPS course says nothing."""
COURSE_ROW = np.array([[1.0, 0.0, 1.0, 0.0, 0.0]])
_CAPTURED = np.array([[1.0, 0.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0, 0.0]])  # beta, psi
_VELOCITY = np.eye(2, 4)


class Delay(Enum):
    """What is done about the GPS being late."""

    EXACT = "exact"  # clones
    RECONSTRUCTED = "reconstructed"  # N13: the value is carried to now by the model
    IGNORED = "ignored"  # taken for a value of now


class _Carrier:
    """A layer's state at a capture and what the model did since: `x_now = product x_s + driven`."""

    def __init__(self, stamp_s: float, mean: Floats, covariance: Floats) -> None:
        self.stamp_s, self.mean, self.covariance = stamp_s, mean, covariance
        self.product, self.driven = np.eye(len(mean)), np.zeros(len(mean))

    def carry(self, transition: Floats, driven: Floats) -> None:
        self.product = transition @ self.product
        self.driven = transition @ self.driven + driven


class TwoLayerKalman:
    """Layer 1: `[beta, gamma, psi, d_beta, d_gamma]` on yaw rate and GPS course (psi + beta).

    Layer 2: `[vx, vy, d_ax, d_ay]`, vx' = ax + d_ax + gamma vy and vy' = ay + d_ay - gamma vx,
    measured as V (cos beta, sin beta) with GPS speed and layer 1's side-slip at the capture. All
    disturbances leak. The delay is met exactly by clones, by the paper's reconstruction (22) with
    the product of the stored transitions, or ignored for comparison.

    Source: N13 (1)-(22) as corrected in errata.md, GPS layers 1 and 2.
    """

    fields = (
        "sideslip_rad",
        "yaw_rate_radps",
        "heading_rad",
        "sideslip_disturbance_radps",
        "yaw_disturbance_radps2",
        "vx_mps",
        "vy_mps",
    )

    def __init__(self, car: Car, config: EstimatorConfig, delay: Delay = Delay.EXACT) -> None:
        self._config, self._delay = config, delay
        tau = DISTURBANCE_TIME_S
        # a leaky disturbance of standard deviation s is driven by white noise of density 2 s^2/tau
        density = (
            config.sideslip_walk_rad**2,
            config.yaw_rate_walk_radps**2,
            config.heading_walk_rad**2,
            2.0 * config.sideslip_disturbance_radps**2 / tau,
            2.0 * config.yaw_disturbance_radps2**2 / tau,
        )
        self._schedule = schedule(_course_model(tau), car, density, config.step_s)
        self._clock = Clock(config.step_s)
        self._bridge = OutputBridge(7)
        self._spread = config.course_sd_rad, config.speed_sd_mps
        slots = config.gps_slots if delay is Delay.EXACT else 0
        start = np.diag(
            [
                INITIAL_SIDESLIP_SD_RAD**2,
                INITIAL_YAW_RATE_SD_RADPS**2,
                INITIAL_HEADING_SD_RAD**2,
                config.sideslip_disturbance_radps**2,
                config.yaw_disturbance_radps2**2,
            ]
        )
        bias = ACCELERATION_DISTURBANCE_MPS2**2
        self._angles = ClonedFilter(np.zeros(5), start, _CAPTURED, slots)
        speeds = np.diag([4.0, 1.0, bias, bias])
        self._speeds = ClonedFilter(np.zeros(4), speeds, _VELOCITY, slots)
        self._carriers: list[tuple[_Carrier, _Carrier]] = []
        self._gyro_variance = config.gyro_sd_radps**2
        self._headed = False
        self.dropped: dict[str, int] = {}
        self.gate = Gate(config, self.dropped)

    def step(self, stamp_s: float, inputs: Inputs) -> None:
        elapsed = self._clock.advance(stamp_s)
        if not elapsed:
            self._speeds.x[0] = inputs.speed_mps
            return
        yaw_rate = self._angles.x.item(1)
        g, h, q = self._schedule.at(inputs.speed_mps, elapsed)
        driven = h[:, 0] * inputs.road_wheel_angle_rad
        if inputs.yaw_moment_nm:
            driven += h[:, 1] * inputs.yaw_moment_nm
        turn, pushed, noise = self._velocity_model(yaw_rate, inputs, elapsed)
        self._angles.predict(g, driven, q)
        self._speeds.predict(turn, pushed, noise)
        for angles, speeds in self._carriers:
            angles.carry(g, driven)
            speeds.carry(turn, pushed)

    def _velocity_model(
        self, yaw_rate: float, inputs: Inputs, t: float
    ) -> tuple[Floats, Floats, Floats]:
        """Rotation by -yaw rate over t, the accelerations taken at half of it."""
        c, s, ch, sh = planar_velocity_step(yaw_rate, t)
        config = self._config
        leak = exp(-t / config.acceleration_disturbance_time_s)
        turn = np.array(
            [[c, s, ch, sh], [-s, c, -sh, ch], [0.0, 0.0, leak, 0.0], [0.0, 0.0, 0.0, leak]]
        )
        ax, ay = inputs.ax_mps2, inputs.ay_mps2
        pushed = np.array([ch * ax + sh * ay, -sh * ax + ch * ay, 0.0, 0.0])
        walk = config.acceleration_walk_mps**2 * t
        bias = ACCELERATION_DISTURBANCE_MPS2**2 * (1.0 - leak * leak)
        return turn, pushed, np.diag([walk, walk, bias, bias])

    def capture(self, kind: str, stamp_s: float) -> None:
        if kind != GPS:
            return
        if self._delay is Delay.EXACT:
            self._angles.capture(stamp_s)
            self._speeds.capture(stamp_s)
        elif self._delay is Delay.RECONSTRUCTED:
            a, v = self._angles, self._speeds
            pair_ = (
                _Carrier(stamp_s, a.x.copy(), a.p.copy()),
                _Carrier(stamp_s, v.x.copy(), v.p.copy()),
            )
            self._carriers = [*self._carriers, pair_][-self._config.gps_slots :]

    def measure(self, kind: str, value: Value, stamp_s: float, arrival_s: float) -> None:
        if kind == YAW_RATE:
            f, gyro = self._angles, float(value)  # type: ignore[arg-type]
            variance = self.gate.variance(YAW_RATE, self._gyro_variance)
            residual = gyro - f.x.item(1)
            if not self.gate.refuses(YAW_RATE, stamp_s, (residual, f.p.item(1, 1) + variance)):
                f.scalar(1, gyro, variance)
        elif kind == GPS:
            course, speed = pair(kind, value)
            self._spread = fix_spread(value, self._config.course_sd_rad, self._config.speed_sd_mps)
            before = self._mean()
            if self._take(course, speed, stamp_s):
                self._bridge.corrected(self._clock.stamp_s, before, self._mean())

    def _take(self, course: float, speed: float, stamp_s: float) -> bool:
        if self._delay is Delay.EXACT:
            taken = self._exact(course, speed, stamp_s)
        elif self._delay is Delay.RECONSTRUCTED:
            taken = self._reconstructed(course, speed, stamp_s)
        else:
            taken = True
            if speed >= COURSE_SPEED_MPS:
                self._course(COURSE_ROW, course)
            beta = self._angles.x.item(0)
            self._velocity(_VELOCITY, beta, self._angles.p.item(0, 0), speed, None)
        if not taken:
            self.dropped["gps value without a capture"] = (
                self.dropped.get("gps value without a capture", 0) + 1
            )
        return taken

    def _exact(self, course: float, speed: float, stamp_s: float) -> bool:
        rows, speed_rows = self._angles.clone(stamp_s), self._speeds.clone(stamp_s)
        if rows is None or speed_rows is None:
            return False
        if speed >= COURSE_SPEED_MPS:
            jacobian = np.zeros((1, self._angles.size))
            jacobian[0, rows] = 1.0
            self._course(jacobian, course)
        beta, variance = self._angles.x.item(rows.start), self._angles.p[rows.start, rows.start]
        seen = np.zeros((2, self._speeds.size))
        seen[0, speed_rows.start] = seen[1, speed_rows.start + 1] = 1.0
        self._velocity(seen, beta, float(variance), speed, None)
        self._angles.release(stamp_s)
        self._speeds.release(stamp_s)
        return True

    def _reconstructed(self, course: float, speed: float, stamp_s: float) -> bool:
        found = [c for c in self._carriers if abs(c[0].stamp_s - stamp_s) < 1e-6]
        if not found:
            return False
        angles, speeds = found[0]
        self._carriers = [c for c in self._carriers if c is not found[0]]
        beta, variance = float(angles.mean[0]), float(angles.covariance[0, 0])
        if speed >= COURSE_SPEED_MPS:
            # the late value corrects the state of its capture; the model brings that to now
            cross = angles.covariance @ COURSE_ROW[0]
            s = float(COURSE_ROW[0] @ cross) + self._spread[0] ** 2
            error = float(wrap_angle(course - float(COURSE_ROW[0] @ angles.mean)))
            if not self._headed:
                self._set_heading(error)
                angles.mean[2] += error
                error = 0.0
            if not self.gate.refuses(GPS, stamp_s, (error, s)):
                then = angles.mean + cross / s * error
                now = angles.product @ then + angles.driven
                self._correct_course(COURSE_ROW, float(COURSE_ROW[0] @ (now - self._angles.x)))
                beta, variance = float(then[0]), variance - float(cross[0]) ** 2 / s
        measured = np.array(rotate(speed, 0.0, beta))
        then_speeds = speeds.mean.copy()
        then_speeds[:2] = measured
        now_speeds = speeds.product @ then_speeds + speeds.driven
        self._velocity(_VELOCITY, beta, variance, speed, now_speeds[:2])
        return True

    def _course(self, jacobian: Floats, course: float) -> None:
        f = self._angles
        residual = float(wrap_angle(course - float((jacobian @ f.x)[0])))
        if not self._headed:
            self._set_heading(residual)
            residual = 0.0
        variance = float(jacobian[0] @ f.p @ jacobian[0]) + self._spread[0] ** 2
        if not self.gate.refuses(GPS, self._clock.stamp_s, (residual, variance)):
            self._correct_course(jacobian, residual)

    def _correct_course(self, jacobian: Floats, residual_rad: float) -> None:
        noise = np.array([[self._spread[0] ** 2]])
        self._angles.update(jacobian, np.array([residual_rad]), noise)

    def _set_heading(self, change_rad: float) -> None:
        """Before the first course the heading is anything; later steps are small and linear."""
        self._headed = True
        f = self._angles
        f.x[2] += change_rad
        # the captures still on their way saw the same heading
        f.x[f.n + 1 :: 2] += change_rad
        for angles, _ in self._carriers:
            angles.mean[2] += change_rad

    def _velocity(
        self,
        jacobian: Floats,
        beta: float,
        beta_variance: float,
        speed: float,
        measured: Floats | None,
    ) -> None:
        if measured is None:
            measured = np.array(rotate(speed, 0.0, beta))
        across = speed * speed * beta_variance + 1e-4
        noise = rotate_covariance(np.diag([self._spread[1] ** 2, across]), beta)
        f, residual = self._speeds, measured - jacobian @ self._speeds.x
        variances = np.einsum("ij,jk,ik->i", jacobian, f.p, jacobian) + np.diag(noise)
        numbers = zip(residual.tolist(), variances.tolist(), strict=True)
        if not self.gate.refuses(GPS_SPEED, self._clock.stamp_s, *numbers):
            f.update(jacobian, residual, noise)

    def _mean(self) -> Floats:
        return np.concatenate([self._angles.x[:5], self._speeds.x[:2]])

    def estimate(self) -> Estimate:
        return self._bridge.output(
            self._clock.stamp_s, self.fields, self._mean(), self.covariance()
        )

    def covariance(self) -> Floats:
        """`(7, 7)`, block diagonal: the layers do not know of each other's errors."""
        p = np.zeros((7, 7))
        p[:5, :5], p[5:, 5:] = self._angles.p[:5, :5], self._speeds.p[:2, :2]
        return p


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


def _course_model(time_constant_s: float) -> _CourseModel:
    return _CourseModel(time_constant_s)
