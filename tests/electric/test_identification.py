"""What a fit finds of a car that is known, what it leaves open, and what it says of both."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from polemap.electric.identification.fit import Fit, identify, prediction_errors
from polemap.electric.identification.parameters import PARAMETERS, Sensors, Space
from polemap.electric.signals import SignalLog, shifted
from polemap.vehicle.errors import VehicleError
from polemap.vehicle.io import load_car
from polemap.vehicle.parameters import Car
from tests.electric.driven import driven

START = load_car("passat")
TRUTH = replace(
    START,
    front_slip_stiffness_nprad=0.75 * START.front_stiffness_nprad,
    rear_slip_stiffness_nprad=1.2 * START.rear_stiffness_nprad,
    front_friction=0.9,
    rear_friction=1.05,
    yaw_inertia_kgm2=1.1 * START.yaw_inertia_kgm2,
    steering_offset_rad=0.004,
    sideslip_point_m=0.5,
)


@pytest.fixture(scope="module")
def whole() -> Fit:
    return identify([driven(TRUTH, 40.0)], START, name="found", source="a test")


def found(fit: Fit, name: str) -> tuple[float, float]:
    parameter = next(p for p in fit.parameters if p.name == name)
    return parameter.value, parameter.sd


@pytest.mark.parametrize(
    ("name", "share"),
    [
        ("front_slip_stiffness_nprad", 0.08),
        ("rear_slip_stiffness_nprad", 0.08),
        ("front_friction", 0.06),
        ("rear_friction", 0.1),
        ("yaw_inertia_kgm2", 0.1),
    ],
)
def test_the_cars_own_parameters_are_found(whole: Fit, name: str, share: float) -> None:
    value, sd = found(whole, name)
    truth = getattr(TRUTH, name)
    assert value == pytest.approx(truth, rel=share)
    assert abs(value - truth) < 4.0 * sd
    assert getattr(whole.car, name) == value


def test_offsets_are_found_and_linear_tyres_are_softer_than_the_brush(whole: Fit) -> None:
    assert found(whole, "steering_offset_rad")[0] == pytest.approx(0.004, abs=5e-4)
    assert found(whole, "sideslip_point_m")[0] == pytest.approx(0.5, abs=0.1)
    car = whole.car
    assert 0.4 < car.front_stiffness_nprad / car.front_slip_stiffness_nprad < 1.0
    assert car.name == "found"
    assert not any(p.at_bound for p in whole.parameters)


def test_the_fit_predicts_what_it_never_saw_better_than_the_start(whole: Fit) -> None:
    other = [driven(TRUTH, 20.0, seed=5, lateral_mps2=5.0)]
    ours = prediction_errors((whole.car, whole.sensors), other)
    start = prediction_errors((START, Sensors()), other)
    assert ours["sideslip_rad"] < 0.3 * start["sideslip_rad"]
    assert ours["sideslip_rad"] < 0.002


def test_each_columns_delay_is_found() -> None:
    """Steering that acts 30 ms later, speed, accelerometer and reference that lag the gyro."""
    log = driven(TRUTH, 25.0, seed=3, ay_sd_mps2=0.1)
    late = {"vx_mps": 0.08, "ay_mps2": 0.05, "sideslip_rad": 0.06, "road_wheel_angle_rad": -0.03}
    columns = {
        name: shifted(log.stamp_s, values, late.get(name, 0.0))
        for name, values in log.columns.items()
    }
    fit = identify([SignalLog(log.stamp_s, columns)], START, name="x", source="y")
    for name, true in (
        ("steering_delay_s", 0.03), ("ay_delay_s", 0.05), ("sideslip_delay_s", 0.06),
    ):  # fmt: skip
        value, sd = found(fit, name)
        assert value == pytest.approx(true, abs=0.012), name
        assert sd < 0.01, name
    assert fit.car.steering_delay_s == found(fit, "steering_delay_s")[0]
    assert fit.sensors.ay_delay_s == found(fit, "ay_delay_s")[0]


def test_no_reference_is_needed() -> None:
    log = driven(TRUTH, 40.0, seed=1)
    columns = {k: v for k, v in log.columns.items() if k != "sideslip_rad"}
    fit = identify([SignalLog(log.stamp_s, columns)], START, name="x", source="y")
    assert found(fit, "front_slip_stiffness_nprad")[0] == pytest.approx(
        TRUTH.front_slip_stiffness_nprad, rel=0.2
    )
    names = {p.name for p in fit.parameters}
    assert not names & {"sideslip_point_m", "sideslip_offset_rad"}
    assert "sideslip_rad" not in fit.left


def test_gentle_driving_leaves_friction_open_and_where_it_was() -> None:
    fit = identify([driven(TRUTH, 20.0, lateral_mps2=1.5)], START, name="x", source="y")
    friction = [p for p in fit.parameters if p.name.endswith("_friction")]
    assert all(p.open for p in friction)
    assert all(abs(p.value - p.start) < 2.0 * p.prior_sd for p in friction)
    assert whole_is_finite(fit)


def whole_is_finite(fit: Fit) -> bool:
    return all(np.isfinite([p.value, p.sd]).all() for p in fit.parameters)


def test_a_start_that_is_far_off_ends_at_a_bound_and_says_so() -> None:
    far = replace(START, front_stiffness_nprad=10.0 * START.front_stiffness_nprad)
    fit = identify([driven(TRUTH, 15.0)], far, name="x", source="y")
    assert any(p.at_bound for p in fit.parameters)


def test_several_logs_say_more_than_one() -> None:
    one = identify([driven(TRUTH, 10.0)], START, name="x", source="y")
    two = identify([driven(TRUTH, 10.0), driven(TRUTH, 10.0, seed=3)], START, name="x", source="y")
    assert two.rows == 2 * one.rows
    assert found(two, "front_slip_stiffness_nprad")[1] < found(one, "front_slip_stiffness_nprad")[1]


def test_a_gap_is_no_drive() -> None:
    log = driven(TRUTH, 20.0)
    keep = (log.stamp_s < 8.0) | (log.stamp_s > 12.0)
    with_gap = SignalLog(log.stamp_s[keep], {k: v[keep] for k, v in log.columns.items()})
    fit = identify([with_gap], START, name="x", source="y")
    assert fit.left["sideslip_rad"] < 0.004


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda c: {**c, "yaw_rate_radps": 0.001 * c["yaw_rate_radps"]}, "hardly turns"),
        (lambda c: {**c, "vx_mps": 0.01 * c["vx_mps"]}, "above 3 m/s"),
        (lambda c: {k: v for k, v in c.items() if k != "vx_mps"}, "needs values of vx_mps"),
    ],
)
def test_what_cannot_tell_is_refused(change: object, message: str) -> None:
    log = driven(TRUTH, 6.0)
    with pytest.raises(VehicleError, match=message):
        identify([SignalLog(log.stamp_s, change(log.columns))], START, name="x", source="y")  # type: ignore[operator]


def test_units_and_values_belong_together() -> None:
    space = Space(
        replace(START, front_slip_stiffness_nprad=1e5, rear_slip_stiffness_nprad=1e5), PARAMETERS
    )
    low, high = space.bounds()
    assert (low < 0.0).all()
    assert (high > 0.0).all()
    car, sensors = space.at(np.zeros(len(PARAMETERS)))
    assert isinstance(car, Car)
    assert sensors == Sensors()
    for end in (low, high):
        space.at(end)  # every corner is a car
