"""Lane keeping on the lateral offset ahead, and the side-slip by a yaw moment: one state feedback.

W13 calls it integrated control of motion and position and prints no law. This one closes the loop
on the model that its filter estimates: x = [beta, gamma, psi, y_l], u = [road-wheel angle, yaw
moment], y_l' = V beta + l_pre gamma + V psi (errata.md, Vision rows), all at one rate.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from polemap.electric.control.lateral_stability import LateralCommand, LateralLimits
from polemap.vehicle.discretize import zero_order_hold
from polemap.vehicle.errors import VehicleError
from polemap.vehicle.parameters import Car
from polemap.vehicle.single_track import KINEMATIC_SPEED_MPS, combined_vision

Floats = NDArray[np.float64]

_GRID_MPS = np.arange(KINEMATIC_SPEED_MPS, 41.0)


@dataclass(frozen=True, slots=True)
class LaneWeights:
    """Sizes that are alike dear: the cost is the sum of squares of each over its size.

    Attributes:
        offset_m: of y_l.
        sideslip_rad: of beta.
        steer_rad: of the road wheels.
        yaw_moment_nm: of the motors; 0 for a car that has steering alone.

    Source: A. E. Bryson, Y.-C. Ho, Applied Optimal Control, 1975, 5.2.
    """

    offset_m: float = 0.1
    sideslip_rad: float = 0.01
    steer_rad: float = 0.05
    yaw_moment_nm: float = 100.0


class LaneKeeper:
    """u = -K(V) (x - x*), with x* = [0, 0, y*' / V, y*] for an offset y* that is wanted.

    K is the linear quadratic regulator of the car's model held over the period, at whole speeds,
    linear between them.

    Args:
        car: with its preview.
        weights: of the regulator.
        limits: of the actuators; commands are cut off there.
        period_s: from one command to the next.

    Raises:
        VehicleError: a weight or the period is not positive.
    """

    def __init__(
        self, car: Car, weights: LaneWeights, limits: LateralLimits, period_s: float
    ) -> None:
        sizes = (weights.offset_m, weights.sideslip_rad, weights.steer_rad, period_s)
        if not min(sizes) > 0.0 or not weights.yaw_moment_nm >= 0.0:
            raise VehicleError("lane keeping: weights and the period must be positive")
        self._limits = (limits.steer_rad, limits.yaw_moment_nm)
        self._gains = np.array([_gain(car, v, weights, period_s) for v in _GRID_MPS.tolist()])

    def gain(self, speed_mps: float) -> Floats:
        """K `(2, 4)` at a speed; beyond the grid that of its end."""
        place = min(max(abs(speed_mps) - _GRID_MPS[0], 0.0), len(_GRID_MPS) - 1.0)
        below = min(int(place), len(_GRID_MPS) - 2)
        share = place - below
        return np.asarray((1.0 - share) * self._gains[below] + share * self._gains[below + 1])

    def step(
        self, state: Floats, speed_mps: float, offset_m: float = 0.0, offset_rate_mps: float = 0.0
    ) -> LateralCommand:
        """One command.

        Args:
            state: `(4,)` side-slip, yaw rate, heading in the lane and offset at the preview point.
            speed_mps: of now.
            offset_m: the offset that is wanted, and
            offset_rate_mps: how fast it changes.
        """
        heading = offset_rate_mps / max(abs(speed_mps), KINEMATIC_SPEED_MPS)
        off = state - np.array([0.0, 0.0, heading, offset_m])
        wanted = (-self.gain(speed_mps) @ off).tolist()
        steer, moment = (
            max(-limit, min(limit, u)) for u, limit in zip(wanted, self._limits, strict=True)
        )
        return LateralCommand(steer, moment, [steer, moment] != wanted)


def _gain(car: Car, speed_mps: float, weights: LaneWeights, period_s: float) -> Floats:
    used = 2 if weights.yaw_moment_nm > 0.0 else 1
    a, b = combined_vision(car, speed_mps)
    g, h = zero_order_hold(a, b[:, :used], period_s)
    q = np.diag([weights.sideslip_rad**-2.0, 0.0, 0.0, weights.offset_m**-2.0]) * period_s
    sizes = np.array([weights.steer_rad, weights.yaw_moment_nm])[:used]
    r = np.diag(sizes**-2.0) * period_s
    p = scipy.linalg.solve_discrete_are(g, h, q, r)
    gain = np.zeros((2, 4))
    gain[:used] = np.linalg.solve(r + h.T @ p @ h, h.T @ p @ g)
    return gain
