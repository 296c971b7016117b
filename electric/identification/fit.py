"""The fit: prediction errors and prior beliefs weighed together, and what they leave open."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy
from numpy.typing import NDArray

from polemap.electric.identification.parameters import (
    LINEAR_PARAMETERS,
    OF_ACCELEROMETER,
    OF_REFERENCE,
    PARAMETERS,
    Sensors,
    Space,
)
from polemap.electric.identification.prediction import Rows, rows_of
from polemap.electric.identification.residuals import (
    LATERAL,
    SIDESLIP,
    SPEED_MPS,
    YAW_RATE,
    residual_sds,
    residuals,
)
from polemap.electric.identification.selection import told_from_start
from polemap.electric.signals import SignalLog
from polemap.vehicle.errors import VehicleError
from polemap.vehicle.parameters import Car

Floats = NDArray[np.float64]

_LEAST_S = 3.0
_LEAST_TURN_RADPS = 0.1
# a share of the prior deviation from which on the data have told nothing of a parameter, and the
# distance from a bound, in prior deviations, that counts as standing at it
_OPEN_SHARE, _AT_BOUND = 0.8, 0.02
# what a residual is worth and the fit are found in turn, until no parameter moves by more than this
# share of its prior deviation
_SETTLED, _PASSES_MOST = 0.05, 10
# friction of tyres that stay linear
_NO_LIMIT = 100.0


@dataclass(frozen=True, slots=True)
class Fitted:
    """One parameter.

    Attributes:
        value, sd: after the fit.
        start, prior_sd: before it.
        at_bound: it stands at a value that it cannot leave, and is not to be trusted.
        open: the log does not tell it from the start, where it stays, or tells hardly more of it
            than was believed before.
    """

    name: str
    value: float
    sd: float
    start: float
    prior_sd: float
    at_bound: bool
    open: bool


@dataclass(frozen=True, slots=True)
class Fit:
    """A car with fitted parameters, and what is left over.

    Attributes:
        car: the start with what was fitted.
        sensors: offsets, delay and places of this log's sensors.
        parameters: all that was fitted.
        left: root mean square of what is left over on the rows fitted to, by channel, with the
            reference heard.
        rows: rows of the log that were used.
    """

    car: Car
    sensors: Sensors
    parameters: tuple[Fitted, ...]
    left: dict[str, float]
    rows: int


def identify(
    logs: Sequence[SignalLog], car: Car, *, name: str, source: str, fixed: Sequence[str] = ()
) -> Fit:
    """Fit what steering, gyro, accelerometer and a side-slip reference tell of a car.

    Mass, wheelbase and weight split stay as they are in `car`: steering and side-slip see
    stiffness, friction and inertia only in proportion to the mass, and the split only together
    with the reference's place. All else is believed to lie about `car` with the deviations of
    `parameters.PARAMETERS`, so that what a log does not excite stays where it was, and is said
    to be open. A side-slip reference and an accelerometer are used where the logs have them.

    Args:
        logs: one or several, of one car with the same sensors.
        car: the start.
        name, source: of the car that is returned.
        fixed: parameters that stay as they are.

    Raises:
        VehicleError: a column that is needed is missing, too little time at speed, or a car that
            hardly turns.
    """
    for column in ("road_wheel_angle_rad", YAW_RATE, "vx_mps"):
        if not all(log.has(column) for log in logs):
            raise VehicleError(f"identification needs values of {column} in every span")
    stretches = [rows for log in logs for rows in rows_of(log)]
    _require_excitation(stretches)
    start = replace(
        car,
        front_slip_stiffness_nprad=car.front_slip_stiffness_nprad or car.front_stiffness_nprad,
        rear_slip_stiffness_nprad=car.rear_slip_stiffness_nprad or car.rear_stiffness_nprad,
    )
    space = Space(start, tuple(p for p in PARAMETERS if p.name not in (*fixed, *_unseen(logs))))
    worth = residual_sds(space.at(np.zeros(len(space.parameters))), stretches, fitted=False)
    units, covariance, worth = _settle(space, stretches, worth, np.zeros(len(space.parameters)))
    told = told_from_start(units, covariance)
    sds = np.sqrt(np.diag(covariance))
    kept = Space(start, tuple(itertools.compress(space.parameters, told)))
    units = np.where(told, units, 0.0)
    if told.any():
        units[told], covariance, worth = _settle(kept, stretches, worth, units[told])
        sds[told] = np.sqrt(np.diag(covariance))
    fitted, sensors = space.at(units)
    linear = _linear(fitted, sensors, stretches, worth)
    left = {
        channel: float(np.sqrt(np.mean(values**2)))
        for channel, values in residuals(space.at(units), stretches).items()
    }
    return Fit(
        replace(linear, name=name, source=source),
        sensors,
        tuple(_fitted(space, units, sds, told)),
        left,
        sum(len(log) for log in logs),
    )


def _settle(
    space: Space, stretches: Sequence[Rows], worth: dict[str, Floats], units: Floats
) -> tuple[Floats, Floats, dict[str, Floats]]:
    """Units `(n,)`, their covariance `(n, n)`, and what a residual is worth there."""
    for _ in range(_PASSES_MOST):
        before = units
        units, jacobian = _solve(space, stretches, worth, units)
        worth = residual_sds(space.at(units), stretches)
        if np.abs(units - before).max() < _SETTLED:
            break
    information = jacobian.T @ jacobian + np.eye(len(units))
    return units, np.asarray(np.linalg.inv(information), dtype=np.float64), worth


def _linear(car: Car, sensors: Sensors, stretches: Sequence[Rows], worth: dict[str, Floats]) -> Car:
    """The car with the stiffness of linear tyres that do best on the same rows, all else as it is.

    Linear models take a mean slope of the tyres' curve over the driving that they are used for,
    slides and all, where no reference helps them.
    """
    alike = {channel: np.full(len(sd), np.median(sd)) for channel, sd in worth.items() if len(sd)}
    straight = replace(
        car,
        front_slip_stiffness_nprad=0.0,
        rear_slip_stiffness_nprad=0.0,
        front_friction=_NO_LIMIT,
        rear_friction=_NO_LIMIT,
    )
    space = Space(straight, LINEAR_PARAMETERS, sensors)
    units, _ = _solve(space, stretches, alike, np.zeros(2), hear_reference=False)
    found, _ = space.at(units)
    return replace(
        car,
        front_stiffness_nprad=found.front_stiffness_nprad,
        rear_stiffness_nprad=found.rear_stiffness_nprad,
    )


def prediction_errors(fit: tuple[Car, Sensors], logs: Sequence[SignalLog]) -> dict[str, float]:
    """Root mean square prediction error of a car on logs, by channel that they have.

    The side-slip reference is not heard: so an estimator without one would do.
    """
    stretches = [rows for log in logs for rows in rows_of(log)]
    return {
        channel: float(np.sqrt(np.mean(values**2)))
        for channel, values in residuals(fit, stretches, hear_reference=False).items()
        if len(values)
    }


def _require_excitation(stretches: Sequence[Rows]) -> None:
    fast = [rows.speed_mps > SPEED_MPS for rows in stretches]
    seconds = sum(
        float(np.sum(keep) * np.median(np.diff(rows.stamp_s)))
        for rows, keep in zip(stretches, fast, strict=True)
    )
    if seconds < _LEAST_S:
        raise VehicleError(
            f"identification has {seconds:.1f} s above {SPEED_MPS:g} m/s without gaps, "
            f"{_LEAST_S:g} s at least are needed; choose a longer span"
        )
    turns = np.concatenate(
        [rows.yaw_rate_radps[keep] for rows, keep in zip(stretches, fast, strict=True)]
    )
    if np.ptp(turns) < _LEAST_TURN_RADPS:
        raise VehicleError("identification: the car hardly turns on this span; choose another")


def _unseen(logs: Sequence[SignalLog]) -> tuple[str, ...]:
    """Parameters of sensors that no log has."""
    unseen: tuple[str, ...] = ()
    if not any(log.has(SIDESLIP) for log in logs):
        unseen += OF_REFERENCE
    if not any(log.has(LATERAL) for log in logs):
        unseen += OF_ACCELEROMETER
    return unseen


def _solve(
    space: Space,
    stretches: Sequence[Rows],
    worth: dict[str, Floats],
    start: Floats,
    *,
    hear_reference: bool = True,
) -> tuple[Floats, Floats]:
    """Units at the optimum, and the Jacobian of the data's residuals there, robustly weighed."""

    def data(units: Floats) -> Floats:
        parts = residuals(space.at(units), stretches, hear_reference=hear_reference)
        whole = np.concatenate([parts[channel] / worth[channel] for channel in worth])
        # pseudo-Huber: its square is the loss, so that the prior beside it stays Gaussian
        return np.asarray(np.sign(whole) * np.sqrt(2.0 * (np.sqrt(1.0 + whole**2) - 1.0)))

    low, high = space.bounds()

    def slopes(units: Floats) -> Floats:
        here = data(units)
        columns = []
        for index in range(len(units)):
            step = 0.02 if units[index] + 0.02 < high[index] else -0.02
            moved = units.copy()
            moved[index] += step
            columns.append((data(moved) - here) / step)
        return np.column_stack(columns)

    def residual(units: Floats) -> Floats:
        return np.concatenate([data(units), units])

    def jacobian(units: Floats) -> Floats:
        return np.vstack([slopes(units), np.eye(len(units))])

    found = scipy.optimize.least_squares(
        residual, np.clip(start, low, high), jac=jacobian, bounds=(low, high),
        xtol=1e-4, ftol=1e-5, max_nfev=25,
    )  # fmt: skip
    return np.asarray(found.x), np.asarray(found.jac)[: -len(start)]


def _fitted(space: Space, units: Floats, sds: Floats, told: NDArray[np.bool_]) -> list[Fitted]:
    low, high = space.bounds()
    found = []
    for index, parameter in enumerate(space.parameters):
        u = float(units[index])
        natural = parameter.name in ("front_drive_share",)
        at_bound = min(u - low[index], high[index] - u) < _AT_BOUND and not natural
        found.append(
            Fitted(
                parameter.name,
                space.value(index, u),
                space.sd(index, u, float(sds[index])),
                space.value(index, 0.0),
                space.sd(index, 0.0, 1.0),
                bool(at_bound),
                bool(not told[index] or sds[index] > _OPEN_SHARE),
            )
        )
    return found
