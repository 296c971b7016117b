"""An estimator that goes on without the sensor that is at fault."""

from __future__ import annotations

from math import exp

import numpy as np
from numpy.typing import NDArray

from polemap.electric.config import EstimatorConfig
from polemap.electric.estimators.base import (
    CAMERA,
    GPS,
    LATERAL_ACCELERATION,
    WHEEL_SPEED,
    YAW_RATE,
    Estimator,
    Inputs,
    Value,
    fix_spread,
    pair,
)
from polemap.electric.estimators.forwarding import Forwarding
from polemap.electric.isolation import alone, families
from polemap.electric.isolation.isolator import Isolator
from polemap.electric.isolation.leaps import Leaps
from polemap.electric.isolation.suspicion import Fault
from polemap.vehicle.parameters import Car

Floats = NDArray[np.float64]
OF_KIND = {
    YAW_RATE: alone.GYRO,
    LATERAL_ACCELERATION: alone.LATERAL,
    WHEEL_SPEED: alone.WHEEL_SPEED,
    CAMERA: families.CAMERA,
    GPS: families.GPS,
}
_OF_INPUT = (alone.STEERING, alone.WHEEL_SPEED, "", alone.FORWARD, alone.LATERAL, alone.GYRO,
             families.CAMERA)  # fmt: skip
# a sensor that is believed again has its full share after so long: nothing jumps
RETURN_S = 0.5
# what a fault left in a course is forgotten so slowly that the heading follows, not the side-slip
COURSE_TIME_S, _COURSE_LEAST_RAD = 60.0, 0.03
# rates of steering and gyro that no car reaches (1000 degrees/s at the wheel; friction at one axle
# makes g / wheelbase = 4 rad/s^2), what vibration adds, and their noise as long as it is not known
_STEERING_RATE, _STEERING_LEAP_RAD, _STEERING_SD_RAD = 1.2, 0.01, 1e-3
_GYRO_RATE, _GYRO_LEAP_RADPS, _GYRO_SD_RADPS = 5.0, 0.03, 5e-3
# an input further from the last one than any car moves it in a step is held for so many steps
_JUMP_STEPS = 3
_STEERING, _SPEED, _FORWARD, _LATERAL, _YAW_RATE = 0.06, 1.5, 12.0, 12.0, 0.3
_JUMPS = (_STEERING, _SPEED, float("inf"), _FORWARD, _LATERAL, _YAW_RATE, float("inf"))
_LEAST_SPEED_MPS, _STEERING_MAX_RAD, _YAW_RATE_MAX_RADPS, _GAIN_S = 2.0, 0.7, 1.5, 0.5


class FaultTolerant(Forwarding):
    """Hears what its estimator hears and keeps from it what is faulty.

    Values of a faulty sensor are withheld; where it is an input the others stand in: steering from
    the yaw rate by the steady bend, yaw rate from the steering or from ay / v, ay from v times the
    yaw rate, ax from the wheels, speed from ax and GPS, the lane's bend from the car's path. While
    no sensor is faulty the estimator is told every value as it came, but for an input that jumps,
    which is held for up to three steps, and a steering or gyro that leaps as no car does (`Leaps`).

    Args:
        needs: the kinds without which the estimator does not work: where these are a yaw rate and
            a lateral acceleration, it is told both or none.
        faults: takes the faults found.
    """

    def __init__(
        self,
        inner: Estimator,
        car: Car,
        config: EstimatorConfig,
        needs: tuple[str, ...],
        faults: list[Fault],
    ) -> None:
        super().__init__(inner)
        self._car, self._config, self._faults = car, config, faults
        self._together = {alone.GYRO, alone.LATERAL}
        if not {YAW_RATE, LATERAL_ACCELERATION} <= set(needs):
            self._together = set()
        self._isolator: Isolator | None = None
        self._found = len(faults)
        self._faulty: set[str] = set()
        self._returned_s: dict[str, float] = {}
        self._last: Inputs | None = None
        self._jumped = [0] * len(_JUMPS)
        self._stand_in = [0.0] * len(_JUMPS)
        self._stamp_s = 0.0
        self._steering_leaps = Leaps(_STEERING_RATE, _STEERING_LEAP_RAD, _STEERING_SD_RAD)
        self._gyro_leaps = Leaps(_GYRO_RATE, _GYRO_LEAP_RADPS, _GYRO_SD_RADPS)
        self._course_off_rad, self._course_since_s = 0.0, 0.0

    def step(self, stamp_s: float, inputs: Inputs) -> None:
        """Predict, on inputs that are believed."""
        self._stamp_s = stamp_s
        isolator, heard, last = self._isolator, inputs, self._last
        if last is not None and not (
            -_STEERING < inputs[0] - last[0] < _STEERING
            and -_SPEED < inputs[1] - last[1] < _SPEED
            and -_FORWARD < inputs[3] - last[3] < _FORWARD
            and -_LATERAL < inputs[4] - last[4] < _LATERAL
            and -_YAW_RATE < inputs[5] - last[5] < _YAW_RATE
        ):
            inputs = self._without_jumps(inputs, last)
        if self._gyro_leaps.held:
            inputs = inputs._replace(yaw_rate_radps=self._gyro_leaps.before)
        if self._steering_leaps.hold_back(heard[0], stamp_s):
            inputs = inputs._replace(road_wheel_angle_rad=self._steering_leaps.before)
            self._leapt(alone.STEERING, self._steering_leaps, heard[0], stamp_s)
        self._last = inputs
        if isolator is None:
            isolator = Isolator(self._car, self._config, self._faults, stamp_s, inputs.speed_mps)
            self._isolator, self._faulty = isolator, isolator.faulty
        else:
            isolator.hear(stamp_s, heard, inputs)
            if stamp_s >= isolator.next_s:
                for name in isolator.tick():
                    self._returned_s[name] = stamp_s
                    if name == families.GPS:
                        self._course_off_rad, self._course_since_s = float("nan"), stamp_s
                self._steering_leaps.noise = isolator.noise(alone.STEERING) or _STEERING_SD_RAD
                self._gyro_leaps.noise = isolator.noise(alone.GYRO) or _GYRO_SD_RADPS
        if len(self._faults) > self._found:
            self._doubt()
        if self._faulty or self._returned_s:
            inputs = self._mended(isolator, inputs)
        self._inner.step(stamp_s, inputs)

    def _doubt(self) -> None:
        """A sensor was believed while votes gathered against it: what it taught is open again."""
        new, self._found = self._faults[self._found :], len(self._faults)
        doubt = getattr(self._inner, "doubt", None)
        if doubt is not None and any(f.found_s > f.from_s and " or " not in f.sensor for f in new):
            doubt()

    def _leapt(self, name: str, leaps: Leaps, value: float, stamp_s: float) -> None:
        """Accuse a sensor whose step has lasted."""
        size = leaps.lasts(value, stamp_s)
        if size and self._isolator is not None:
            self._isolator.leapt(name, size, stamp_s)

    def _without_jumps(self, inputs: Inputs, last: Inputs) -> Inputs:
        """A jump is held back until it lasts: single wild values move nothing."""
        values = list(inputs)
        for index, limit in enumerate(_JUMPS):
            if not abs(values[index] - last[index]) > limit:
                self._jumped[index] = 0
            elif self._jumped[index] < _JUMP_STEPS:
                self._jumped[index] += 1
                values[index] = last[index]
            else:
                self._jumped[index] = 0
        return Inputs._make(values)

    def _mended(self, isolator: Isolator, inputs: Inputs) -> Inputs:
        """Inputs with others in the place of what is faulty, and back within `RETURN_S`."""
        faulty, motion, car = self._faulty, isolator.motion, self._car
        angle, speed, moment, ax, ay, rate, bend = inputs
        if alone.WHEEL_SPEED in faulty:
            speed = isolator.speed.mps
        fast = max(abs(speed), _LEAST_SPEED_MPS)
        if alone.GYRO in faulty:
            by_ay = alone.STEERING in faulty and alone.LATERAL in isolator.heard - faulty
            rate = ay / fast if by_ay else motion.yaw_rate_radps
            rate = min(max(rate, -_YAW_RATE_MAX_RADPS), _YAW_RATE_MAX_RADPS)
        if alone.STEERING in faulty:
            understeer = max(car.understeer_s2pm, 0.0)
            angle = rate / fast * (car.wheelbase_m + understeer * fast * fast)
            angle = min(max(angle, -_STEERING_MAX_RAD), _STEERING_MAX_RAD)
        if alone.LATERAL in faulty:
            ay = fast * rate
        if alone.FORWARD in faulty:
            then = motion.before(_GAIN_S)
            known = then is not None and alone.WHEEL_SPEED not in faulty
            ax = (motion.now.wheel - then.wheel) / _GAIN_S if known and then is not None else 0.0
        if families.CAMERA in faulty:
            bend = rate / fast
        values = [angle, speed, moment, ax, ay, rate, bend]
        for index, name in enumerate(_OF_INPUT):
            if name in faulty:
                self._stand_in[index] = values[index]
            elif name in self._returned_s:
                share = min((self._stamp_s - self._returned_s[name]) / RETURN_S, 1.0)
                values[index] = share * values[index] + (1.0 - share) * self._stand_in[index]
        for name, since_s in list(self._returned_s.items()):
            if self._stamp_s - since_s >= RETURN_S:
                del self._returned_s[name]
        return Inputs._make(values)

    def capture(self, kind: str, stamp_s: float) -> None:
        """A late sensor measures now."""
        if self._isolator is not None:
            self._isolator.captured(kind, stamp_s)
        self._inner.capture(kind, stamp_s)

    def measure(self, kind: str, value: Value, stamp_s: float, arrival_s: float) -> None:
        """A value, told to the estimator where its sensor is believed."""
        isolator, name = self._isolator, OF_KIND[kind]
        if isolator is not None:
            if kind in (CAMERA, GPS):
                first, second = pair(kind, value)
                sd_rad = fix_spread(value, 0.0, 0.0)[0] if kind == GPS else 0.0
                isolator.arrived(kind, stamp_s, first, second, arrival_s, sd_rad)
                if kind == GPS and self._course_off_rad:
                    value = (self._course(isolator, first), *value[1:])  # type: ignore[index]
            else:
                if name not in isolator.heard:
                    isolator.heard.add(name)
                if kind == YAW_RATE and self._gyro_leaps.hold_back(value, stamp_s):  # type: ignore[arg-type]
                    self._leapt(alone.GYRO, self._gyro_leaps, float(value), stamp_s)  # type: ignore[arg-type]
                    isolator.withheld(name)
                    return
                if self._gyro_leaps.held and name in self._together:
                    return
            if self._faulty and (
                name in self._faulty
                or (name in self._together and not self._together.isdisjoint(self._faulty))
            ):
                isolator.withheld(name)
                return
            if kind == YAW_RATE and name in self._returned_s:
                value = self._blended(float(value))  # type: ignore[arg-type]
        self._inner.measure(kind, value, stamp_s, arrival_s)

    def _blended(self, yaw_rate_radps: float) -> float:
        """A gyro that comes back moves the estimate no faster than within `RETURN_S`."""
        if "yaw_rate_radps" not in self._inner.fields:
            return yaw_rate_radps
        own = self._inner.estimate().value("yaw_rate_radps")
        share = min((self._stamp_s - self._returned_s[alone.GYRO]) / RETURN_S, 1.0)
        return own + share * (yaw_rate_radps - own)

    def _course(self, isolator: Isolator, course_rad: float) -> float:
        """The course less what a fault left in it."""
        if self._course_off_rad != self._course_off_rad:
            off = isolator.course_offset()
            self._course_off_rad = off if abs(off) > _COURSE_LEAST_RAD else 0.0
        age = self._stamp_s - self._course_since_s
        return course_rad - self._course_off_rad * exp(-age / COURSE_TIME_S)
