"""Lane keeping on the offset ahead: the regulator's own properties, and its commands' limits."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from polemap.electric.control.lane_keeping import LaneKeeper, LaneWeights
from polemap.electric.control.lateral_stability import LateralLimits
from polemap.vehicle.discretize import zero_order_hold
from polemap.vehicle.errors import VehicleError
from polemap.vehicle.io import load_car
from polemap.vehicle.single_track import combined_vision

COMS = load_car("coms")
LIMITS = LateralLimits()


@pytest.mark.parametrize("period_s", [0.001, 0.033])
@pytest.mark.parametrize("moment_nm", [0.0, 100.0])
def test_the_loop_is_stable_at_every_speed(period_s: float, moment_nm: float) -> None:
    keeper = LaneKeeper(COMS, LaneWeights(yaw_moment_nm=moment_nm), LIMITS, period_s)
    # between the grid's speeds too, and above the critical speed of a car that oversteers
    for speed in (1.0, 2.5, 6.94, 12.3, 17.6, 25.0, 39.9):
        a, b = combined_vision(COMS, speed)
        g, h = zero_order_hold(a, b, period_s)
        assert np.abs(np.linalg.eigvals(g - h @ keeper.gain(speed))).max() < 1.0


def test_the_gain_is_the_best_of_its_neighbours() -> None:
    weights, period = LaneWeights(), 0.033
    gain = LaneKeeper(COMS, weights, LIMITS, period).gain(7.0)
    g, h = zero_order_hold(*combined_vision(COMS, 7.0), period)

    def cost(k: np.ndarray) -> float:
        """Of the way back from half a metre aside."""
        x, total = np.array([0.01, 0.1, 0.05, 0.5]), 0.0
        for _ in range(600):
            u = -k @ x
            total += (x[0] / weights.sideslip_rad) ** 2 + (x[3] / weights.offset_m) ** 2
            total += (u[0] / weights.steer_rad) ** 2 + (u[1] / weights.yaw_moment_nm) ** 2
            x = g @ x + h @ u
        return total

    best = cost(gain)
    for row in range(2):
        for column in range(4):
            for share in (0.9, 1.1):
                moved = gain.copy()
                moved[row, column] *= share
                assert cost(moved) >= best * (1.0 - 1e-9)


def test_at_the_wanted_place_nothing_is_commanded_and_far_off_it_the_limits() -> None:
    keeper = LaneKeeper(COMS, LaneWeights(), LIMITS, 0.001)
    there = keeper.step(np.array([0.0, 0.0, 0.1, 1.0]), 5.0, 1.0, 0.5)
    assert there.steer_rad == pytest.approx(0.0, abs=1e-12)
    assert there.yaw_moment_nm == pytest.approx(0.0, abs=1e-9)
    assert not there.saturated
    far = keeper.step(np.array([0.0, 0.0, 0.0, 50.0]), 5.0)
    assert (far.steer_rad, far.saturated) == (-LIMITS.steer_rad, True)
    alone = LaneKeeper(COMS, LaneWeights(yaw_moment_nm=0.0), LIMITS, 0.001)
    assert alone.step(np.array([0.01, 0.1, 0.0, 0.1]), 5.0).yaw_moment_nm == 0.0


@pytest.mark.parametrize("name", ["offset_m", "sideslip_rad", "steer_rad", "yaw_moment_nm"])
def test_a_weight_that_is_none_is_refused(name: str) -> None:
    with pytest.raises(VehicleError, match="weights and the period must be positive"):
        LaneKeeper(COMS, replace(LaneWeights(), **{name: -1.0}), LIMITS, 0.001)
    with pytest.raises(VehicleError, match="weights and the period must be positive"):
        LaneKeeper(COMS, LaneWeights(), LIMITS, 0.0)
