"""Slip-ratio control on a wet sheet: one run, and what is measured on it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from polemap.electric.control.slip_ratio import SlipRatioController, SlipRatioSettings
from polemap.electric.estimators.base import Estimator
from polemap.simulate.closed_loop.sensing import Measured, SensorFeed, SensorModel
from polemap.simulate.plant import REAR_LEFT, Plant, PlantInput, PlantParameters, patches

Floats = NDArray[np.float64]
Velocity = Callable[[float, Measured, Estimator | None], float]
"""Velocity for the controller, from the true one, the sensors and the estimator."""

SETTLED_BAND = 0.01


@dataclass(frozen=True, slots=True)
class SheetScene:
    """A car that pulls away over a wet sheet.

    `sheet_friction` holds from `sheet_m` on for `length_m`; elsewhere the road has 0.8.
    """

    sheet_friction: float = 0.15
    driver_torque_nm: float = 70.0
    start_mps: float = 2.0
    sheet_m: float = 1.0
    length_m: float = 6.0
    road_friction: float = 0.8
    longest_s: float = 6.0


@dataclass(frozen=True, slots=True)
class SlipRun:
    """Rear left wheel over time, each `(n,)`; `on_sheet` tells when it is on the sheet."""

    stamp_s: Floats
    slip: Floats
    torque_nm: Floats
    speed_mps: Floats
    used_speed_mps: Floats
    on_sheet: NDArray[np.bool_]

    def entry_s(self) -> float:
        """When the wheel meets the sheet."""
        return float(self.stamp_s[np.flatnonzero(self.on_sheet)[0]])

    def peak(self) -> float:
        """Largest slip on the sheet."""
        return float(self.slip[self.on_sheet].max())

    def mean(self) -> float:
        """Mean slip on the sheet from 0.1 s after its edge on."""
        late = self.on_sheet & (self.stamp_s > self.entry_s() + 0.1)
        return float(self.slip[late].mean())

    def settled_s(self, target: float) -> float:
        """Time from the sheet's edge until the slip stays within 0.01 of the target."""
        away = self.on_sheet & (np.abs(self.slip - target) > SETTLED_BAND)
        rows = np.flatnonzero(away)
        if len(rows) == 0:
            return 0.0
        if rows[-1] == np.flatnonzero(self.on_sheet)[-1]:
            return float("inf")
        return float(self.stamp_s[rows[-1] + 1] - self.entry_s())


def run_sheet(
    parameters: PlantParameters,
    scene: SheetScene,
    *,
    velocity: Velocity | None,
    rng: np.random.Generator,
    sensors: SensorModel | None = None,
    estimator: Estimator | None = None,
    settings: SlipRatioSettings | None = None,
) -> SlipRun:
    """Drive over the sheet until the rear axle has left it; without `velocity` uncontrolled."""
    strip = [(scene.sheet_m, scene.sheet_m + scene.length_m, scene.sheet_friction)]
    plant = Plant(parameters, patches(scene.road_friction, strip))
    controllers = [
        SlipRatioController(parameters.wheel_inertia_kgm2, parameters.wheel_radius_m, settings)
        for _ in range(2)
    ]
    feed = SensorFeed(parameters, sensors or SensorModel(), rng, estimator)
    state = plant.rolling(scene.start_mps)
    # the rear axle stands a little before the sheet: the car starts where it is at east 0
    wheels = (REAR_LEFT, REAR_LEFT + 1)
    rows: list[tuple[float, ...]] = []
    for _ in range(round(scene.longest_s / plant.step_s)):
        measured = feed.step(state)
        torque, used = [scene.driver_torque_nm] * 2, state.vx_mps
        if velocity is not None:
            used = velocity(state.vx_mps, measured, estimator)
            torque = [
                controller.step(
                    scene.driver_torque_nm,
                    state.torque_nm[wheel],
                    measured.wheel_radps[wheel],
                    used,
                    plant.step_s,
                )
                for controller, wheel in zip(controllers, wheels, strict=True)
            ]
        state = plant.step(state, PlantInput(0.0, (0.0, 0.0, torque[0], torque[1])))
        rear = state.east_m - parameters.rear_m - scene.sheet_m
        rows.append(
            (
                state.time_s,
                state.slip_ratio(REAR_LEFT, parameters.wheel_radius_m),
                state.torque_nm[REAR_LEFT],
                state.vx_mps,
                used,
                float(0.0 <= rear < scene.length_m),
            )
        )
        if rear > scene.length_m + 0.3:
            break
    t, slip, torque, speed, used, there = np.array(rows).T
    return SlipRun(t, slip, torque, speed, used, there > 0.5)


def biased(share: float) -> Velocity:
    """The true velocity, wrong by a share of it."""

    def velocity(true_mps: float, _measured: Measured, _estimator: Estimator | None) -> float:
        return (1.0 + share) * true_mps

    return velocity


def front_wheels(_true: float, measured: Measured, _estimator: Estimator | None) -> float:
    """The free front wheels' speed."""
    return measured.speed_mps


def estimated(_true: float, _measured: Measured, estimator: Estimator | None) -> float:
    """The estimator's forward velocity."""
    assert estimator is not None
    return estimator.estimate().value("vx_mps")


def gps_held() -> Velocity:
    """The GPS speed as it comes, late and held until the next: one rate for all."""
    last: list[float] = []

    def velocity(true_mps: float, measured: Measured, _estimator: Estimator | None) -> float:
        if measured.gps_speed_mps is not None:
            last[:] = [measured.gps_speed_mps]
        return last[0] if last else true_mps

    return velocity


def held_slip(target: float, share: float) -> float:
    """Slip that is held at `target` against a velocity wrong by a share of the true one.

    The controller sees 1 - (1 + e)(1 - lambda) and brings it to the target, so
    lambda = 1 - (1 - target) / (1 + e): whatever the controller, an error of the velocity becomes
    nearly the same error of the slip.
    """
    return 1.0 - (1.0 - target) / (1.0 + share)


def with_lag(parameters: PlantParameters, lag_s: float) -> PlantParameters:
    """The plant with slower motors."""
    return replace(parameters, torque_lag_s=lag_s)
