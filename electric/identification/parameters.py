"""What is fitted, how sure one is of it beforehand, and the values that it cannot leave."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import exp, log
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polemap.vehicle.parameters import Car

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Parameter:
    """One quantity of a fit.

    Attributes:
        name: a field of `Car` or of `Sensors`.
        sd: of what is believed beforehand; of its logarithm where `relative`.
        reach: how far from the start a value may go, in the same measure.
        relative: fitted as the logarithm of its ratio to the start.
        low, high: values that no car has.
    """

    name: str
    sd: float
    reach: float
    relative: bool = False
    low: float = float("-inf")
    high: float = float("inf")


@dataclass(frozen=True, slots=True)
class Sensors:
    """How a log's sensors differ from what their columns are called.

    Attributes:
        gyro_offset_radps: what the yaw rate shows in straight driving.
        ay_offset_mps2: what the lateral acceleration shows in straight driving: bias, bank.
        ay_point_m: how far ahead of the centre of gravity the accelerometer sits.
        ay_scale: what it shows over the truth: roll of the body adds to it.
        sideslip_offset_rad: by what the side-slip reference is turned.
        speed_delay_s, ay_delay_s, sideslip_delay_s: how much later than the gyro these columns show
            what the car does.
    """

    gyro_offset_radps: float = 0.0
    ay_offset_mps2: float = 0.0
    ay_point_m: float = 0.0
    ay_scale: float = 1.0
    sideslip_offset_rad: float = 0.0
    speed_delay_s: float = 0.0
    ay_delay_s: float = 0.0
    sideslip_delay_s: float = 0.0


# Beliefs about a car whose data sheet gives mass and wheelbase. Stiffness: tyres of one load differ
# by a factor of 1.5; friction: dry roads 0.8 to 1.2; radius of gyration within 6 % of what the car
# file says (for cars k^2 is 0.9 to 1.1 of lf lr); split of drive and brakes: seldom published.
PARAMETERS = (
    Parameter("front_slip_stiffness_nprad", 0.4, 1.4, relative=True),
    Parameter("rear_slip_stiffness_nprad", 0.4, 1.4, relative=True),
    Parameter("front_friction", 0.2, 0.6, relative=True, low=0.1, high=2.0),
    Parameter("rear_friction", 0.2, 0.6, relative=True, low=0.1, high=2.0),
    Parameter("yaw_inertia_kgm2", 0.12, 0.5, relative=True),
    Parameter("cg_height_m", 0.25, 0.7, relative=True, low=0.15, high=1.5),
    Parameter("front_drive_share", 0.3, 1.0, low=0.0, high=1.0),
    Parameter("front_brake_share", 0.1, 0.4, low=0.3, high=0.9),
    Parameter("steering_offset_rad", 0.01, 0.05),
    Parameter("steering_scale", 0.05, 0.25, relative=True),
    Parameter("sideslip_point_m", 0.4, 2.0),
    Parameter("steering_delay_s", 0.02, 0.15),
    Parameter("gyro_offset_radps", 0.003, 0.02),
    Parameter("ay_offset_mps2", 0.2, 1.0),
    Parameter("ay_point_m", 0.3, 1.5),
    Parameter("ay_scale", 0.03, 0.15, relative=True),
    Parameter("sideslip_offset_rad", 0.003, 0.02),
    Parameter("speed_delay_s", 0.02, 0.15),
    Parameter("ay_delay_s", 0.02, 0.15),
    Parameter("sideslip_delay_s", 0.02, 0.15),
)
LINEAR_PARAMETERS = (
    Parameter("front_stiffness_nprad", 0.4, 1.4, relative=True),
    Parameter("rear_stiffness_nprad", 0.4, 1.4, relative=True),
)
OF_REFERENCE = ("sideslip_point_m", "sideslip_offset_rad", "sideslip_delay_s")
OF_ACCELEROMETER = ("ay_offset_mps2", "ay_point_m", "ay_scale", "ay_delay_s")


@dataclass(frozen=True, slots=True)
class Space:
    """The parameters of one fit about a start, each in units of its prior deviation."""

    car: Car
    parameters: tuple[Parameter, ...]
    sensors: Sensors = Sensors()

    def bounds(self) -> tuple[Floats, Floats]:
        """Lowest and highest units, each `(n,)`; the start lies between them."""
        low, high = [], []
        for p in self.parameters:
            start = self._start(p)
            ends = [-p.reach, p.reach]
            for k, value in enumerate((p.low, p.high)):
                if not np.isfinite(value):
                    continue
                off = log(value / start) if p.relative else value - start
                ends[k] = max(ends[k], off) if k == 0 else min(ends[k], off)
            low.append(min(ends[0], -1e-6) / p.sd)
            high.append(max(ends[1], 1e-6) / p.sd)
        return np.array(low), np.array(high)

    def value(self, index: int, units: float) -> float:
        """The value of a parameter."""
        p = self.parameters[index]
        start = self._start(p)
        return start * exp(units * p.sd) if p.relative else start + units * p.sd

    def sd(self, index: int, units: float, units_sd: float) -> float:
        """Standard deviation of a value that stands at `units`."""
        p = self.parameters[index]
        return units_sd * p.sd * (abs(self.value(index, units)) if p.relative else 1.0)

    def at(self, units: Floats) -> tuple[Car, Sensors]:
        """The car and its sensors at a point of the fit."""
        ours = {p.name: self.value(i, float(u)) for i, (p, u) in
                enumerate(zip(self.parameters, units, strict=True))}  # fmt: skip
        sensors = {n: ours.pop(n) for n in list(ours) if n in Sensors.__dataclass_fields__}
        for name in ("front_drive_share", "front_brake_share"):
            if name in ours:
                ours[name] = min(max(ours[name], 0.0), 1.0)
        changed: dict[str, Any] = {**ours}
        return replace(self.car, **changed), replace(self.sensors, **sensors)

    def _start(self, parameter: Parameter) -> float:
        if parameter.name in Sensors.__dataclass_fields__:
            return float(getattr(self.sensors, parameter.name))
        return float(getattr(self.car, parameter.name))
