"""The one protocol of all estimators, and what they share."""

from __future__ import annotations

from dataclasses import dataclass
from math import exp
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from polemap.electric.config import EstimatorConfig
from polemap.vehicle.errors import VehicleError

Floats = NDArray[np.float64]
Value = float | Floats | tuple[float, ...]

YAW_RATE, LATERAL_ACCELERATION = "yaw_rate", "lateral_acceleration"
CAMERA, GPS, WHEEL_SPEED = "camera", "gps", "wheel_speed"
KINDS = (YAW_RATE, LATERAL_ACCELERATION, CAMERA, GPS, WHEEL_SPEED)


class Inputs(NamedTuple):
    """What drives the models over the step that ends at the stamp; held since the last step."""

    road_wheel_angle_rad: float
    speed_mps: float
    yaw_moment_nm: float = 0.0
    ax_mps2: float = 0.0
    ay_mps2: float = 0.0
    yaw_rate_radps: float = 0.0


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
    (m/s^2), `camera` (heading rad, lateral offset m), `gps` (course rad, speed m/s),
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

    def __init__(self, config: EstimatorConfig, size: int) -> None:
        self._outage_s, self._time_s = config.outage_s, config.bridge_time_s
        self._offset = np.zeros(size)
        self._since_s = float("-inf")
        self._heard_s = float("nan")

    def corrected(self, stamp_s: float, before: Floats, after: Floats) -> None:
        """A value of the late sensor moved the state from `before` to `after`."""
        heard, self._heard_s = self._heard_s, stamp_s
        if stamp_s - heard > self._outage_s and self._time_s > 0.0:
            self._offset = self.offset(stamp_s) + (before - after)
            self._since_s = stamp_s

    def offset(self, stamp_s: float) -> Floats:
        """What is still to be added to the state."""
        age = stamp_s - self._since_s
        if self._time_s <= 0.0 or age > 20.0 * self._time_s:
            return np.zeros_like(self._offset)
        return self._offset * exp(-age / self._time_s)

    def output(
        self, stamp_s: float, fields: tuple[str, ...], mean: Floats, covariance: Floats
    ) -> Estimate:
        """The estimate with the bridge in it."""
        if stamp_s - self._since_s > 20.0 * self._time_s:
            return Estimate(stamp_s, fields, mean, np.sqrt(covariance.diagonal()))
        offset = self.offset(stamp_s)
        sd = np.sqrt(np.maximum(np.diag(covariance), 0.0))
        return Estimate(stamp_s, fields, mean + offset, sd + np.abs(offset))


class FastClones:
    """A linear Kalman filter with clones of `S x`, in few small array operations a step.

    It does what `vehicle.delay.ClonedFilter` does, which the tests hold it against, with the
    buffers laid out once: `[x, S x(t1), S x(t2) ...]`.

    Args:
        state: `(n,)`; covariance: `(n, n)`; selection: S `(m, n)`; slots: captures on their way.
    """

    def __init__(self, state: Floats, covariance: Floats, selection: Floats, slots: int) -> None:
        n, m = len(state), len(selection)
        size = n + m * slots
        self.size, self.n, self.m, self.slots = size, n, m, slots
        self.x = np.zeros(size)
        self.x[:n] = state
        self.p = np.zeros((size, size))
        self.p[:n, :n] = covariance
        self._g, self._eye = np.eye(size), np.eye(size)
        self._g_transposed = self._g.T
        self._work, self._vector = np.zeros((size, size)), np.zeros(size)
        self._outer, self._row = np.zeros((size, size)), np.zeros(size)
        self._g_state, self._p_state = self._g[:n, :n], self.p[:n, :n]
        self._x_state = self.x[:n]
        self.selection = selection
        self.owners: list[float | None] = [None] * slots

    def predict(self, transition: Floats, driven: Floats, noise: Floats) -> None:
        """`x+ = G x + driven`, `P+ = G P G' + Q`; clones hold."""
        self._g_state[:] = transition
        np.dot(self._g, self.x, out=self._vector)
        self.x[:] = self._vector
        self._x_state += driven
        np.dot(self._g, self.p, out=self._work)
        np.dot(self._work, self._g_transposed, out=self.p)
        self._p_state += noise

    def scalar(self, index: int, measured: float, variance: float) -> None:
        """A direct measurement of one state: `P - (P h)(P h)' / s` is the short form for it."""
        row = self._row
        row[:] = self.p[index]
        s = row.item(index) + variance
        gain = (measured - self.x.item(index)) / s
        np.multiply.outer(row, row, out=self._outer)
        self._outer /= s
        self.p -= self._outer
        row *= gain
        self.x += row

    def capture(self, stamp_s: float) -> None:
        """Clone `S x`; the oldest capture is given up where no slot is free."""
        owners = self.owners
        if None in owners:
            slot = owners.index(None)
        else:
            slot = min(range(self.slots), key=lambda i: owners[i] or 0.0)
        owners[slot] = stamp_s
        rows = slice(self.n + slot * self.m, self.n + (slot + 1) * self.m)
        s, n = self.selection, self.n
        self.p += self.p.T.copy()
        self.p *= 0.5
        self.x[rows] = s @ self.x[:n]
        self.p[rows, :] = s @ self.p[:n, :]
        self.p[:, rows] = self.p[rows, :].T
        self.p[rows, rows] = s @ self.p[:n, :n] @ s.T

    def clone(self, stamp_s: float) -> slice | None:
        """Where the capture of `stamp_s` lies in the state."""
        for slot, owner in enumerate(self.owners):
            if owner is not None and abs(owner - stamp_s) < 1e-6:
                return slice(self.n + slot * self.m, self.n + (slot + 1) * self.m)
        return None

    def update(self, jacobian: Floats, residual: Floats, noise: Floats) -> None:
        """Joseph update with `jacobian` `(k, size)`."""
        cross = self.p @ jacobian.T
        s = jacobian @ cross
        s += noise
        if len(s) == 2:
            # by hand: LAPACK's call costs more than all the rest of the step
            a, b, c, d = s.ravel().tolist()
            gain = cross @ np.array([[d, -b], [-c, a]])
            gain /= a * d - b * c
        else:
            gain = np.linalg.solve(s, cross.T).T
        keep = self._eye - gain @ jacobian
        p = keep @ self.p @ keep.T
        p += gain @ noise @ gain.T
        p += p.T.copy()
        np.multiply(p, 0.5, out=self.p)
        self.x += gain @ residual

    def release(self, stamp_s: float) -> None:
        """Free the slot of a capture; it must not bear on anything any more."""
        rows = self.clone(stamp_s)
        if rows is not None:
            self.owners[(rows.start - self.n) // self.m] = None
            self.x[rows] = 0.0
            self.p[rows, :] = 0.0
            self.p[:, rows] = 0.0


def pair(kind: str, value: Value) -> tuple[float, float]:
    """The two numbers of a camera or GPS value.

    Raises:
        VehicleError: not two finite numbers.
    """
    try:
        first, second = value  # type: ignore[misc]
        first, second = float(first), float(second)
    except (TypeError, ValueError) as error:
        raise VehicleError(f"{kind} needs two numbers, not {value!r}") from error
    if not (abs(first) < float("inf") and abs(second) < float("inf")):
        raise VehicleError(f"{kind} value {value!r} is not finite")
    return first, second
