"""Models against closed forms, the schedule against matrix exponentials, observability."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from polemap.electric.config import EstimatorConfig
from polemap.electric.estimators.vision import ALL_ROWS, vision_density
from polemap.vehicle.discretize import zero_order_hold
from polemap.vehicle.errors import VehicleError
from polemap.vehicle.io import load_car
from polemap.vehicle.single_track import (
    KINEMATIC_SPEED_MPS,
    combined_vision,
    disturbed_course,
    gps_course,
    lateral,
    lateral_acceleration_rows,
    lateral_on_tyres,
    planar_velocity_step,
    schedule,
)

COMS = load_car("coms")
DENSITY = vision_density(EstimatorConfig())


def test_steady_state_is_the_textbook_one() -> None:
    """Yaw gain V / (L + K V^2) with K = m (lr Cr - lf Cf) / (2 Cf Cr L)."""
    c, v = COMS, 6.0
    a, b = lateral(c, v)
    gamma = np.linalg.solve(-a, b)[1, 0]
    cf, cr, length = c.front_stiffness_nprad, c.rear_stiffness_nprad, c.wheelbase_m
    understeer = c.mass_kg * (c.cg_to_rear_m * cr - c.cg_to_front_m * cf) / (2 * cf * cr * length)
    assert gamma == pytest.approx(v / (length + understeer * v * v), rel=1e-12)


def test_many_speeds_at_once_equal_one_after_the_other() -> None:
    speeds = np.array([KINEMATIC_SPEED_MPS, 4.0, 30.0])
    many = lateral_on_tyres(COMS, speeds)
    for k, speed in enumerate(speeds.tolist()):
        for array, single in zip(many, lateral(COMS, speed), strict=True):
            assert np.array_equal(array[k], single)


@given(st.floats(-2.0, 2.0), st.floats(0.0005, 0.02))
def test_the_step_of_the_velocity_is_the_hold_to_the_third_order_of_the_turn(
    rate: float, period: float
) -> None:
    c, s, ch, sh = planar_velocity_step(rate, period)
    g, h = zero_order_hold(np.array([[0.0, rate], [-rate, 0.0]]), np.eye(2), period)
    np.testing.assert_allclose([[c, s], [-s, c]], g, rtol=0, atol=1e-14)
    limit = period * (abs(rate) * period) ** 2 / 12.0 + 1e-15
    np.testing.assert_allclose([[ch, sh], [-sh, ch]], h, rtol=0, atol=limit)


def test_table_one_car_oversteers_at_the_published_speeds() -> None:
    # unstable from where det A is 0 on: 1 + K v^2 / l = 0
    critical_mps = (-COMS.wheelbase_m / COMS.understeer_s2pm) ** 0.5
    assert critical_mps * 3.6 == pytest.approx(63.3, abs=0.05)
    a, _ = lateral(COMS, critical_mps)
    assert abs(np.linalg.det(a)) < 1e-9

    def gain(v: float) -> float:
        a, b = lateral(COMS, v)
        return float(np.linalg.solve(-a, b)[0, 0])

    assert gain(20.6 / 3.6) > 0.0 > gain(20.8 / 3.6)


def test_slow_car_rolls_without_slip() -> None:
    a, b = lateral(COMS, 0.5)
    steady = np.linalg.solve(-a, b[:, 0])
    assert steady == pytest.approx([0.6 / 1.4, 0.5 / 1.4])
    below, above = lateral(COMS, np.nextafter(1.0, 0.0)), lateral(COMS, KINEMATIC_SPEED_MPS)
    left, right = (np.linalg.solve(-m[0], m[1][:, 0]) for m in (below, above))
    # the tyres' share at 1 m/s: m lf V^2 / (2 Cr L) of lr, 3 %
    assert left == pytest.approx(right, rel=0.04)


def test_lateral_acceleration_is_force_over_mass() -> None:
    v, x, u = 7.0, np.array([0.02, 0.3]), np.array([0.05, 40.0])
    row, direct = lateral_acceleration_rows(COMS, v)
    front = u[0] - x[0] - COMS.cg_to_front_m * x[1] / v
    rear = -x[0] + COMS.cg_to_rear_m * x[1] / v
    force = 2 * COMS.front_stiffness_nprad * front + 2 * COMS.rear_stiffness_nprad * rear
    assert row @ x + direct @ u == pytest.approx(force / COMS.mass_kg, rel=1e-12)


def test_schedule_error_is_small_over_all_speeds() -> None:
    table = schedule(combined_vision, COMS, DENSITY, 0.001)
    rng = np.random.default_rng(0)
    speeds = np.concatenate([rng.uniform(0.0, 1.0, 40), rng.uniform(1.0, 60.0, 120)])
    error = table.error(speeds)
    assert error["transition"] < 2e-6
    assert error["drive"] < 2e-5
    assert error["noise"] < 2e-5


@given(speed=st.floats(0.0, 120.0), period=st.sampled_from([None, 0.004, 0.033]))
def test_schedule_takes_any_speed_and_step(speed: float, period: float | None) -> None:
    g, h, q = schedule(combined_vision, COMS, DENSITY, 0.001).at(speed, period)
    assert np.isfinite(g).all()
    assert np.isfinite(h).all()
    assert np.linalg.eigvalsh(q).min() > -1e-12


def test_schedules_of_equal_models_do_not_share_buffers() -> None:
    one, two = (schedule(combined_vision, COMS, DENSITY, 0.001) for _ in range(2))
    first = one.at(5.0)[0].copy()
    two.at(20.0)
    np.testing.assert_array_equal(one.transition, first)


def observability_rank(a: np.ndarray, c: np.ndarray) -> int:
    """Rank of `[C; CA; ...; CA^(n-1)]`, rows scaled so that units do not decide."""
    rows = [np.asarray(c, dtype=np.float64)]
    for _ in range(len(a) - 1):
        rows.append(rows[-1] @ a)
    stacked = np.vstack(rows)
    norms = np.linalg.norm(stacked, axis=1, keepdims=True)
    stacked = stacked / np.where(norms > 0.0, norms, 1.0)
    return int(np.linalg.matrix_rank(stacked, tol=1e-9))


def test_observability_ranks() -> None:
    v = 7.0
    a, _ = lateral(COMS, v)
    gyro = np.array([[0.0, 1.0]])
    assert observability_rank(a, gyro) == 2
    # beta is observable from the yaw rate only if Cf lf differs from Cr lr
    from dataclasses import replace

    neutral = replace(COMS, cg_to_front_m=0.7, cg_to_rear_m=0.7)
    assert observability_rank(lateral(neutral, v)[0], gyro) == 1
    a4, _ = combined_vision(COMS, v)
    assert observability_rank(a4, ALL_ROWS) == 4
    assert observability_rank(a4, ALL_ROWS[1:]) == 4  # W13: by vision alone
    assert observability_rank(a4, ALL_ROWS[:1]) == 2
    a3, _ = gps_course(COMS, v)
    c3 = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 1.0]])
    assert observability_rank(a3, c3) == 3
    leaky, _ = disturbed_course(COMS, v, 2.0)
    c5 = np.hstack([c3, np.zeros((2, 2))])
    assert observability_rank(leaky, c5) == 5
    walk = leaky.copy()
    walk[3, 3] = walk[4, 4] = 0.0
    assert observability_rank(walk, c5) == 4
    # N13 (19) as printed: three state disturbances and two output disturbances, all walks
    printed = np.zeros((8, 8))
    printed[:3, :3], printed[:3, 3:6] = a3, np.eye(3)
    c8 = np.hstack([c3, np.zeros((2, 3)), np.eye(2)])
    assert observability_rank(printed, c8) == 5


def test_schedule_refuses_no_step() -> None:
    from polemap.vehicle.single_track import Schedule

    with pytest.raises(VehicleError, match="must be positive"):
        Schedule(combined_vision, COMS, np.diag(DENSITY), 0.0)
