"""The turn of a camera from its own motion, and what it adds to that of the poles."""

from __future__ import annotations

import numpy as np
import pytest

from polemap.drivelog.samples import OdometrySample
from polemap.localize.particle_filter.detector_course import DetectorCourse
from polemap.localize.particle_filter.detector_fit import Change, StretchFit

SLIP_RAD_PER_MPS2 = 0.006


def driven(
    turn_rad: float,
    bend_radpm: float = 0.0,
    way_m: float = 60.0,
    axle_m: float = 0.0,
    seed: int = 0,
) -> DetectorCourse:
    """A way at 10 m/s and 10 pictures a second, seen with 0.2 degrees of noise a step.

    Args:
        axle_m: the rear axle lies so much farther behind the camera than is said.
    """
    rng = np.random.default_rng(seed)
    course = DetectorCourse(SLIP_RAD_PER_MPS2)
    speed, yaw_rate = 10.0, 10.0 * bend_radpm
    outward = -SLIP_RAD_PER_MPS2 * speed * yaw_rate
    for k in range(round(way_m)):
        seen = turn_rad + outward + axle_m * bend_radpm + rng.normal(0.0, 0.0035)
        sample = OdometrySample(0.1 * k, 0.1 * k, speed, yaw_rate, speed * np.tan(seen))
        course.add_step(sample, k + 1.0)
    return course


@pytest.mark.parametrize("turn_deg", [-2.0, 0.0, 0.7])
@pytest.mark.parametrize("bend_radpm", [0.0, 0.01, -0.02])
def test_the_turn_is_told_within_what_is_stated(turn_deg: float, bend_radpm: float) -> None:
    told = driven(np.radians(turn_deg), bend_radpm).turn(0.0)
    assert told is not None
    turn, sd = told
    assert abs(turn - np.radians(turn_deg)) < 2.0 * sd
    # 0.15 degrees on a straight road
    assert bend_radpm or sd < 0.0026


def test_the_stated_deviation_holds_a_wrong_axle_in_a_bend() -> None:
    told = driven(0.0, 0.02, axle_m=0.5).turn(0.0)
    assert told is not None
    assert 0.5 < abs(told[0]) / told[1] < 1.5


def test_a_way_has_its_own_turn() -> None:
    course = driven(0.0)
    for k in range(60, 120):
        course.add_step(OdometrySample(0.1 * k, 0.1 * k, 10.0, 0.0, 10.0 * np.tan(0.03)), k + 1.0)
    before, after = course.turn(0.0, 60.5), course.turn(60.5)
    assert before is not None
    assert after is not None
    assert before[0] == pytest.approx(0.0, abs=0.002)
    assert after[0] == pytest.approx(0.03, abs=0.002)


def test_it_says_nothing_of_a_short_way_a_tight_bend_or_a_standing_car() -> None:
    assert driven(0.0, way_m=4.0).turn(0.0) is None
    assert driven(0.0, 0.05).turn(0.0) is None
    course = DetectorCourse(SLIP_RAD_PER_MPS2)
    for k in range(100):
        course.add_step(OdometrySample(0.1 * k, 0.1 * k, 0.1, 0.0, 0.1), 0.01 * k)
    assert course.turn(0.0) is None


def test_memory_is_bounded() -> None:
    course = driven(0.0, way_m=2000.0)
    assert len(course._steps) < 200


def test_it_joins_a_fit_that_it_does_not_contradict() -> None:
    fit = StretchFit(np.array([0.02, 0.01, 0.1]), np.array([0.02, 0.01, 0.1]), 20)
    joined = fit.with_turn((0.0, 0.02))
    np.testing.assert_allclose(joined.values, [0.01, 0.01, 0.1])
    np.testing.assert_allclose(joined.sd, [0.02 / np.sqrt(2.0), 0.01, 0.1])
    assert fit.with_turn(None) is fit
    # poles that have turned while the camera has not are a fault of their own
    assert fit.with_turn((0.2, 0.02)).values[0] == 0.02


def test_it_joins_a_change_of_the_turn_alone() -> None:
    change = Change(3, 0, 0.02, 0.02)
    assert change.with_turn((0.01, 0.02), None) is change
    joined = change.with_turn((0.0, 0.001), (0.0, 0.001))
    assert joined.value < 0.001
    ranges = Change(3, 1, 0.02, 0.02)
    assert ranges.with_turn((0.0, 0.001), (0.0, 0.001)) is ranges
