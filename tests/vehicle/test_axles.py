"""Axle forces: the plant's tyre as oracle, slopes by differences, loads, friction ellipse."""

from __future__ import annotations

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from polemap.vehicle.axles import GRAVITY_MPS2, LOAD_GROWTH, Axles
from polemap.vehicle.errors import VehicleError
from polemap.vehicle.io import load_car
from polemap.vehicle.tyre import brush_force, brush_lateral

CAR = replace(load_car("passat"), front_friction=0.9, rear_friction=1.1, cg_height_m=0.6)


@given(st.floats(-0.5, 0.5), st.floats(1e4, 3e5), st.floats(500.0, 2e4))
def test_lateral_brush_is_the_plants_without_slip_along(
    slip: float, stiffness: float, limit: float
) -> None:
    force, slope = brush_lateral(slip, stiffness, limit)
    _, across = brush_force(0.0, slip, stiffness, stiffness, limit)
    assert force == pytest.approx(across, rel=1e-9, abs=1e-6)
    assert slope <= 0.0
    h = 1e-7
    ahead, behind = (brush_lateral(slip + d, stiffness, limit)[0] for d in (h, -h))
    assert slope == pytest.approx((ahead - behind) / (2 * h), abs=2e-3 * stiffness)


def test_braking_moves_load_and_uses_up_friction() -> None:
    axles, weight = Axles(CAR), CAR.mass_kg * GRAVITY_MPS2
    front_c, front, rear_c, rear = axles.limits(0.0)
    share = CAR.cg_to_rear_m / CAR.wheelbase_m
    assert front == pytest.approx(0.9 * weight * share)
    assert rear == pytest.approx(1.1 * weight * (1.0 - share))
    assert (front_c, rear_c) == (2 * CAR.front_stiffness_nprad, 2 * CAR.rear_stiffness_nprad)
    hard_c, hard_front, soft_c, hard_rear = axles.limits(-5.0)
    moved = CAR.mass_kg * 5.0 * 0.6 / CAR.wheelbase_m
    assert hard_c / front_c == pytest.approx(1.0 + LOAD_GROWTH * moved / (weight * share))
    assert soft_c < rear_c
    brake = 0.6 * CAR.mass_kg * 5.0
    assert hard_front**2 + brake**2 == pytest.approx((0.9 * (weight * share + moved)) ** 2)
    assert 0.0 < hard_rear < rear


def test_slip_stiffness_stands_for_the_linear_one_where_it_is_given() -> None:
    stiff = replace(CAR, front_slip_stiffness_nprad=9e4)
    assert Axles(stiff).limits(0.0)[0] == 1.8e5
    assert Axles(stiff).limits(0.0)[2] == Axles(CAR).limits(0.0)[2]
    assert stiff.scaled(stiffness=2.0).front_slip_stiffness_nprad == 1.8e5


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("front_friction", 0.0),
        ("front_brake_share", 1.2),
        ("steering_scale", -1.0),
        ("steering_delay_s", 2.0),
    ],
)
def test_values_that_no_car_has_are_refused(field: str, value: float) -> None:
    with pytest.raises(VehicleError, match=field):
        replace(CAR, **{field: value})
