"""Steps that no car makes: held back, then believed or not."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.electric.fault_drives import driven
from polemap.electric.estimators.registry import make_estimator
from polemap.electric.isolation.leaps import LASTING_S, Leaps
from polemap.electric.isolation.suspicion import Fault
from polemap.electric.isolation.tolerant import FaultTolerant
from polemap.electric.signals import SignalLog, play
from tests.electric.isolation.test_isolation import CAR, CONFIG, faults_in

STEP_S = 0.01


def told(values: list[float], leaps: Leaps | None = None) -> tuple[list[bool], float]:
    """Which values are held back, and the step that lasted."""
    leaps, size, held = leaps or Leaps(8.0, 0.05), 0.0, []
    for k, value in enumerate(values):
        held.append(leaps.hold_back(value, STEP_S * k))
        if held[-1]:
            size = size or leaps.lasts(value, STEP_S * k)
    return held, size


def test_a_step_is_held_back_until_it_lasts_and_is_the_level_then() -> None:
    held, size = told([0.0, 0.01, *[0.3] * 8])
    assert held == [False, False, *[True] * 5, False, False, False]
    assert size == pytest.approx(0.29)


def test_a_single_wild_value_is_not_told_and_nothing_else_is() -> None:
    held, size = told([0.0, 0.0, 5.0, 0.0, 0.01])
    assert held == [False, False, True, False, False]
    assert size == 0.0


def test_what_a_car_can_do_is_told() -> None:
    """A slide's yaw acceleration, a sensor of ten values a second, one that stood for long."""
    t = STEP_S * np.arange(100)
    assert not any(told((0.5 * np.sin(2 * np.pi * 2.0 * t)).tolist())[0])
    stairs = np.repeat(np.linspace(0.0, 3.0, 10), 10)
    assert not any(told(stairs.tolist())[0])
    assert not any(told([*[0.0] * 30, *[0.4] * 30])[0])


def test_a_wild_value_after_long_silence_makes_no_leap_of_the_way_back() -> None:
    """A steering that is held, four rows of nothing, and the angle again."""
    held, size = told([*[0.14] * 40, *[0.0] * 2, *[0.135] * 8], Leaps(1.2, 0.01))
    assert not any(held)
    assert size == 0.0


def test_the_noise_of_a_sensor_is_no_step() -> None:
    noisy = Leaps(8.0, 0.05)
    noisy.noise = 0.05
    assert not noisy.hold_back(0.0, 0.0)
    assert not noisy.hold_back(0.4, STEP_S)
    assert noisy.hold_back(-0.4, 2 * STEP_S)
    assert LASTING_S > 3 * STEP_S


@pytest.mark.parametrize(
    ("column", "size", "sensor"),
    [("yaw_rate_radps", 0.2, "gyro"), ("road_wheel_angle_rad", 0.05, "steering")],
)
def test_a_step_is_found_before_it_moves_the_estimate(
    column: str, size: float, sensor: str
) -> None:
    clean = driven(CAR, "country", 12.0, seed=21).log
    wrong = clean.stamp_s >= 8.0
    log = SignalLog(clean.stamp_s, {**clean.columns, column: clean.columns[column] + size * wrong})
    found: list[Fault] = []
    slips = [
        play(FaultTolerant(make_estimator("bicycle", CAR, CONFIG), CAR, CONFIG, (), found), each)
        for each in (clean, log)
    ]
    (fault,) = found
    assert fault.sensor == sensor
    assert fault.found_s < 8.0 + LASTING_S + 1.5 * STEP_S
    off = np.abs(slips[1].column("sideslip_rad") - slips[0].column("sideslip_rad"))
    assert off[(clean.stamp_s > 8.0) & (clean.stamp_s < 8.5)].max() < 0.003


def test_a_course_that_leaps_is_not_told_even_in_a_slide() -> None:
    """Beyond the tyres' linear range votes leave side-slip room for 0.2 rad within a fix."""
    clean = driven(CAR, "brisk", 14.0, seed=22).log
    hard = np.abs(clean.columns["ay_mps2"])
    fixes = np.flatnonzero(np.isfinite(clean.columns["course_rad"]) & (clean.stamp_s > 8.0))
    first = int(fixes[np.argmax(hard[fixes])])
    assert hard[first] > 4.0
    course = clean.columns["course_rad"] + 0.25 * (clean.stamp_s >= clean.stamp_s[first])
    log = SignalLog(clean.stamp_s, {**clean.columns, "course_rad": course})
    found = [fault for fault in faults_in(log) if fault.sensor == "GPS"]
    assert found
    assert found[0].found_s <= clean.stamp_s[first] + 0.15
    assert not faults_in(clean)
