"""Deviations of single GPS fixes: from dilution, satellites, speed and the courses' baselines."""

from __future__ import annotations

import numpy as np
import pytest

from polemap.electric.config import EstimatorConfig
from polemap.electric.estimators.base import GPS, Inputs, fix_spread
from polemap.electric.estimators.registry import make_estimator
from polemap.electric.fix_noise import POSITION_STEP_SD_M, dilution, with_fix_noise
from polemap.electric.signals import SignalLog, play
from polemap.vehicle.errors import VehicleError
from polemap.vehicle.io import load_car

CONFIG = EstimatorConfig(step_s=0.01, course_sd_rad=0.005, speed_sd_mps=0.05)
NAN = float("nan")


def fixes(speed: list[float], **columns: list[float]) -> SignalLog:
    known = {"speed_mps": speed, "course_rad": [0.0] * len(speed), **columns}
    stamps = np.arange(float(len(speed)))
    return SignalLog(stamps, {name: np.array(values) for name, values in known.items()})


def test_hdop_counts_before_satellites_and_neither_makes_a_fix_better_than_configured() -> None:
    log = fixes([10.0] * 4, hdop=[2.0, NAN, NAN, 0.6], satellites=[12.0, 5.0, NAN, 4.0])
    np.testing.assert_allclose(dilution(log), [2.0, 2.3, 1.0, 1.0])


def test_fewer_satellites_are_never_better() -> None:
    log = fixes([10.0] * 20, satellites=[float(n) for n in range(1, 21)])
    assert (np.diff(dilution(log)) <= 0.0).all()


def test_a_course_errs_by_the_speeds_error_over_the_speed() -> None:
    log = with_fix_noise(fixes([20.0, 2.0, 0.0], hdop=[1.0, 3.0, 1.0]), CONFIG)
    np.testing.assert_allclose(log.columns["speed_sd_mps"], [0.05, 0.15, 0.05])
    np.testing.assert_allclose(log.columns["course_sd_rad"], [0.005, 0.075, 0.1])


def test_a_course_of_positions_errs_by_theirs_over_their_distance() -> None:
    log = with_fix_noise(fixes([10.0, 10.0], course_baseline_m=[2.0, NAN]), CONFIG)
    assert log.columns["course_sd_rad"][0] == pytest.approx(np.sqrt(2.0) * POSITION_STEP_SD_M / 2.0)
    assert log.columns["course_sd_rad"][1] == 0.005


@pytest.mark.parametrize(
    "columns", [{}, {"hdop": [NAN, NAN]}, {"hdop": [2.0, 2.0], "course_sd_rad": [0.1, 0.1]}]
)
def test_a_log_that_tells_nothing_or_states_them_itself_stays(
    columns: dict[str, list[float]],
) -> None:
    log = fixes([10.0, 10.0], **columns)
    assert with_fix_noise(log, CONFIG) is log


@pytest.mark.parametrize("name", ["nonlinear", "two_layer", "two_layer_reconstructed", "stiffness"])
def test_an_estimator_weighs_each_fix_by_what_it_states(name: str) -> None:
    car = load_car("passat")
    t = 0.01 * np.arange(1000)
    course = np.full(1000, NAN)
    course[::20] = 0.0
    wrong = course.copy()
    wrong[500::20] += 0.03
    moved = []
    for sd in (0.005, 0.05):
        columns = {
            "vx_mps": np.full(1000, 15.0), "yaw_rate_radps": np.zeros(1000),
            "ay_mps2": np.zeros(1000), "ax_mps2": np.zeros(1000),
            "road_wheel_angle_rad": np.zeros(1000), "course_rad": wrong,
            "speed_mps": np.where(np.isfinite(course), 15.0, NAN),
            "course_sd_rad": np.full(1000, sd), "speed_sd_mps": np.full(1000, 0.05),
        }  # fmt: skip
        played = play(make_estimator(name, car, CONFIG), SignalLog(t, columns))
        field = "heading_rad" if "heading_rad" in played.fields else "sideslip_rad"
        moved.append(float(np.abs(played.column(field)[500:519]).max()))
    assert moved[1] < 0.9 * moved[0]


def test_stated_deviations_must_be_positive() -> None:
    assert fix_spread((0.1, 10.0), 0.5, 0.6) == (0.5, 0.6)
    assert fix_spread((0.1, 10.0, 0.2, 0.3), 0.5, 0.6) == (0.2, 0.3)
    estimator = make_estimator("nonlinear", load_car("passat"), CONFIG)
    estimator.step(0.0, Inputs(0.0, 10.0))
    estimator.capture(GPS, 0.0)
    with pytest.raises(VehicleError, match="deviations of course and speed must be positive"):
        estimator.measure(GPS, (0.1, 10.0, -0.2, 0.3), 0.0, 0.0)
