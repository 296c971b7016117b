"""The estimator on brush tyres: right and honest near the limits, and with sensors that fail it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from polemap.electric.config import EstimatorConfig
from polemap.electric.estimators.base import GPS, LATERAL_ACCELERATION, YAW_RATE, Inputs
from polemap.electric.estimators.grade import GRADE_SD_RAD
from polemap.electric.estimators.nonlinear import NonlinearKalman
from polemap.electric.estimators.process_noise import BANK_SD_RAD
from polemap.electric.estimators.registry import make_estimator
from polemap.electric.io import gps_from_truth
from polemap.electric.signals import Played, SignalLog, play
from polemap.vehicle.delay import ClonedFilter
from polemap.vehicle.io import load_car
from tests.electric.driven import STEP_S, bank_of, driven, grade_of

CAR = replace(load_car("passat"), front_friction=0.95, rear_friction=1.05)
CONFIG = EstimatorConfig(step_s=STEP_S, course_sd_rad=0.005)


def with_gps(log: SignalLog, seed: int = 0) -> SignalLog:
    rng = np.random.default_rng(seed)
    return gps_from_truth(log, rng, course_sd_rad=0.005, speed_sd_mps=0.05)


def errors(played: Played, log: SignalLog) -> np.ndarray:
    return np.asarray(played.column("sideslip_rad") - log.columns["sideslip_rad"])[200:]


def test_near_the_limits_it_is_right_where_the_linear_model_is_not() -> None:
    log = driven(CAR, 40.0, lateral_mps2=7.5)
    ours = errors(play(NonlinearKalman(CAR, CONFIG), log), log)
    linear = errors(play(make_estimator("bicycle", CAR, CONFIG), log), log)
    assert np.sqrt(np.mean(ours**2)) < 0.5 * np.sqrt(np.mean(linear**2))
    assert np.degrees(np.sqrt(np.mean(ours**2))) < 0.15


@pytest.mark.parametrize("gps", [False, True])
def test_stated_deviations_hold_on_a_car_that_is_not_quite_the_models(gps: bool) -> None:
    squares = []
    for seed in range(5):
        rng = np.random.default_rng([seed, 7])
        factor = np.exp(0.08 * rng.standard_normal(4))
        true = replace(
            CAR,
            front_stiffness_nprad=CAR.front_stiffness_nprad * factor[0],
            rear_stiffness_nprad=CAR.rear_stiffness_nprad * factor[1],
            front_friction=CAR.front_friction * factor[2],
            rear_friction=CAR.rear_friction * factor[3],
        )
        log = driven(true, 30.0, seed=seed, bank_mps2=0.3 * rng.standard_normal())
        log = with_gps(log, seed) if gps else log
        played = play(NonlinearKalman(CAR, CONFIG), log)
        squares.append(np.mean((errors(played, log) / played.sd_of("sideslip_rad")[200:]) ** 2))
    assert 0.02 < np.mean(squares) < 1.5


def test_gps_takes_a_wrong_car_back() -> None:
    wrong = CAR.scaled(stiffness=0.7)
    log = driven(CAR, 30.0)
    alone = errors(play(NonlinearKalman(wrong, CONFIG), log), log)
    helped = errors(play(NonlinearKalman(wrong, CONFIG), with_gps(log)), log)
    assert np.sqrt(np.mean(helped**2)) < 0.75 * np.sqrt(np.mean(alone**2))
    assert np.degrees(np.sqrt(np.mean(helped**2))) < 0.3


def test_a_late_course_counts_at_its_capture() -> None:
    log = with_gps(driven(CAR, 20.0))
    arrival = log.columns["gnss_arrival_s"]
    early = SignalLog(log.stamp_s, {**log.columns, "gnss_arrival_s": arrival - 0.1})
    late_config = CONFIG.model_copy(update={"gps_slots": 2})
    late = errors(play(NonlinearKalman(CAR, late_config), log), log)
    soon = errors(play(NonlinearKalman(CAR, late_config), early), early)
    assert np.sqrt(np.mean(late**2)) < 1.15 * np.sqrt(np.mean(soon**2))


@pytest.mark.parametrize(
    ("column", "value"), [("yaw_rate_radps", 2.0), ("ay_mps2", -40.0), ("course_rad", 1.5)]
)
def test_wild_values_are_weighed_down_and_counted(column: str, value: float) -> None:
    log = with_gps(driven(CAR, 20.0))
    clean = play(NonlinearKalman(CAR, CONFIG), log)
    wild = log.columns[column].copy()
    rows = np.flatnonzero(np.isfinite(wild))[20::37]
    wild[rows] += value
    estimator = NonlinearKalman(CAR, CONFIG)
    hit = play(estimator, SignalLog(log.stamp_s, {**log.columns, column: wild}))
    moved = np.abs(hit.column("sideslip_rad") - clean.column("sideslip_rad"))
    assert np.degrees(moved.max()) < 1.5
    assert sum(estimator.dropped.values()) >= len(rows) // 2


def test_standing_starting_and_stopping_are_finite() -> None:
    estimator = NonlinearKalman(CAR, CONFIG)
    for k in range(3000):
        t = STEP_S * k
        speed = max(0.0, min(t - 3.0, 20.0 - t, 8.0))
        estimator.step(t, Inputs(0.1, speed, 0.0, 0.0, 0.0, 0.0))
        estimator.measure(YAW_RATE, 0.1 * speed / CAR.wheelbase_m, t, t)
        estimator.measure(LATERAL_ACCELERATION, 0.1 * speed**2 / CAR.wheelbase_m, t, t)
        now = estimator.estimate()
        assert np.isfinite(now.mean).all()
        assert np.isfinite(now.sd).all()
        assert abs(now.value("sideslip_rad")) < 0.2
    assert now.value("yaw_rate_radps") == pytest.approx(0.0, abs=0.01)


def test_a_course_without_a_capture_is_counted() -> None:
    estimator = NonlinearKalman(CAR, CONFIG)
    estimator.step(0.0, Inputs(0.0, 10.0))
    estimator.measure(GPS, (0.1, 10.0), 0.0, 0.1)
    assert estimator.dropped == {"gps value without a capture": 1}


def test_a_row_update_is_the_josephs() -> None:
    rng = np.random.default_rng(0)
    root = rng.standard_normal((4, 4))
    start, covariance = rng.standard_normal(4), root @ root.T + np.eye(4)
    row = rng.standard_normal(4)
    one, other = (ClonedFilter(start.copy(), covariance.copy(), np.zeros((1, 4)), 0) for _ in "ab")
    one.row(row, 0.7, 0.3)
    other.update(row[None], np.array([0.7]), np.array([[0.3]]))
    np.testing.assert_allclose(one.x, other.x, rtol=1e-10)
    np.testing.assert_allclose(one.p, other.p, atol=1e-10)


def road_errors(played: Played, name: str, truth: np.ndarray) -> tuple[float, float, float]:
    """Error of bank or grade from 5 s on (rad), its NEES, and the size of the truth."""
    error = (played.column(name) - truth)[500:]
    nees = np.mean((error / played.sd_of(name)[500:]) ** 2)
    return float(np.sqrt(np.mean(error**2))), float(nees), float(np.sqrt(np.mean(truth[500:] ** 2)))


@pytest.mark.parametrize("gps", [False, True])
def test_bank_and_grade_of_a_road_are_told_from_bias_and_roll(gps: bool) -> None:
    log = driven(CAR, 60.0, bank_rad=0.06, grade_rad=0.06, bank_mps2=0.2)
    log = with_gps(log) if gps else log
    played = play(NonlinearKalman(CAR, CONFIG), log)
    for name, truth in (
        ("bank_rad", bank_of(log.stamp_s, 0.06)),
        ("grade_rad", grade_of(log.stamp_s, 0.06)),
    ):
        error, nees, size = road_errors(played, name, truth)
        assert error < 0.6 * size
        assert nees < 1.5
    slip = errors(played, log)
    assert np.degrees(np.sqrt(np.mean(slip**2))) < 0.2
    assert np.mean((slip / played.sd_of("sideslip_rad")[200:]) ** 2) < 1.0


def test_without_accelerometers_bank_and_grade_keep_their_deviations() -> None:
    log = driven(CAR, 20.0, bank_rad=0.06, grade_rad=0.06)
    deaf = {k: v for k, v in log.columns.items() if k not in ("ay_mps2", "ax_mps2")}
    played = play(NonlinearKalman(CAR, CONFIG), SignalLog(log.stamp_s, deaf))
    assert played.sd_of("grade_rad")[-1] == pytest.approx(GRADE_SD_RAD)
    assert played.column("grade_rad")[-1] == 0.0
    assert played.sd_of("bank_rad")[-1] > 0.8 * BANK_SD_RAD


def test_a_lasting_bias_of_the_forward_accelerometer_stays_in_the_grades_deviation() -> None:
    log = driven(CAR, 60.0)
    ax = log.columns["ax_mps2"] + 0.15
    played = play(
        NonlinearKalman(CAR, CONFIG), SignalLog(log.stamp_s, {**log.columns, "ax_mps2": ax})
    )
    grade, sd = played.column("grade_rad")[-1], played.sd_of("grade_rad")[-1]
    assert abs(grade) < 2.0 * sd
    assert sd > 0.005


def test_a_straight_car_is_known_better_than_one_in_a_bend() -> None:
    sds = [
        play(NonlinearKalman(CAR, CONFIG), driven(CAR, 20.0, lateral_mps2=lateral)).sd_of(
            "sideslip_rad"
        )[500:]
        for lateral in (0.1, 7.0)
    ]
    assert sds[0].mean() < 0.6 * sds[1].max()
