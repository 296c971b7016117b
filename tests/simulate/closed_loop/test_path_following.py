"""The whole stack in a loop, and the measure of oscillation."""

from __future__ import annotations

import numpy as np
import pytest

from polemap.drivelog.errors import ConfigError
from polemap.simulate.closed_loop.follow_run import longest_swinging
from polemap.simulate.closed_loop.path_following import FollowScenario, follow_path
from polemap.simulate.closed_loop.path_study import path_study
from polemap.simulate.closed_loop.road import winding_road
from polemap.vehicle.io import load_car

PASSAT = load_car("passat")
TIME = np.arange(0.0, 20.0, 0.01)


@pytest.mark.parametrize(
    ("amplitude", "hertz", "expected"),
    [
        (0.06, 0.5, 18),  # 0.12 m from side to side, twice a second
        (0.04, 0.5, 0),  # too small
        (0.06, 0.2, 0),  # too slow: 2.5 s from side to side is the road's
    ],
)
def test_swings_are_counted(amplitude: float, hertz: float, expected: int) -> None:
    found = longest_swinging(TIME, amplitude * np.sin(2 * np.pi * hertz * TIME))
    assert found == pytest.approx(expected, abs=1)


def test_a_swing_that_dies_out_is_no_oscillation() -> None:
    assert longest_swinging(TIME, 0.2 * np.exp(-TIME) * np.cos(3.0 * TIME)) < 4


def test_the_road_winds_within_its_limit_and_has_poles_beside_it() -> None:
    road = winding_road(400.0, 0.01, np.random.default_rng(3))
    station = np.linspace(5.0, 395.0, 500)
    bends = np.abs(road.path.curvature_radpm(station))
    assert 0.005 < bends.max() <= 0.0102
    assert len(road.pole_map) > 50
    away = np.abs([road.path.locate(x, y, 0.0).lateral_m for x, y in road.poles.points_m])
    assert away.min() > 2.0


def test_the_true_pose_holds_the_path() -> None:
    run = follow_path(PASSAT, FollowScenario(50 / 3.6, "truth", 0.0, 14.0), 1)
    assert run.rms_m() < 0.02
    assert run.swings() == 0
    late = follow_path(PASSAT, FollowScenario(50 / 3.6, "truth", 0.15, 14.0), 1)
    assert run.rms_m() < late.rms_m() < 0.1


def test_the_localizers_output_steers_the_car() -> None:
    run = follow_path(PASSAT, FollowScenario(50 / 3.6, "filter", 0.1, 16.0), 0)
    assert not run.left_road
    assert run.driver_share == 0.0
    assert run.rms_m() <= 0.15
    assert run.swings() < 4


def test_takes_no_estimator() -> None:
    with pytest.raises(ConfigError, match="takes no --estimator"):
        path_study(PASSAT, 1, lambda _n: None, ("clones",))
