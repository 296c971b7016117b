"""Beyond the papers: an extended Kalman filter that also estimates how stiff the tyres are."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from polemap.electric.config import EstimatorConfig
from polemap.electric.estimators.base import (
    CAMERA,
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
from polemap.electric.estimators.vision import CURVATURE_ERROR_S, initial_covariance, vision_density
from polemap.vehicle.delay import ClonedFilter
from polemap.vehicle.parameters import Car
from polemap.vehicle.pose import wrap_angle
from polemap.vehicle.single_track import bend_of_lane, combined_vision

Floats = NDArray[np.float64]

# the stiffness scale at the start: road, load and tyre make it 0.7 to 1.3 of the nominal one
STIFFNESS_SD = 0.3
# what it wanders in one second
STIFFNESS_WALK = 0.01
# walks of the model over the other estimators': the scale carries what they carry
STIFFNESS_MODEL_SCALE = 0.25
# what late sensors see: heading and offset (camera), course (GPS)
_CLONED = np.array(
    [[0.0, 0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0, 0.0], [1.0, 0.0, 1.0, 0.0, 0.0]]
)


class StiffnessKalman:
    """State `[beta, gamma, psi, y_l, kappa]`, all four tyres kappa times the nominal stiffness.

    The model is affine in kappa: x' = (A0 + kappa A1) x + (B0 + kappa B1) u. It is stepped by
    the series of the exponential to third order. Heading is in the lane with a camera and on
    the map with GPS, which is left out where there is a camera.
    """

    fields = (
        "sideslip_rad",
        "yaw_rate_radps",
        "heading_rad",
        "lateral_offset_m",
        "stiffness_scale",
    )

    def __init__(self, car: Car, config: EstimatorConfig) -> None:
        self._config, self._car = config, car
        self._soft, self._hard = car.scaled(stiffness=0.5), car.scaled(stiffness=1.5)
        walks = np.array(vision_density(config)) * STIFFNESS_MODEL_SCALE**2
        self._density = np.diag([*walks, STIFFNESS_WALK**2])
        start = np.zeros((5, 5))
        start[:4, :4] = initial_covariance(config)
        start[4, 4] = STIFFNESS_SD**2
        slots = max(config.camera_slots, config.gps_slots)
        self._filter = ClonedFilter(np.array([0.0, 0.0, 0.0, 0.0, 1.0]), start, _CLONED, slots)
        self._clock = Clock(config.step_s)
        self._bridge = OutputBridge(5)
        self._course_sd_rad = config.course_sd_rad
        self._gyro_variance = config.gyro_sd_radps**2
        self._camera_noise = np.diag([config.heading_sd_rad**2, config.lateral_offset_sd_m**2])
        self._speed = float("nan")
        self._matrices = (np.zeros((4, 4)),) * 2 + (np.zeros((4, 2)),) * 2
        self._started_heading = self._in_lane = False
        self.dropped: dict[str, int] = {}
        self.gate = Gate(config, self.dropped)

    def step(self, stamp_s: float, inputs: Inputs) -> None:
        t = self._clock.advance(stamp_s)
        if t == 0.0:
            return
        a0, a1, b0, b1 = self._affine(inputs.speed_mps)
        f = self._filter
        x, kappa = f.x[:4], f.x.item(4)
        u = np.array([inputs.road_wheel_angle_rad, inputs.yaw_moment_nm])
        rate = np.zeros((5, 5))
        rate[:4, :4] = a0 + kappa * a1
        rate[:4, 4] = a1 @ x + b1 @ u
        square = rate @ rate
        half, third = 0.5 * t * t, t**3 / 6.0
        g = np.eye(5) + t * rate + half * square + third * (square @ rate)
        a = rate[:4, :4]
        slope = a @ x + (b0 + kappa * b1) @ u
        moved = t * slope + half * (a @ slope) + third * (square[:4, :4] @ slope)
        mean = np.append(x + moved, kappa)
        q = t * self._density
        if inputs.road_curvature_per_m:
            mean[2:4] += bend_of_lane(inputs.speed_mps, inputs.road_curvature_per_m, t)
            wrong = inputs.speed_mps * self._config.curvature_sd_per_m
            q[2, 2] += wrong * wrong * CURVATURE_ERROR_S * t
        f.predict(g, mean - g @ f.x[:5], q)
        f.x[4] = min(max(f.x.item(4), 0.1), 5.0)

    def _affine(self, speed: float) -> tuple[Floats, ...]:
        """A0, A1, B0, B1 from the models of half and one and a half times the stiffness."""
        if speed != self._speed:
            (al, bl), (ah, bh) = (
                combined_vision(self._soft, speed),
                combined_vision(self._hard, speed),
            )
            self._matrices = (1.5 * al - 0.5 * ah, ah - al, 1.5 * bl - 0.5 * bh, bh - bl)
            self._speed = speed
        return self._matrices

    def capture(self, kind: str, stamp_s: float) -> None:
        if kind in (CAMERA, GPS):
            self._filter.capture(stamp_s)

    def measure(self, kind: str, value: Value, stamp_s: float, arrival_s: float) -> None:
        if kind == YAW_RATE:
            f, gyro = self._filter, float(value)  # type: ignore[arg-type]
            variance = self.gate.variance(YAW_RATE, self._gyro_variance)
            residual = gyro - f.x.item(1)
            if not self.gate.refuses(YAW_RATE, stamp_s, (residual, f.p.item(1, 1) + variance)):
                f.scalar(1, gyro, variance)
        elif kind in (CAMERA, GPS):
            if kind == GPS:
                self._course_sd_rad, _ = fix_spread(value, self._config.course_sd_rad, 1.0)
            self._late(kind, np.array(pair(kind, value)), stamp_s)

    def _late(self, kind: str, value: Floats, stamp_s: float) -> None:
        f = self._filter
        rows = f.clone(stamp_s)
        if rows is None:
            self.dropped[kind] = self.dropped.get(kind, 0) + 1
            return
        before = f.x[:5].copy()
        jacobian = np.zeros((2 if kind == CAMERA else 1, f.size))
        if kind == GPS and self._in_lane:
            # one state cannot be the heading in the lane and over ground
            reason = "gps course beside a camera, left out"
            self.dropped[reason] = self.dropped.get(reason, 0) + 1
            f.release(stamp_s)
            return
        if kind == CAMERA:
            self._in_lane = True
            jacobian[0, rows.start] = jacobian[1, rows.start + 1] = 1.0
            self._correct(CAMERA, jacobian, value - jacobian @ f.x, self._camera_noise)
        elif value[1] >= 2.0:  # a standing car has no course
            jacobian[0, rows.start + 2] = 1.0
            if not self._started_heading:
                self._started_heading = True
                f.x[2] += value[0] - (jacobian @ f.x)[0]
                f.x[rows.start] = f.x[2]
                f.x[rows.start + 2] = value[0]
            residual = np.array([wrap_angle(value[0] - (jacobian @ f.x)[0])])
            self._correct(GPS, jacobian, residual, np.array([[self._course_sd_rad**2]]))
        f.release(stamp_s)
        self._bridge.corrected(self._clock.stamp_s, before, f.x[:5])

    def _correct(self, kind: str, jacobian: Floats, residual: Floats, noise: Floats) -> None:
        variances = np.einsum("ij,jk,ik->i", jacobian, self._filter.p, jacobian) + np.diag(noise)
        numbers = zip(residual.tolist(), variances.tolist(), strict=True)
        if not self.gate.refuses(kind, self._clock.stamp_s, *numbers):
            self._filter.update(jacobian, residual, noise)

    def estimate(self) -> Estimate:
        f = self._filter
        return self._bridge.output(self._clock.stamp_s, self.fields, f.x[:5].copy(), f.p[:5, :5])

    def covariance(self) -> Floats:
        return self._filter.p[:5, :5].copy()
