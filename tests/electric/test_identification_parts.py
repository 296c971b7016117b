"""What a residual is worth, what stays at its start, and what a prediction hears."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from polemap.electric.identification.parameters import Sensors
from polemap.electric.identification.prediction import predict_rows, rows_of
from polemap.electric.identification.residuals import SIDESLIP, residual_sds
from polemap.electric.identification.selection import told_from_start
from polemap.electric.identification.unmodelled import unmodelled_sds
from polemap.vehicle.io import load_car
from tests.electric.driven import driven

CAR = replace(load_car("passat"), front_friction=0.9, rear_friction=0.9)


def test_alone_what_stands_two_deviations_off_is_told() -> None:
    told = told_from_start(np.array([1.9, 2.1, -5.0, 0.0]), np.eye(4))
    assert told.tolist() == [False, True, True, False]


def test_of_two_that_are_told_only_together_one_answers_for_both() -> None:
    # their sum is known to 0.01 and their difference hardly: neither alone is two deviations off
    across = np.array([[1.0, -0.999], [-0.999, 1.0]])
    units = np.array([1.2, 0.8])
    assert (np.abs(units) < 2.0 * np.sqrt(np.diag(across))).all()
    assert told_from_start(units, across).sum() == 1
    assert not told_from_start(np.zeros(2), across).any()


def test_elimination_agrees_with_a_fit_without_what_was_eliminated() -> None:
    """The oracle: linear least squares about a prior, with and without a column."""
    rng = np.random.default_rng(0)
    design = rng.standard_normal((60, 3)) @ np.array([[1.0, 0.9, 0.0], [0, 0.3, 0.0], [0, 0, 1.0]])
    seen = design @ np.array([0.6, 0.0, 0.05]) + rng.standard_normal(60)
    information = design.T @ design + np.eye(3)
    covariance = np.linalg.inv(information)
    units = covariance @ design.T @ seen
    told = told_from_start(units, covariance)
    kept = design[:, told]
    again = np.linalg.inv(kept.T @ kept + np.eye(told.sum()))
    assert (np.abs(again @ kept.T @ seen) >= 2.0 * np.sqrt(np.diag(again))).all()


def test_a_slide_tells_less_of_the_side_slip_than_a_bend_with_grip() -> None:
    sds = {}
    for name, lateral_mps2 in (("grip", 3.0), ("slide", 8.0)):
        (rows,) = rows_of(driven(CAR, 20.0, lateral_mps2=lateral_mps2))
        told = predict_rows(CAR, Sensors(), rows)
        found = unmodelled_sds(CAR, rows, told, reference_heard=True)
        assert all((values > 0.0).all() for values in found.values())
        sds[name] = np.percentile(found["sideslip_rad"], 95)
    assert sds["slide"] > 3.0 * sds["grip"]


def test_an_error_that_the_tyres_hold_is_the_one_that_is_told() -> None:
    """The oracle: the same rows with tyres of less force, but for what the gyro hears of it."""
    (rows,) = rows_of(driven(CAR, 20.0, lateral_mps2=3.0))
    told = predict_rows(CAR, Sensors(), rows, hear_reference=False)
    weaker = replace(
        CAR,
        front_stiffness_nprad=0.9 * CAR.front_stiffness_nprad,
        rear_stiffness_nprad=0.9 * CAR.rear_stiffness_nprad,
    )
    off = predict_rows(weaker, Sensors(), rows, hear_reference=False).sideslip_rad
    size = np.sqrt(np.mean((off - told.sideslip_rad) ** 2))
    sds = unmodelled_sds(CAR, rows, told, reference_heard=False)["sideslip_rad"]
    assert 0.3 * size < np.sqrt(np.mean(sds**2)) < 5.0 * size


def test_a_prediction_that_hears_the_reference_does_not_spin_where_the_car_did_not() -> None:
    (rows,) = rows_of(driven(CAR, 20.0, lateral_mps2=8.0))
    slippery = replace(CAR, rear_friction=0.8 * CAR.rear_friction)
    alone, heard = (
        predict_rows(slippery, Sensors(), rows, hear_reference=hear).sideslip_rad
        for hear in (False, True)
    )
    assert rows.sideslip_rad is not None
    far = np.abs(alone - rows.sideslip_rad).max()
    assert np.abs(heard - rows.sideslip_rad).max() < 0.5 * far


def test_missing_reference_values_are_not_heard_and_not_compared() -> None:
    (rows,) = rows_of(driven(CAR, 10.0))
    assert rows.sideslip_rad is not None
    holed = rows.sideslip_rad.copy()
    holed[100:400] = np.nan
    part = replace(rows, sideslip_rad=holed)
    assert np.isfinite(predict_rows(CAR, Sensors(), part).sideslip_rad).all()
    whole, less = (
        residual_sds((CAR, Sensors()), [each], fitted=fitted)[SIDESLIP]
        for each, fitted in ((rows, False), (part, True))
    )
    assert len(less) == len(whole) - 30
    assert (less > 0.0).all()


@pytest.mark.parametrize("fitted", [False, True])
def test_a_car_that_stands_is_worth_nothing_and_breaks_nothing(fitted: bool) -> None:
    (rows,) = rows_of(driven(CAR, 5.0))
    still = replace(rows, speed_mps=np.zeros_like(rows.speed_mps))
    sds = residual_sds((CAR, Sensors()), [still], fitted=fitted)
    assert all(len(values) == 0 for values in sds.values())
