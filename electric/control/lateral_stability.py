"""Lateral stability: side-slip and yaw rate follow a neutral car, by steering and yaw moment.

The planar model is x' = A x + B u + d with x = [beta, gamma], u = [road-wheel angle, yaw moment].
With u = inv(B) (-A x + K (x* - x) - d) the closed loop is x' = K (x* - x) in both states, with no
coupling between them (N13 (29)-(31) in the form of errata.md, Lateral stability).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from polemap.vehicle.errors import VehicleError

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class LateralLimits:
    """What the actuators can do."""

    steer_rad: float = 0.35
    yaw_moment_nm: float = 372.7


@dataclass(frozen=True, slots=True)
class LateralCommand:
    """Commands after allocation, and whether an actuator limit was met on the way."""

    steer_rad: float
    yaw_moment_nm: float
    saturated: bool


def neutral_reference(
    steer_rad: float,
    speed_mps: float,
    *,
    mass_kg: float,
    front_m: float,
    rear_m: float,
    rear_stiffness_n: float,
) -> Floats:
    """Steady side-slip and yaw rate `(2,)` of the car with neutral steer.

    Neutral steer (Cf lf = Cr lr) makes the yaw rate V delta / l at every speed, and the side-slip
    (lr / l - m lf V^2 / (2 Cr l^2)) delta; stiffness per tyre.

    Source: N13, 4.2; the steady state of the single-track model (errata.md, Corrected equations).
    """
    length = front_m + rear_m
    sag = mass_kg * front_m * speed_mps**2 / (2.0 * rear_stiffness_n * length**2)
    return np.array([rear_m / length - sag, speed_mps / length]) * steer_rad


class LateralStabilityController:
    """Feed-forward, decoupling feedback, disturbance rejection, and allocation within limits.

    Args:
        bandwidth_radps: K, `(2,)`, of side-slip and yaw rate.
        limits: of the actuators.
    """

    def __init__(self, bandwidth_radps: tuple[float, float], limits: LateralLimits) -> None:
        if min(bandwidth_radps) <= 0 or min(limits.steer_rad, limits.yaw_moment_nm) <= 0:
            raise VehicleError("lateral stability: bandwidths and limits must be positive")
        self._k = np.diag(bandwidth_radps)
        self._bandwidth = np.asarray(bandwidth_radps)
        self._limits = np.array([limits.steer_rad, limits.yaw_moment_nm])

    def step(
        self, a: Floats, b: Floats, reference: Floats, estimate: Floats, disturbance: Floats
    ) -> LateralCommand:
        """One command.

        Args:
            a: `(2, 2)` and
            b: `(2, 2)`: nominal model at the present speed.
            reference: `(2,)` side-slip and yaw rate wanted.
            estimate: `(2,)` estimated.
            disturbance: `(2,)` estimated d per second; zeros switch the rejection off.
        """
        wanted = -a @ estimate + self._k @ (reference - estimate) - disturbance
        command = np.linalg.solve(b, wanted)
        saturated = bool((np.abs(command) > self._limits).any())
        if saturated:
            command = allocate(b, wanted, self._limits, 1.0 / self._bandwidth)
        return LateralCommand(float(command[0]), float(command[1]), saturated)


@dataclass(frozen=True, slots=True)
class GuardSettings:
    """When the car goes back to the driver, and how fast.

    Attributes:
        slip_limit: slip of a driven wheel, either way, above which it is about to break away.
        release_s: time in which the controller's share falls from one to nothing.
        return_s: time in which it comes back after the wheels grip again.
    """

    slip_limit: float = 0.12
    release_s: float = 0.05
    return_s: float = 1.0


class GripGuard:
    """Hands the car back to the driver while its driven wheels break away.

    The model inverted by the controller knows no friction. Where the ground cannot carry the yaw
    moment, more of it spins the wheels, they lose their side force and the car turns round; the
    uncontrolled car would not have. The guard moves the command towards the driver's steering and
    no moment, and says how much of the controller is left.
    """

    def __init__(self, settings: GuardSettings | None = None) -> None:
        self._settings = settings or GuardSettings()
        self.authority = 1.0

    def step(
        self, command: LateralCommand, driver_rad: float, worst_slip: float, dt_s: float
    ) -> LateralCommand:
        """The command with what share of the controller the grip allows.

        Args:
            driver_rad: road-wheel angle that the driver asks for.
            worst_slip: largest |slip| of the driven wheels.
            dt_s: time since the last step.
        """
        s = self._settings
        fast = -dt_s / s.release_s if abs(worst_slip) > s.slip_limit else dt_s / s.return_s
        self.authority = min(1.0, max(0.0, self.authority + fast))
        share = self.authority
        return LateralCommand(
            driver_rad + share * (command.steer_rad - driver_rad),
            share * command.yaw_moment_nm,
            command.saturated or share < 1.0,
        )


def allocate(b: Floats, wanted: Floats, limits: Floats, weights: Floats) -> Floats:
    """The command within +-limits `(2,)` that comes closest to `b u = wanted` in weighted squares.

    With two inputs the optimum is inside, on one of four edges or at a corner, so all are tried.
    """
    wb, ww = weights[:, None] * b, weights * wanted
    candidates: list[Floats] = []
    for held in (0, 1):
        free = 1 - held
        for bound in (-limits[held], limits[held]):
            rest = ww - wb[:, held] * bound
            square = float(wb[:, free] @ wb[:, free])
            best = float(wb[:, free] @ rest) / square if square > 0.0 else 0.0
            command: Floats = np.empty(2)
            command[held] = bound
            command[free] = np.clip(best, -limits[free], limits[free])
            candidates.append(command)
    # inputs that do the same leave a line of optima, which ends at an edge
    if np.linalg.matrix_rank(b) == 2:
        inside: Floats = np.asarray(np.linalg.solve(b, wanted))
        if (np.abs(inside) <= limits).all():
            candidates.append(inside)
    return min(candidates, key=lambda u: float(np.sum((wb @ u - ww) ** 2)))
