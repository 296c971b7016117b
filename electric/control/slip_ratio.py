"""Slip-ratio control of one driven wheel by sliding mode, with a driving-force observer.

The slip ratio of a driven wheel is lambda = (r omega - v) / (r omega). All equations in the
corrected form of errata.md, Slip ratio (N13 (23)-(28) as printed have a sign and a factor wrong).
"""

from __future__ import annotations

from dataclasses import dataclass

from polemap.vehicle.errors import VehicleError


@dataclass(frozen=True, slots=True)
class SlipRatioSettings:
    """Gains of the controller.

    Attributes:
        target: slip ratio to hold.
        linear_gain_per_s: L of the reaching law S' = -L S - Q sat(S / phi).
        switching_gain_per_s: Q of the reaching law.
        boundary: phi, the layer around S = 0 in which sat is linear.
        observer_cutoff_radps: cut-off of the driving-force observer.
        enable_above: below this slip the driver's torque passes unchanged.
        floor_speed_mps: slower than this the controller only limits to the driver's torque.
    """

    target: float = 0.1
    linear_gain_per_s: float = 20.0
    switching_gain_per_s: float = 5.0
    boundary: float = 0.02
    observer_cutoff_radps: float = 400.0
    floor_speed_mps: float = 0.5


class DrivingForceObserver:
    """F = low-pass((T - I omega') / r): force at the contact patch from torque and wheel speed.

    Realised without differentiating: with the cut-off g, z = low-pass(T + g I omega) and
    F = (z - g I omega) / r, which is the same transfer function.

    Source: N13 ref. (16) and errata.md, Slip ratio.
    """

    def __init__(self, inertia_kgm2: float, radius_m: float, cutoff_radps: float) -> None:
        if min(inertia_kgm2, radius_m, cutoff_radps) <= 0:
            raise VehicleError("driving-force observer: inertia, radius and cut-off are positive")
        self._momentum = cutoff_radps * inertia_kgm2
        self._radius_m = radius_m
        self._cutoff_radps = cutoff_radps
        self._filtered: float | None = None

    def step(self, torque_nm: float, wheel_radps: float, dt_s: float) -> float:
        """Driving force in N from the torque applied over the last `dt_s`."""
        raw = torque_nm + self._momentum * wheel_radps
        if self._filtered is None:
            self._filtered = self._momentum * wheel_radps
        share = self._cutoff_radps * dt_s
        self._filtered += (raw - self._filtered) * share / (1.0 + share)
        return (self._filtered - self._momentum * wheel_radps) / self._radius_m


class SlipRatioController:
    """Limits the driver's torque so that the wheel holds the slip ratio asked for.

    T = (I r omega^2 / v) [ (v'/v)(1 - lambda) + lambda*' + v / (I omega^2) F - L S - Q sat(S/phi) ]
    with S = lambda - lambda*, never above the driver's torque and never below zero for a driver
    who drives. Sliding mode has no integrator; what could wind up is the observer, and it is fed
    the torque that was really applied.
    """

    def __init__(
        self, inertia_kgm2: float, radius_m: float, settings: SlipRatioSettings | None = None
    ) -> None:
        self.settings = settings or SlipRatioSettings()
        self._inertia = inertia_kgm2
        self._radius_m = radius_m
        self._observer = DrivingForceObserver(
            inertia_kgm2, radius_m, self.settings.observer_cutoff_radps
        )
        self._speed_mps: float | None = None
        self._acceleration = 0.0

    def step(
        self,
        driver_torque_nm: float,
        applied_torque_nm: float,
        wheel_radps: float,
        speed_mps: float,
        dt_s: float,
        target: float | None = None,
        target_rate_per_s: float = 0.0,
    ) -> float:
        """Torque command in N m.

        Args:
            driver_torque_nm: what the driver asks for, the upper bound.
            applied_torque_nm: what the motor gave over the last step.
            wheel_radps: measured wheel speed.
            speed_mps: estimated longitudinal velocity of the car.
            dt_s: time since the last step.
            target: slip ratio to hold now, the settings' by default.
            target_rate_per_s: lambda*', how fast that target moves; 0 for a fixed one.
        """
        s = self.settings
        wanted = s.target if target is None else target
        force = self._observer.step(applied_torque_nm, wheel_radps, dt_s)
        self._track_acceleration(speed_mps, dt_s)
        rim = self._radius_m * wheel_radps
        if speed_mps < s.floor_speed_mps or rim <= speed_mps or driver_torque_nm <= 0:
            return driver_torque_nm
        slip = (rim - speed_mps) / rim
        error = slip - wanted
        reach = s.linear_gain_per_s * error
        reach += s.switching_gain_per_s * max(-1.0, min(1.0, error / s.boundary))
        spin = self._inertia * wheel_radps * wheel_radps
        inner = self._acceleration / speed_mps * (1.0 - slip) + speed_mps / spin * force - reach
        inner += target_rate_per_s
        torque = self._radius_m * spin / speed_mps * inner
        return max(0.0, min(driver_torque_nm, torque))

    def _track_acceleration(self, speed_mps: float, dt_s: float) -> None:
        """Acceleration of the car, differentiated and smoothed over about 50 ms."""
        if self._speed_mps is not None:
            raw = (speed_mps - self._speed_mps) / dt_s
            self._acceleration += (raw - self._acceleration) * dt_s / (0.05 + dt_s)
        self._speed_mps = speed_mps
