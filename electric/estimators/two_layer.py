"""Side-slip, yaw and velocities from a slow, late GPS and fast inertial sensors, in two layers."""

from __future__ import annotations

from enum import Enum

import numpy as np
from numpy.typing import NDArray

from polemap.electric.config import EstimatorConfig
from polemap.electric.estimators.angle_layer import COURSE_ROW, AngleLayer
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
from polemap.electric.estimators.gate import Gate
from polemap.electric.estimators.velocity_layer import VELOCITY_ROWS, VelocityLayer, velocity
from polemap.vehicle.parameters import Car
from polemap.vehicle.pose import wrap_angle

Floats = NDArray[np.float64]
COURSE_SPEED_MPS = 2.0
"""Below it a GPS course says nothing."""


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
    """`AngleLayer` on yaw rate and GPS course, `VelocityLayer` on accelerations and its side-slip.

    The delay is met exactly by clones, by the paper's reconstruction (22) with the product of the
    stored transitions, or ignored for comparison.

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
        self.dropped: dict[str, int] = {}
        self.gate = Gate(config, self.dropped)
        slots = config.gps_slots if delay is Delay.EXACT else 0
        self._angles = AngleLayer(car, config, slots, self.gate)
        self._speeds = VelocityLayer(config, slots, self.gate)
        self._clock = Clock(config.step_s)
        self._bridge = OutputBridge(7)
        self._spread = config.course_sd_rad, config.speed_sd_mps
        self._carriers: list[tuple[_Carrier, _Carrier]] = []

    def step(self, stamp_s: float, inputs: Inputs) -> None:
        elapsed = self._clock.advance(stamp_s)
        if not elapsed:
            self._speeds.filter.x[0] = inputs.speed_mps
            return
        yaw_rate = self._angles.filter.x.item(1)
        turned = self._angles.step(elapsed, inputs)
        moved = self._speeds.step(yaw_rate, inputs, elapsed)
        for angles, speeds in self._carriers:
            angles.carry(*turned)
            speeds.carry(*moved)

    def capture(self, kind: str, stamp_s: float) -> None:
        if kind != GPS:
            return
        filters = self._angles.filter, self._speeds.filter
        if self._delay is Delay.EXACT:
            for each in filters:
                each.capture(stamp_s)
        elif self._delay is Delay.RECONSTRUCTED:
            angles, speeds = (_Carrier(stamp_s, f.x.copy(), f.p.copy()) for f in filters)
            self._carriers = [*self._carriers, (angles, speeds)][-self._config.gps_slots :]

    def measure(self, kind: str, value: Value, stamp_s: float, arrival_s: float) -> None:
        if kind == YAW_RATE:
            self._angles.turned(float(value), stamp_s)  # type: ignore[arg-type]
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
            f = self._angles.filter
            slip = f.x.item(0), f.p.item(0, 0)
            self._velocity(VELOCITY_ROWS, velocity(speed, slip[0]), slip, speed)
        if not taken:
            self.dropped["gps value without a capture"] = (
                self.dropped.get("gps value without a capture", 0) + 1
            )
        return taken

    def _exact(self, course: float, speed: float, stamp_s: float) -> bool:
        angles, speeds = self._angles.filter, self._speeds.filter
        rows, speed_rows = angles.clone(stamp_s), speeds.clone(stamp_s)
        if rows is None or speed_rows is None:
            return False
        if speed >= COURSE_SPEED_MPS:
            jacobian = np.zeros((1, angles.size))
            jacobian[0, rows] = 1.0
            self._course(jacobian, course)
        slip = angles.x.item(rows.start), float(angles.p[rows.start, rows.start])
        seen = np.zeros((2, speeds.size))
        seen[0, speed_rows.start] = seen[1, speed_rows.start + 1] = 1.0
        self._velocity(seen, velocity(speed, slip[0]), slip, speed)
        angles.release(stamp_s)
        speeds.release(stamp_s)
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
            if not self._angles.headed:
                self._head(error)
                angles.mean[2] += error
                error = 0.0
            if not self.gate.refuses(GPS, stamp_s, (error, s)):
                then = angles.mean + cross / s * error
                now = angles.product @ then + angles.driven
                ahead = float(COURSE_ROW[0] @ (now - self._angles.filter.x))
                self._angles.correct(COURSE_ROW, ahead, self._spread[0])
                beta, variance = float(then[0]), variance - float(cross[0]) ** 2 / s
        then_speeds = speeds.mean.copy()
        then_speeds[:2] = velocity(speed, beta)
        now_speeds = speeds.product @ then_speeds + speeds.driven
        self._velocity(VELOCITY_ROWS, now_speeds[:2], (beta, variance), speed)
        return True

    def _course(self, jacobian: Floats, course: float) -> None:
        ahead = self._angles.ahead(jacobian, course)
        if not self._angles.headed:
            self._head(ahead)
            ahead = 0.0
        self._angles.course(jacobian, ahead, self._spread[0], self._clock.stamp_s)

    def _head(self, change_rad: float) -> None:
        self._angles.head(change_rad)
        for angles, _ in self._carriers:
            angles.mean[2] += change_rad

    def _velocity(
        self, jacobian: Floats, measured: Floats, slip: tuple[float, float], speed: float
    ) -> None:
        spread = speed, self._spread[1]
        self._speeds.correct(jacobian, measured, slip, spread, self._clock.stamp_s)

    def _mean(self) -> Floats:
        return np.concatenate([self._angles.filter.x[:5], self._speeds.filter.x[:2]])

    def estimate(self) -> Estimate:
        return self._bridge.output(
            self._clock.stamp_s, self.fields, self._mean(), self.covariance()
        )

    def covariance(self) -> Floats:
        """`(7, 7)`, block diagonal: the layers do not know of each other's errors."""
        p = np.zeros((7, 7))
        p[:5, :5], p[5:, 5:] = self._angles.filter.p[:5, :5], self._speeds.filter.p[:2, :2]
        return p
