"""Slip control on the wet sheet, against what theory says of a wrong velocity."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from polemap.simulate.closed_loop.cars import plant_of
from polemap.simulate.closed_loop.slip import (
    SheetScene,
    SlipRun,
    Velocity,
    biased,
    gps_held,
    held_slip,
    run_sheet,
    with_lag,
)
from polemap.vehicle.io import load_car

PARAMETERS, SCENE = plant_of(load_car("coms")), SheetScene(length_m=4.0)


def run(velocity: Velocity | None, scene: SheetScene = SCENE, lag_s: float = 0.005) -> SlipRun:
    return run_sheet(
        with_lag(PARAMETERS, lag_s), scene, velocity=velocity, rng=np.random.default_rng(1)
    )


def test_without_control_the_wheel_spins_and_with_it_the_slip_is_held() -> None:
    assert run(None).peak() >= 0.6
    held = run(biased(0.0))
    assert held.mean() == pytest.approx(0.1, abs=0.005)
    assert held.peak() <= 0.12
    assert held.settled_s(0.1) <= 0.1


@pytest.mark.parametrize("error", [-0.05, 0.05])
def test_a_wrong_velocity_becomes_the_slip_that_theory_says(error: float) -> None:
    # 0.053 and 0.143: no gain of the controller is in the formula
    assert run(biased(error)).mean() == pytest.approx(held_slip(0.1, error), abs=0.002)


@pytest.mark.parametrize("friction", [0.1, 0.3])
def test_friction_does_not_matter_as_long_as_the_motor_can_break_the_grip(friction: float) -> None:
    held = run(biased(0.0), replace(SCENE, sheet_friction=friction, driver_torque_nm=100.0))
    assert held.mean() == pytest.approx(0.1, abs=0.005)
    assert held.peak() <= 0.12


def test_where_the_ground_carries_the_torque_the_driver_has_it_all() -> None:
    gripping = run(biased(0.0), replace(SCENE, sheet_friction=0.5, driver_torque_nm=100.0))
    assert gripping.peak() < 0.1
    assert gripping.torque_nm[gripping.on_sheet].min() == pytest.approx(100.0, abs=0.1)


def test_slow_motors_overshoot_and_still_settle() -> None:
    slow = run(biased(0.0), lag_s=0.02)
    assert 0.11 < slow.peak() < 0.14
    assert slow.mean() == pytest.approx(0.1, abs=0.005)


def test_a_late_held_gps_speed_misses_the_slip() -> None:
    # the car gains speed while the value is old: the controller sees more slip than there is
    assert run(gps_held()).mean() < 0.09
