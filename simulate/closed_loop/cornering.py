"""Lateral stability control in a corner: the controller behind an estimator, and the scene."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from polemap.electric.control.body_slip import distribute_torque
from polemap.electric.control.disturbance import DisturbanceObserver
from polemap.electric.control.lateral_stability import (
    GripGuard,
    LateralLimits,
    LateralStabilityController,
    neutral_reference,
)
from polemap.electric.estimators.base import Estimate
from polemap.simulate.closed_loop.lateral import Command
from polemap.simulate.closed_loop.sensing import Measured
from polemap.simulate.plant import REAR_LEFT, REAR_RIGHT
from polemap.vehicle.parameters import Car
from polemap.vehicle.single_track import lateral

Floats = NDArray[np.float64]
DISTURBANCES = ("sideslip_disturbance_radps", "yaw_disturbance_radps2")


@dataclass(frozen=True, slots=True)
class CornerSettings:
    """Bandwidths K of side-slip and yaw rate, and of the observer for estimates without d.

    `reject` off leaves disturbances alone; `guarded` off never hands back to the driver.
    """

    bandwidth_radps: tuple[float, float] = (20.0, 20.0)
    observer_cutoff_radps: float = 5.0
    reject: bool = True
    guarded: bool = True


def yaw_moment_limit_nm(car: Car) -> float:
    """Largest yaw moment of the rear motors, d T / r; 372.7 N m for Table I."""
    left, right = distribute_torque(
        1e9,
        0.0,
        mass_kg=car.mass_kg,
        radius_m=car.wheel_radius_m,
        rear_track_m=car.rear_track_m,
        torque_limit_nm=car.motor_torque_limit_nm,
    )
    return (right - left) * car.rear_track_m / (2.0 * car.wheel_radius_m)


class StabilityLoop:
    """N13's controller on an estimate: reference, feedback, rejection, limits.

    Disturbances are the estimator's own where it has them, else those of an observer behind it.
    """

    def __init__(self, car: Car, settings: CornerSettings, limits: LateralLimits) -> None:
        self._car, self._settings = car, settings
        self._controller = LateralStabilityController(settings.bandwidth_radps, limits)
        self._observer = DisturbanceObserver(settings.observer_cutoff_radps)
        self._guard = GripGuard()

    def __call__(
        self, driver_rad: float, seen: Estimate, measured: Measured, dt_s: float
    ) -> Command:
        car, speed = self._car, max(measured.speed_mps, 1.0)
        a, b = lateral(car, speed)
        reference = neutral_reference(
            driver_rad,
            speed,
            mass_kg=car.mass_kg,
            front_m=car.cg_to_front_m,
            rear_m=car.cg_to_rear_m,
            rear_stiffness_n=car.rear_stiffness_nprad,
        )
        rate = seen.value("yaw_rate_radps") if "yaw_rate_radps" in seen.fields else None
        estimate = np.array(
            [seen.value("sideslip_rad"), measured.yaw_rate_radps if rate is None else rate]
        )
        applied = np.array([measured.steering_rad, measured.yaw_moment_nm])
        found = self._observer.step(a, b, estimate, applied, dt_s)
        if DISTURBANCES[0] in seen.fields:
            found = np.array([seen.value(name) for name in DISTURBANCES])
        disturbance = found if self._settings.reject else np.zeros(2)
        command = self._controller.step(a, b, reference, estimate, disturbance)
        if self._settings.guarded:
            command = self._guard.step(command, driver_rad, self._worst_slip(measured), dt_s)
        return Command(
            command.steer_rad,
            command.yaw_moment_nm,
            command.saturated,
            float(reference[0]),
            float(reference[1]),
        )

    def _worst_slip(self, measured: Measured) -> float:
        radius, speed = self._car.wheel_radius_m, max(measured.speed_mps, 0.5)
        rims = [radius * measured.wheel_radps[wheel] for wheel in (REAR_LEFT, REAR_RIGHT)]
        return max(abs(rim - speed) / max(abs(rim), speed) for rim in rims)


@dataclass(frozen=True, slots=True)
class Corner:
    """A driver who turns in smoothly, as half a cosine, and holds the wheel."""

    amplitude_rad: float = 0.1
    begin_s: float = 3.0
    rise_s: float = 0.5

    @property
    def settled_s(self) -> float:
        """One second after the wheel stands."""
        return self.begin_s + self.rise_s + 1.0

    def __call__(self, stamp_s: float) -> float:
        share = min(max((stamp_s - self.begin_s) / self.rise_s, 0.0), 1.0)
        return float(self.amplitude_rad * 0.5 * (1.0 - np.cos(np.pi * share)))
