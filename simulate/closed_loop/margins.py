"""Gain and phase margins of the body-slip loop, by python-control and with the estimator in it."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from math import inf, log10, pi
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polemap.electric.control.body_slip import PiGains
from polemap.electric.estimators.base import CAMERA, YAW_RATE, Inputs
from polemap.extras import need
from polemap.simulate.closed_loop.choice import CAMERA_NOISE, fresh
from polemap.vehicle.discretize import zero_order_hold
from polemap.vehicle.errors import VehicleError
from polemap.vehicle.parameters import Car
from polemap.vehicle.single_track import combined_vision, lateral

Floats = NDArray[np.float64]
SLOW_S, FAST_S = 0.033, 0.001


@dataclass(frozen=True, slots=True)
class Margins:
    """Of one loop; `gain_hz` is the frequency of the phase crossover."""

    gain_db: float
    phase_deg: float
    gain_hz: float


def loop_margins(
    car: Car, speed_mps: float, gains: PiGains, period_s: float, lag_s: float = 0.0
) -> Margins:
    """Margins of PI and plant, sampled and held every `period_s`; the side-slip is known.

    The plant is the single-track model from yaw moment to side-slip, behind motors of first-order
    lag. A Kalman filter that hears every command changes nothing here: what it adds to the loop
    cancels (separation).
    """
    loop = open_loop(car, speed_mps, gains, period_s, lag_s)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # about the accuracy of polynomial roots: tests check it
        gain, phase, at_phase, _ = need("control").margin(loop)
    return Margins(
        20.0 * log10(gain) if np.isfinite(gain) else inf,
        float(phase),
        float(at_phase) / (2.0 * pi),
    )


def open_loop(
    car: Car, speed_mps: float, gains: PiGains, period_s: float, lag_s: float = 0.0
) -> Any:
    """The loop that `loop_margins` looks at, as a discrete transfer function of control."""
    control = need("control")
    a, b = lateral(car, speed_mps)
    if lag_s > 0.0:
        a = np.block([[a, b[:, 1:]], [np.zeros((1, 2)), np.array([[-1.0 / lag_s]])]])
        b = np.array([[0.0], [0.0], [1.0 / lag_s]])
    else:
        b = b[:, 1:]
    row = np.eye(1, len(a))
    plant = control.sample_system(control.ss(a, b, row, 0.0), period_s, method="zoh")
    integral = gains.integral_nm_per_rads * period_s
    # the integral takes the newest error in, as the controller does
    pi_law = control.tf(
        [gains.proportional_nm_per_rad + integral, -gains.proportional_nm_per_rad],
        [1.0, -1.0],
        period_s,
    )
    return pi_law * control.ss2tf(plant)


def frequency_response(loop: Any, frequencies_hz: Floats) -> NDArray[np.complex128]:
    """The open loop `(n,)` at frequencies below its Nyquist frequency."""
    turn = np.exp(2j * np.pi * np.asarray(frequencies_hz) * loop.dt)
    return np.asarray(loop(turn), dtype=np.complex128)


def scaled(gains: PiGains, factor: float) -> PiGains:
    """The controller with all its gain times a factor."""
    return PiGains(factor * gains.proportional_nm_per_rad, factor * gains.integral_nm_per_rads)


def gains_for_margin(
    car: Car, speed_mps: float, gains: PiGains, period_s: float, lag_s: float, margin_db: float
) -> PiGains:
    """The controller scaled to a gain margin."""
    found = loop_margins(car, speed_mps, gains, period_s, lag_s).gain_db
    return scaled(gains, 10.0 ** ((found - margin_db) / 20.0))


def margin_with_estimator_db(
    name: str,
    car: Car,
    speed_mps: float,
    gains: PiGains,
    *,
    period_s: float = FAST_S,
    duration_s: float = 3.0,
) -> float:
    """Gain margin at the actuator with the running estimator in the loop, to 0.05 dB.

    The plant answers k times as strongly as the estimator is told, k is bisected to where the
    loop no longer decays. Nothing is linearised: the estimator of a camera filter is stepped as
    on a car, pictures late, and its gains vary over a frame.

    Raises:
        VehicleError: the loop is unstable as it is.
    """
    low, high = 0.0, 80.0
    if not _decays(name, car, speed_mps, gains, 1.0, period_s, duration_s):
        raise VehicleError(f"the loop behind {name} is unstable as it is, it has no margin")
    while high - low > 0.05:
        middle = 0.5 * (low + high)
        k = 10.0 ** (middle / 20.0)
        if _decays(name, car, speed_mps, gains, k, period_s, duration_s):
            low = middle
        else:
            high = middle
    return 0.5 * (low + high)


def _decays(
    name: str,
    car: Car,
    speed_mps: float,
    gains: PiGains,
    strength: float,
    period_s: float,
    duration_s: float,
) -> bool:
    """Whether a side-slip dies out, with a plant of this strength behind the actuator."""
    g, h = zero_order_hold(*combined_vision(car, speed_mps), FAST_S)
    estimator = fresh(name, car, CAMERA_NOISE)
    frame = round(CAMERA_NOISE.camera_period_s / FAST_S)
    every = max(1, round(period_s / FAST_S))
    x, integral, moment = np.array([0.01, 0.0, 0.0, 0.0]), 0.0, 0.0
    picture: tuple[float, float] | None = None
    n = round(duration_s / FAST_S)
    size = np.zeros(n)
    for k in range(n):
        stamp = k * FAST_S
        estimator.step(stamp, Inputs(0.0, speed_mps, moment))
        estimator.measure(YAW_RATE, float(x[1]), stamp, stamp)
        if k % frame == 0:
            if picture is not None:
                estimator.measure(CAMERA, picture, stamp - frame * FAST_S, stamp)
            estimator.capture(CAMERA, stamp)
            picture = (float(x[2]), float(x[3]))
        if k % every == 0:
            error = -estimator.estimate().value("sideslip_rad")
            integral += gains.integral_nm_per_rads * error * period_s
            moment = gains.proportional_nm_per_rad * error + integral
        x = g @ x + h[:, 1] * (strength * moment)
        size[k] = abs(x[0]) + 0.1 * abs(x[1])
        if size[k] > 1e3:
            return False
    third = n // 3
    return bool(size[2 * third :].max() < 0.9 * size[third : 2 * third].max())
