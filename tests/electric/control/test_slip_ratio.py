"""Driving-force observer and slip-ratio control on a one-wheel model of their own."""

from __future__ import annotations

import numpy as np
import pytest

from polemap.electric.control.slip_ratio import (
    DrivingForceObserver,
    SlipRatioController,
    SlipRatioSettings,
)
from polemap.vehicle.errors import VehicleError

INERTIA, RADIUS, MASS = 0.5, 0.22, 190.0


def test_observer_finds_the_force_of_a_known_motion() -> None:
    observer = DrivingForceObserver(INERTIA, RADIUS, 200.0)
    wheel, force = 10.0, 0.0
    for k in range(2000):
        torque = 40.0 + 20.0 * np.sin(2 * np.pi * 2.0 * k * 1e-3)
        true = 0.7 * torque / RADIUS
        wheel += 1e-3 * (torque - RADIUS * true) / INERTIA
        force = observer.step(torque, wheel, 1e-3)
        if k > 100:
            # a 200 rad/s low-pass is 5 ms late: 2 Hz of 64 N amplitude lags by about 4 N
            assert force == pytest.approx(true, abs=6.0)


def _one_wheel(controlled: bool, friction: float, speed_error: float = 1.0) -> np.ndarray:
    """Slip over 1.5 s of a wheel with a linear-saturated tyre that meets ice after 0.3 s."""
    controller = SlipRatioController(INERTIA, RADIUS, SlipRatioSettings())
    speed, wheel, torque, slips = 3.0, 3.0 / RADIUS, 0.0, []
    for k in range(1500):
        limit = (0.8 if k < 300 else friction) * MASS * 9.81
        slip = (RADIUS * wheel - speed) / (RADIUS * wheel)
        force = float(np.clip(9000.0 * slip, -limit, limit))
        wheel += 1e-3 * (torque - RADIUS * force) / INERTIA
        speed += 1e-3 * force / MASS
        torque = (
            controller.step(70.0, torque, wheel, speed * speed_error, 1e-3) if controlled else 70.0
        )
        slips.append(slip)
    return np.array(slips)


def test_without_control_the_wheel_spins_and_with_it_the_slip_holds_its_target() -> None:
    assert _one_wheel(False, 0.1).max() > 0.6
    held = _one_wheel(True, 0.1)
    assert held.max() <= 0.12
    assert held[450:].mean() == pytest.approx(0.1, abs=0.005)


def test_grip_leaves_the_torque_to_the_driver() -> None:
    controller = SlipRatioController(INERTIA, RADIUS)
    assert controller.step(50.0, 50.0, 3.06 / RADIUS, 3.0, 1e-3) == 50.0


def test_never_exceeds_the_driver_nor_brakes_for_him() -> None:
    controller = SlipRatioController(INERTIA, RADIUS)
    for slip in (0.05, 0.2, 0.5, 0.9):
        wheel = 3.0 / RADIUS / (1.0 - slip)
        assert 0.0 <= controller.step(30.0, 30.0, wheel, 3.0, 1e-3) <= 30.0


def test_refuses_a_wheel_without_inertia() -> None:
    with pytest.raises(VehicleError, match="inertia, radius and cut-off"):
        DrivingForceObserver(0.0, RADIUS, 200.0)


def test_a_target_that_moves_is_followed_with_its_rate_and_lagged_behind_without() -> None:
    """S' = -L S - Q sat(S / phi) holds for a moving target only with lambda*' in the law."""
    errors = []
    for told in (True, False):
        controller = SlipRatioController(INERTIA, RADIUS, SlipRatioSettings())
        speed, wheel, torque, off = 3.0, 3.0 / RADIUS, 0.0, []
        for k in range(1500):
            stamp = 1e-3 * k
            target = 0.1 + 0.03 * np.sin(2 * np.pi * 2.0 * stamp)
            rate = 0.03 * 2 * np.pi * 2.0 * np.cos(2 * np.pi * 2.0 * stamp)
            slip = (RADIUS * wheel - speed) / (RADIUS * wheel)
            force = float(np.clip(9000.0 * slip, 0.0, 0.1 * MASS * 9.81))
            wheel += 1e-3 * (torque - RADIUS * force) / INERTIA
            speed += 1e-3 * force / MASS
            torque = controller.step(
                70.0, torque, wheel, speed, 1e-3, target, rate if told else 0.0
            )
            off.append(slip - target)
        errors.append(float(np.sqrt(np.mean(np.square(off[600:])))))
    assert errors[0] < 0.3 * errors[1]
