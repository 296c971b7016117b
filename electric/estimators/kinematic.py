"""Velocities from accelerations alone: no tyres, no GPS; the GPS estimator's other comparison."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from polemap.electric.config import EstimatorConfig
from polemap.electric.estimators.base import WHEEL_SPEED, Clock, Estimate, Inputs, Value
from polemap.electric.estimators.gate import Gate
from polemap.vehicle.delay import ClonedFilter
from polemap.vehicle.parameters import Car
from polemap.vehicle.single_track import planar_velocity_step

Floats = NDArray[np.float64]

# of a driven wheel's speed, its slip in it
WHEEL_SPEED_SD_MPS = 0.1


class KinematicKalman:
    """State `[vx, vy]`: vx' = ax + gamma vy, vy' = ay - gamma vx; measured: wheel speed as vx.

    vy is observable only while the car turns; what the accelerometer has of bias, roll and bank
    goes straight into it.

    Source: N13, section 5.1 and its reference (3).
    """

    fields = ("sideslip_rad", "vx_mps", "vy_mps")

    def __init__(self, car: Car, config: EstimatorConfig) -> None:
        self._config = config
        self._clock = Clock(config.step_s)
        self._filter = ClonedFilter(np.zeros(2), np.diag([4.0, 0.25]), np.zeros((1, 2)), 0)
        self.dropped: dict[str, int] = {}
        self.gate = Gate(config, self.dropped)

    def step(self, stamp_s: float, inputs: Inputs) -> None:
        t = self._clock.advance(stamp_s)
        if not t:
            self._filter.x[0] = inputs.speed_mps
            return
        c, s, ch, sh = planar_velocity_step(inputs.yaw_rate_radps, t)
        pushed = np.array(
            [
                ch * inputs.ax_mps2 + sh * inputs.ay_mps2,
                -sh * inputs.ax_mps2 + ch * inputs.ay_mps2,
            ]
        )
        vx, vy = self._filter.x
        # gyro noise turns the velocity, accelerometer noise pushes it
        gyro = (self._config.gyro_sd_radps * t) ** 2
        walk = self._config.acceleration_walk_mps**2 * t
        across = np.array([vy, -vx])
        noise = walk * np.eye(2) + gyro * np.outer(across, across)
        self._filter.predict(np.array([[c, s], [-s, c]]), pushed, noise)

    def capture(self, kind: str, stamp_s: float) -> None:
        """Nothing here is late."""

    def measure(self, kind: str, value: Value, stamp_s: float, arrival_s: float) -> None:
        if kind == WHEEL_SPEED:
            f, speed = self._filter, float(value)  # type: ignore[arg-type]
            variance = self.gate.variance(WHEEL_SPEED, WHEEL_SPEED_SD_MPS**2)
            residual = speed - f.x.item(0)
            if not self.gate.refuses(WHEEL_SPEED, stamp_s, (residual, f.p.item(0, 0) + variance)):
                f.scalar(0, speed, variance)

    def estimate(self) -> Estimate:
        vx, vy = self._filter.x.tolist()
        p = self.covariance()
        mean = np.array([np.arctan2(vy, vx) if vx > 0.5 else 0.0, vx, vy])
        return Estimate(self._clock.stamp_s, self.fields, mean, np.sqrt(np.diag(p)))

    def covariance(self) -> Floats:
        """`(3, 3)`, side-slip by its gradient."""
        vx, vy = self._filter.x.tolist()
        square = vx * vx + vy * vy + 0.25
        lift = np.array([[-vy / square, vx / square], [1.0, 0.0], [0.0, 1.0]])
        return np.asarray(lift @ self._filter.p @ lift.T)
