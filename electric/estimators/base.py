"""The one protocol of all estimators, and what they share."""

from __future__ import annotations

from dataclasses import dataclass
from math import exp
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from polemap.vehicle.errors import VehicleError

Floats = NDArray[np.float64]
Value = float | Floats | tuple[float, ...]

YAW_RATE, LATERAL_ACCELERATION = "yaw_rate", "lateral_acceleration"
CAMERA, GPS, WHEEL_SPEED = "camera", "gps", "wheel_speed"
# silence of a late sensor that counts as a loss: over ten pictures, two GPS fixes
OUTAGE_S = 0.5
# time constant by which the output joins after a loss; a driver or controller sees no jump then
BRIDGE_TIME_S = 0.3
KINDS = (YAW_RATE, LATERAL_ACCELERATION, CAMERA, GPS, WHEEL_SPEED)


class Inputs(NamedTuple):
    """What drives the models over the step that ends at the stamp; held since the last step."""

    road_wheel_angle_rad: float
    speed_mps: float
    yaw_moment_nm: float = 0.0
    ax_mps2: float = 0.0
    ay_mps2: float = 0.0
    yaw_rate_radps: float = 0.0
    road_curvature_per_m: float = 0.0


@dataclass(frozen=True, slots=True)
class Estimate:
    """What an estimator holds true at `stamp_s`.

    Attributes:
        fields: names of the states with their units, as in the signal log.
        mean: `(n,)`.
        sd: `(n,)` standard deviations.
    """

    stamp_s: float
    fields: tuple[str, ...]
    mean: Floats
    sd: Floats

    def value(self, name: str) -> float:
        """One state by name."""
        return float(self.mean[self.fields.index(name)])

    def sd_of(self, name: str) -> float:
        """Its standard deviation."""
        return float(self.sd[self.fields.index(name)])


class Estimator(Protocol):
    """How every estimator is driven, from a log, a simulation or a car.

    Each fast step calls `step`, then `measure` for what is there at that step (the gyro first),
    then `measure` for late values that arrive at it, then `capture` for every late sensor that
    takes its picture at it. Kinds and their values: `yaw_rate` (rad/s), `lateral_acceleration`
    (m/s^2), `camera` (heading rad, lateral offset m), `gps` (course rad, speed m/s; where a fix
    states them the deviations of both follow),
    `wheel_speed` (m/s). A kind that an estimator does not use is no error and changes nothing.
    """

    dropped: dict[str, int]

    @property
    def fields(self) -> tuple[str, ...]:
        """Names of the states that `estimate` reports, units in them."""
        ...

    def step(self, stamp_s: float, inputs: Inputs) -> None:
        """Predict to `stamp_s`; the first call only sets the clock."""
        ...

    def capture(self, kind: str, stamp_s: float) -> None:
        """A late sensor measures now; its value will follow."""
        ...

    def measure(self, kind: str, value: Value, stamp_s: float, arrival_s: float) -> None:
        """A value measured at `stamp_s` is there at `arrival_s`, which is now."""
        ...

    def estimate(self) -> Estimate:
        """The state of now."""
        ...

    def covariance(self) -> Floats:
        """`(n, n)` of the fields."""
        ...


class Clock:
    """The stamp of the last step, and the time since the one before."""

    __slots__ = ("nominal_s", "stamp_s")

    def __init__(self, nominal_s: float) -> None:
        self.nominal_s = nominal_s
        self.stamp_s = float("nan")

    def advance(self, stamp_s: float) -> float:
        """Seconds since the last step, 0 at the first; the nominal step where it is within 1e-6.

        Raises:
            VehicleError: the stamp does not grow.
        """
        last, self.stamp_s = self.stamp_s, stamp_s
        if last != last:
            return 0.0
        elapsed = stamp_s - last
        if not elapsed > 0.0:
            self.stamp_s = last
            raise VehicleError(f"step at {stamp_s} s does not follow the one at {last} s")
        return self.nominal_s if -1e-6 < elapsed - self.nominal_s < 1e-6 else elapsed


class OutputBridge:
    """Lets the output join the state smoothly after a late sensor came back.

    While a sensor is silent the state drifts within its growing covariance, and the first value
    afterwards rightly corrects it at once. The output carries the difference on and lets it fade;
    what is left of it is added to the standard deviation, so the output stays honest.
    """

    def __init__(self, size: int) -> None:
        self._offset = np.zeros(size)
        self._since_s = float("-inf")
        self._heard_s = float("nan")

    def corrected(self, stamp_s: float, before: Floats, after: Floats) -> None:
        """A value of the late sensor moved the state from `before` to `after`."""
        heard, self._heard_s = self._heard_s, stamp_s
        if stamp_s - heard > OUTAGE_S:
            self._offset = self.offset(stamp_s) + (before - after)
            self._since_s = stamp_s

    def offset(self, stamp_s: float) -> Floats:
        """What is still to be added to the state."""
        age = stamp_s - self._since_s
        if age > 20.0 * BRIDGE_TIME_S:
            return np.zeros_like(self._offset)
        return self._offset * exp(-age / BRIDGE_TIME_S)

    def output(
        self, stamp_s: float, fields: tuple[str, ...], mean: Floats, covariance: Floats
    ) -> Estimate:
        """The estimate with the bridge in it."""
        if stamp_s - self._since_s > 20.0 * BRIDGE_TIME_S:
            return Estimate(stamp_s, fields, mean, np.sqrt(covariance.diagonal()))
        offset = self.offset(stamp_s)
        sd = np.sqrt(np.maximum(np.diag(covariance), 0.0))
        return Estimate(stamp_s, fields, mean + offset, sd + np.abs(offset))


def pair(kind: str, value: Value) -> tuple[float, float]:
    """The two numbers of a camera or GPS value; `fix_spread` has what may follow them.

    Raises:
        VehicleError: not two finite numbers.
    """
    try:
        first, second, *_ = value  # type: ignore[misc]
        first, second = float(first), float(second)
    except (TypeError, ValueError) as error:
        raise VehicleError(f"{kind} needs two numbers, not {value!r}") from error
    if not (abs(first) < float("inf") and abs(second) < float("inf")):
        raise VehicleError(f"{kind} value {value!r} is not finite")
    return first, second


def fix_spread(value: Value, course_sd_rad: float, speed_sd_mps: float) -> tuple[float, float]:
    """Deviations of a GPS value's course and speed: its own where it has them, else these.

    Raises:
        VehicleError: stated deviations that are not positive numbers.
    """
    if isinstance(value, float) or len(value) == 2:
        return course_sd_rad, speed_sd_mps
    course, speed = (float(number) for number in value[2:4])
    if not (0.0 < course < float("inf") and 0.0 < speed < float("inf")):
        raise VehicleError(f"gps value {value!r}: deviations of course and speed must be positive")
    return course, speed
