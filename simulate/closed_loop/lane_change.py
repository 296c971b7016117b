"""Body-slip control in a lane change: the controller behind an estimator, and the driver."""

from __future__ import annotations

from dataclasses import dataclass
from math import pi, sin

from polemap.electric.control.body_slip import BodySlipController, PiGains, feed_forward_gain
from polemap.electric.estimators.base import Estimate
from polemap.simulate.closed_loop.lateral import Command
from polemap.simulate.closed_loop.sensing import Measured
from polemap.vehicle.parameters import Car
from polemap.vehicle.single_track import lateral


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
    """W14's controller on an estimate: the side-slip is wanted to be zero."""

    def __init__(self, car: Car, speed_mps: float, gains: PiGains, limit_nm: float) -> None:
        self._controller = BodySlipController(
            feed_forward_gain(*lateral(car, speed_mps)), gains, limit_nm
        )
        self._limit_nm = limit_nm

    def __call__(
        self, driver_rad: float, seen: Estimate, measured: Measured, dt_s: float
    ) -> Command:
        # the driver's angle is what the motors answer to: the measured one comes a lag later
        moment = self._controller.step(driver_rad, -seen.value("sideslip_rad"), dt_s)
        return Command(driver_rad, moment, abs(moment) >= self._limit_nm)
