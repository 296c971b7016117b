"""A run of the plant under a lateral controller that sees only an estimate."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import pi, sin
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from polemap.electric.control.body_slip import (
    BodySlipController,
    FeedForwardSchedule,
    PiGains,
    distribute_torque,
)
from polemap.electric.estimators.base import Estimate, Estimator
from polemap.simulate.closed_loop.sensing import Measured, SensorFeed, SensorModel
from polemap.simulate.plant import Friction, Plant, PlantInput, PlantParameters, PlantState
from polemap.vehicle.parameters import Car

Floats = NDArray[np.float64]
_SPEED_GAIN_PER_S = 2.0


class Command(NamedTuple):
    """What a lateral controller asks for, and what it aims at."""

    steer_rad: float
    yaw_moment_nm: float
    saturated: bool = False
    sideslip_reference_rad: float = 0.0
    yaw_rate_reference_radps: float = 0.0
    offset_reference_m: float = 0.0


class LateralControl(Protocol):
    """A controller: the driver's steering and what is known, to a command."""

    def __call__(
        self, driver_rad: float, seen: Estimate, measured: Measured, dt_s: float
    ) -> Command: ...


class Driver(Protocol):
    """Road-wheel angle over time."""

    def __call__(self, stamp_s: float) -> float: ...


@dataclass(frozen=True, slots=True)
class LateralRun:
    """Everything over time, each `(n,)`; the offset in the lane is that of the preview point."""

    stamp_s: Floats
    sideslip_rad: Floats
    yaw_rate_radps: Floats
    sideslip_reference_rad: Floats
    yaw_rate_reference_radps: Floats
    steer_rad: Floats
    yaw_moment_nm: Floats
    saturated: NDArray[np.bool_]
    speed_mps: Floats
    offset_m: Floats
    offset_reference_m: Floats

    def error_rms_rad(self, start_s: float = 0.0, least_mps: float = 0.0) -> float:
        """Side-slip against its reference, from a stamp on, where the car drives at least so fast.

        A car that hardly rolls has side-slip, but none of tyres.
        """
        late = (self.stamp_s >= start_s) & (self.speed_mps >= least_mps)
        error = (self.sideslip_rad - self.sideslip_reference_rad)[late]
        return float(np.sqrt(np.mean(error**2)))

    def offset_error_m(self, start_s: float = 0.0) -> Floats:
        """Offset in the lane minus the one wanted, from a stamp on."""
        late = self.stamp_s >= start_s
        return np.asarray((self.offset_m - self.offset_reference_m)[late])

    def peak_rad(self) -> float:
        """Largest side-slip."""
        return float(np.abs(self.sideslip_rad).max())

    def moment_peak_nm(self) -> float:
        """Largest yaw moment of the rear motors."""
        return float(np.abs(self.yaw_moment_nm).max())

    def moment_step_nm(self) -> float:
        """RMS of the command's steps: how rough it is."""
        return float(np.sqrt(np.mean(np.diff(self.yaw_moment_nm) ** 2)))


def run_lateral(
    parameters: PlantParameters,
    speed_mps: float | Callable[[float], float],
    duration_s: float,
    driver: Driver,
    control: LateralControl | None,
    *,
    rng: np.random.Generator,
    friction: Friction = lambda _east, _north: 0.9,
    sensors: SensorModel | None = None,
    estimator: Estimator | None = None,
    late: tuple[str, ...] = (),
    hold_s: float = 0.0,
) -> LateralRun:
    """Drive; without `control` the driver's steering passes.

    Args:
        speed_mps: what the driver keeps to, or that of each stamp.
        estimator: what the controller sees through; None shows it the truth.
        hold_s: above 0 the controller runs and sees the estimate only so often, and its command
            is held between: one rate for all.
    """
    plant = Plant(parameters, friction)
    sensors = sensors or SensorModel()
    preview_m = sensors.preview_m
    feed = SensorFeed(parameters, sensors, rng, estimator, late)
    wanted_mps = speed_mps if callable(speed_mps) else _kept(speed_mps)
    state = plant.rolling(wanted_mps(0.0))
    command, due = Command(0.0, 0.0), 0.0
    rows: list[tuple[float, ...]] = []
    for _ in range(round(duration_s / plant.step_s)):
        measured = feed.step(state)
        wanted = driver(state.time_s)
        if control is None:
            command = Command(wanted, 0.0)
        elif hold_s <= 0.0:
            seen = _see(state, estimator, preview_m)
            command = control(wanted, seen, measured, plant.step_s)
        elif state.time_s >= due - 1e-9:
            seen = _see(state, estimator, preview_m)
            command = control(wanted, seen, measured, hold_s)
            due += hold_s
        left, right = distribute_torque(
            command.yaw_moment_nm,
            _SPEED_GAIN_PER_S * (wanted_mps(state.time_s) - measured.speed_mps),
            mass_kg=parameters.mass_kg,
            radius_m=parameters.wheel_radius_m,
            rear_track_m=parameters.track_m,
            torque_limit_nm=parameters.torque_limit_nm,
        )
        now = state
        state = plant.step(state, PlantInput(command.steer_rad, (0.0, 0.0, left, right)))
        rows.append(
            (
                now.time_s,
                now.sideslip_rad(),
                now.yaw_rate_radps,
                command.sideslip_reference_rad,
                command.yaw_rate_reference_radps,
                now.steer_rad,
                command.yaw_moment_nm,
                float(command.saturated),
                now.vx_mps,
                _offset_m(now, preview_m),
                command.offset_reference_m,
            )
        )
    c = np.array(rows).T
    return LateralRun(c[0], c[1], c[2], c[3], c[4], c[5], c[6], c[7] > 0.5, *c[8:])


def _kept(speed_mps: float) -> Callable[[float], float]:
    return lambda _stamp_s: speed_mps


_TRUE_FIELDS = ("sideslip_rad", "yaw_rate_radps", "heading_rad", "lateral_offset_m")


def _see(state: PlantState, estimator: Estimator | None, preview_m: float) -> Estimate:
    if estimator is not None:
        return estimator.estimate()
    true = np.array(
        [
            state.sideslip_rad(),
            state.yaw_rate_radps,
            state.yaw_rad,
            _offset_m(state, preview_m),
        ]
    )
    return Estimate(state.time_s, _TRUE_FIELDS, true, np.zeros(4))


def _offset_m(state: PlantState, preview_m: float) -> float:
    """As `SensorFeed` shows it to the camera."""
    return state.north_m + preview_m * state.yaw_rad


@dataclass(frozen=True, slots=True)
class LaneChange:
    """One sine of the road-wheel angle: a car's width to the left and on along the lane."""

    amplitude_rad: float = 0.1
    period_s: float = 2.0
    begin_s: float = 2.0

    def __call__(self, stamp_s: float) -> float:
        share = (stamp_s - self.begin_s) / self.period_s
        return self.amplitude_rad * sin(2.0 * pi * share) if 0.0 <= share <= 1.0 else 0.0


class BodySlipLoop:
    """W14's controller on an estimate: the side-slip is wanted to be zero.

    Args:
        feed_forward: N m/rad at any speed; None schedules it.
    """

    def __init__(
        self,
        car: Car,
        gains: PiGains,
        limit_nm: float,
        feed_forward: float | None = None,
    ) -> None:
        forward = FeedForwardSchedule(car) if feed_forward is None else feed_forward
        self._controller = BodySlipController(forward, gains, limit_nm)
        self._limit_nm = limit_nm

    def __call__(
        self, driver_rad: float, seen: Estimate, measured: Measured, dt_s: float
    ) -> Command:
        # the driver's angle is what the motors answer to: the measured one comes a lag later
        moment = self._controller.step(
            driver_rad, -seen.value("sideslip_rad"), dt_s, measured.speed_mps
        )
        return Command(driver_rad, moment, abs(moment) >= self._limit_nm)
