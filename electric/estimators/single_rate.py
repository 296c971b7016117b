"""One rate for all: everything waits for the camera."""

from __future__ import annotations

from math import ceil

import numpy as np
from numpy.typing import NDArray

from polemap.electric.config import EstimatorConfig
from polemap.electric.estimators.base import CAMERA, YAW_RATE, Estimate, Inputs, Value, pair
from polemap.electric.estimators.vision import VisionFilter, initial_covariance, vision_density
from polemap.vehicle.kalman import innovate, joseph_update, symmetric
from polemap.vehicle.parameters import Car
from polemap.vehicle.single_track import bend_of_lane, combined_vision, schedule

Floats = NDArray[np.float64]

_LONGEST_S = 0.5  # predicted over at once


class SingleRateKalman(VisionFilter):
    """State `[beta, gamma, psi, y_l, psi-, y_l-]` stepped from frame to frame.

    At each capture the state is predicted over the whole frame with the inputs sampled at its
    start; the picture of the capture before, if it has arrived, is measured through the delayed
    states, together with the yaw rate of now. Between captures the output holds still, and what
    the fast sensors say is lost.

    Source: W12 (10)-(11), W14 (12)-(15) as corrected in errata.md (one camera frame, blkdiag with
    the lower block `[S 0]`).
    """

    def __init__(self, car: Car, config: EstimatorConfig) -> None:
        super().__init__(car, config)
        self._frame = schedule(combined_vision, car, vision_density(config), config.camera_period_s)
        self._x = np.zeros(6)
        self._p = np.zeros((6, 6))
        self._p[:4, :4] = initial_covariance(config)
        self._captured_s = float("nan")
        self._inputs = Inputs(0.0, 0.0)
        self._held = self._inputs
        self._yaw_rate: float | None = None
        self._arrived: Floats | None = None

    def step(self, stamp_s: float, inputs: Inputs) -> None:
        self._clock.advance(stamp_s)
        self._inputs, self._yaw_rate = inputs, None

    def measure(self, kind: str, value: Value, stamp_s: float, arrival_s: float) -> None:
        if kind == YAW_RATE:
            self._yaw_rate = float(value)  # type: ignore[arg-type]
        elif kind == CAMERA:
            if abs(stamp_s - self._captured_s) < 1e-6:
                self._arrived = np.array(pair(kind, value))
            else:
                self._drop("camera value later than one frame")

    def capture(self, kind: str, stamp_s: float) -> None:
        if kind != CAMERA:
            return
        elapsed = stamp_s - self._captured_s
        if elapsed == elapsed and elapsed > 0.0:
            self._predict(elapsed)
            self._update()
        else:
            self._x[4:], self._p = self._x[2:4], _with_clone(self._p)
        self._captured_s, self._held, self._arrived = stamp_s, self._inputs, None

    def _predict(self, elapsed: float) -> None:
        """Over one frame, or in parts over a gap: the noise of seconds drowns in its rounding."""
        parts = max(1, ceil(elapsed / _LONGEST_S))
        part_s = elapsed / parts
        g, h, q = self._frame.at(self._held.speed_mps, part_s)
        u = np.array([self._held.road_wheel_angle_rad, self._held.yaw_moment_nm])
        bend = bend_of_lane(self._held.speed_mps, self._held.road_curvature_per_m, part_s)
        wide = np.zeros((6, 6))
        wide[:4, :4] = g
        wide[4, 2] = wide[5, 3] = 1.0
        for _ in range(parts):
            self._x = wide @ self._x
            self._x[:4] += h @ u
            self._x[2:4] += bend
            self._p = wide @ self._p @ wide.T
            self._p[:4, :4] += q
            # the delayed states are those of the capture before the first part
            wide[4:] = np.eye(6)[4:]

    def _update(self) -> None:
        gyro, stamp = self.gate.variance(YAW_RATE, self._gyro_variance), self._clock.stamp_s
        if self._yaw_rate is not None:
            numbers = (self._yaw_rate - self._x.item(1), self._p.item(1, 1) + gyro)
            if self.gate.refuses(YAW_RATE, stamp, numbers):
                self._yaw_rate = None
        if self._arrived is not None and self._wild(
            CAMERA, stamp, self._arrived - self._x[4:], self._p[4:, 4:], self._camera_noise
        ):
            self._arrived = None
        rows = [1] if self._yaw_rate is not None else []
        measured = [self._yaw_rate] if self._yaw_rate is not None else []
        variances = [gyro] if rows else []
        if self._arrived is not None:
            rows, measured = [*rows, 4, 5], [*measured, *self._arrived.tolist()]
            variances = [*variances, *np.diag(self._camera_noise).tolist()]
        if not rows:
            return
        jacobian, noise = np.eye(6)[rows], np.diag(variances)
        before = self._x[:4].copy()
        residual = np.array(measured, dtype=np.float64) - jacobian @ self._x
        innovation = innovate(residual, symmetric(self._p), jacobian, noise)
        self._x, self._p = joseph_update(self._x, self._p, innovation, jacobian, noise)
        if self._arrived is not None:
            self._bridge.corrected(self._clock.stamp_s, before, self._x[:4])

    def estimate(self) -> Estimate:
        return self._output(self._x[:4].copy(), self._p[:4, :4])

    def covariance(self) -> Floats:
        return self._p[:4, :4].copy()


def _with_clone(p: Floats) -> Floats:
    copy = np.eye(6)
    copy[4:] = 0.0
    copy[4, 2] = copy[5, 3] = 1.0
    return np.asarray(copy @ p @ copy.T)
