"""Layer 2 of N13: velocities from accelerometers, a GPS's speed and layer 1's side-slip."""

from __future__ import annotations

from math import exp

import numpy as np
from numpy.typing import NDArray

from polemap.electric.config import EstimatorConfig
from polemap.electric.estimators.base import Inputs
from polemap.electric.estimators.gate import GPS_SPEED, Gate
from polemap.vehicle.delay import ClonedFilter
from polemap.vehicle.packed import rotate
from polemap.vehicle.pose import rotate_covariance
from polemap.vehicle.single_track import planar_velocity_step

Floats = NDArray[np.float64]
# standard deviation of the accelerometer's bias, roll in it: about 2 degrees of g
ACCELERATION_DISTURBANCE_MPS2 = 0.3
VELOCITY_ROWS = np.eye(2, 4)
"""vx and vy of now."""


class VelocityLayer:
    """Kalman filter of `[vx, vy, d_ax, d_ay]`; the disturbances leak.

    vx' = ax + d_ax + gamma vy, vy' = ay + d_ay - gamma vx; measured as V (cos beta, sin beta) with
    the side-slip of the capture.

    Args:
        slots: captures that may be on their way at once.
        gate: leaves out values that cannot be.

    Attributes:
        filter: the states of now and of the captures.
    """

    def __init__(self, config: EstimatorConfig, slots: int, gate: Gate) -> None:
        self._config, self._gate = config, gate
        bias = ACCELERATION_DISTURBANCE_MPS2**2
        start = np.diag([4.0, 1.0, bias, bias])
        self.filter = ClonedFilter(np.zeros(4), start, VELOCITY_ROWS, slots)

    def step(self, yaw_rate: float, inputs: Inputs, t: float) -> tuple[Floats, Floats]:
        """Predict: rotation by -yaw rate over t, the accelerations taken at half of it.

        Returns:
            The transition `(4, 4)` and what drives it `(4,)`.
        """
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
        self.filter.predict(turn, pushed, np.diag([walk, walk, bias, bias]))
        return turn, pushed

    def correct(
        self,
        jacobian: Floats,
        measured: Floats,
        slip: tuple[float, float],
        speed: tuple[float, float],
        stamp_s: float,
    ) -> None:
        """A velocity `(2,)` that `jacobian` `(2, n)` sees, unless it cannot be.

        Args:
            slip: side-slip (rad) of the capture and its variance.
            speed: that of the GPS and its standard deviation, m/s.
        """
        beta, variance = slip
        mps, sd_mps = speed
        across = mps * mps * variance + 1e-4
        noise = rotate_covariance(np.diag([sd_mps**2, across]), beta)
        f, residual = self.filter, measured - jacobian @ self.filter.x
        variances = np.einsum("ij,jk,ik->i", jacobian, f.p, jacobian) + np.diag(noise)
        numbers = zip(residual.tolist(), variances.tolist(), strict=True)
        if not self._gate.refuses(GPS_SPEED, stamp_s, *numbers):
            f.update(jacobian, residual, noise)


def velocity(speed_mps: float, sideslip_rad: float) -> Floats:
    """V (cos beta, sin beta), `(2,)`."""
    return np.array(rotate(speed_mps, 0.0, sideslip_rad))
