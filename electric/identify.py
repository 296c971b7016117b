"""Fit what is not known of a car to a log that has a side-slip reference."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from polemap.electric.signals import SignalLog
from polemap.vehicle.discretize import zero_order_hold_series
from polemap.vehicle.errors import VehicleError
from polemap.vehicle.motion import sideslip_at
from polemap.vehicle.parameters import Car
from polemap.vehicle.single_track import KINEMATIC_SPEED_MPS, lateral_on_tyres

Floats = NDArray[np.float64]

SIDESLIP_SCALE_RAD, YAW_RATE_SCALE_RADPS = 0.005, 0.02
_LONGEST_STEP_S = 0.05
_LEAST_ROWS = 500


@dataclass(frozen=True, slots=True)
class Fit:
    """A car with fitted parameters, and what is left over on the span that it was fitted to."""

    car: Car
    sideslip_rmse_rad: float
    yaw_rate_rmse_radps: float
    rows: int


def identify(log: SignalLog, car: Car, *, name: str, source: str) -> Fit:
    """Fit tyre stiffness, yaw inertia, steering offset and the reference's place.

    Mass, wheelbase and weight split stay as they are in `car`: steering and side-slip see
    stiffness and inertia only in proportion to the mass, and the split only together with the
    reference's place. The model runs freely from steering and speed over the whole log (output
    error), so that noise of the measured states does not bias the fit; a robust loss bears wild
    values.

    Raises:
        VehicleError: a column that is needed is missing, too few rows, or a car that hardly turns.
    """
    for column in ("road_wheel_angle_rad", "yaw_rate_radps", "vx_mps", "sideslip_rad"):
        if not log.has(column):
            raise VehicleError(f"identification needs the column {column}")
    speed = log.held("vx_mps")
    if len(log) < _LEAST_ROWS:
        raise VehicleError(f"identification has {len(log)} rows, {_LEAST_ROWS} at least are needed")
    if np.ptp(log.held("yaw_rate_radps")) < 0.1:
        raise VehicleError("identification: the car hardly turns on this span; choose another")
    steering, period = log.held("road_wheel_angle_rad"), np.diff(log.stamp_s, append=np.nan)
    period[-1] = period[-2]
    if period.max() > _LONGEST_STEP_S:
        raise VehicleError(
            f"identification: a gap of {period.max():.3f} s in the log; {_LONGEST_STEP_S} s at most"
        )
    seen = np.column_stack([log.columns["sideslip_rad"], log.columns["yaw_rate_radps"]])
    moving = (speed > 2.0 * KINEMATIC_SPEED_MPS)[:, None] & np.isfinite(seen)
    scales = np.array([SIDESLIP_SCALE_RAD, YAW_RATE_SCALE_RADPS])

    def answer(x: Floats) -> Floats:
        trial = _with(car, x)
        states = simulate(trial, steering - trial.steering_offset_rad, speed, period)
        v = np.maximum(speed, 1.0)
        beta = sideslip_at(states[:, 0], states[:, 1], v, trial.sideslip_point_m)
        return np.column_stack([beta, states[:, 1]])

    def residual(x: Floats) -> Floats:
        return np.asarray(((answer(x) - seen) / scales)[moving])

    lower, upper = [-2.0, -2.0, -1.0, -0.05, -2.0], [2.0, 2.0, 1.0, 0.05, 2.0]
    found = least_squares(
        residual, np.zeros(5), bounds=(lower, upper), loss="soft_l1", x_scale=[1, 1, 1, 0.01, 1]
    )
    fitted = replace(_with(car, found.x), name=name, source=source)
    errors = np.where(moving, answer(found.x) - seen, np.nan)
    left = np.sqrt(np.nanmean(errors**2, axis=0))
    return Fit(fitted, float(left[0]), float(left[1]), len(log))


def _with(car: Car, x: Floats) -> Car:
    """The car with log scales of Cf, Cr and the inertia, and two offsets."""
    return replace(
        car,
        front_stiffness_nprad=float(car.front_stiffness_nprad * np.exp(x[0])),
        rear_stiffness_nprad=float(car.rear_stiffness_nprad * np.exp(x[1])),
        yaw_inertia_kgm2=float(car.yaw_inertia_kgm2 * np.exp(x[2])),
        steering_offset_rad=float(x[3]),
        sideslip_point_m=float(x[4]),
    )


def simulate(car: Car, steering_rad: Floats, speed_mps: Floats, period_s: Floats) -> Floats:
    """The single-track model's own answer `(n, 2)` of side-slip and yaw rate, from rest.

    All steps are made discrete at once.
    """
    a, b = lateral_on_tyres(car, np.maximum(speed_mps, KINEMATIC_SPEED_MPS))
    g, h = zero_order_hold_series(a, b[..., :1], period_s)
    pushed = h[:, :, 0] * steering_rad[:, None]
    n = len(g)
    out = np.zeros((n, 2))
    beta = gamma = 0.0
    rows = zip(*g.reshape(n, 4).T.tolist(), *pushed.T.tolist(), strict=True)
    for k, (g00, g01, g10, g11, h0, h1) in enumerate(rows):
        out[k] = beta, gamma
        beta, gamma = g00 * beta + g01 * gamma + h0, g10 * beta + g11 * gamma + h1
    return out
