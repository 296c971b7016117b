"""Corner and lane change on the plant: what the controllers promise, behind real estimators."""

from __future__ import annotations

from math import pi

import numpy as np
import pytest

from polemap.electric.control.body_slip import feed_forward_gain, place_pi
from polemap.simulate.closed_loop.choice import NONE, TRUTH
from polemap.simulate.closed_loop.cornering import Corner, CornerSettings, yaw_moment_limit_nm
from polemap.simulate.closed_loop.cornering_study import ICE, ICE_STEER_RAD, SPUN_RAD, Case
from polemap.simulate.closed_loop.lane_study import MARGIN_DB, SPEED_MPS, run_lane, speeding
from polemap.simulate.closed_loop.lateral import LaneChange
from polemap.simulate.closed_loop.margins import FAST_S, SLOW_S, gains_for_margin
from polemap.vehicle.io import load_car
from polemap.vehicle.single_track import lateral

COMS = load_car("coms")
DRY = Case(COMS, Corner(begin_s=1.5), 0.9, 4.5)


@pytest.mark.parametrize("name", [TRUTH, "stiffness"])
def test_rejection_takes_nine_tenths_of_the_side_slip_error(name: str) -> None:
    settled = DRY.corner.settled_s
    left = DRY.run(name, 0, CornerSettings(reject=False))
    done = DRY.run(name, 0)
    assert done.error_rms_rad(settled) <= 0.1 * left.error_rms_rad(settled)
    assert done.moment_peak_nm() <= 372.73
    assert not done.saturated.any()


def test_what_ground_cannot_carry_is_handed_back_and_reported() -> None:
    ice = Case(COMS, Corner(ICE_STEER_RAD, begin_s=1.0), ICE, 3.5)
    free, guarded = ice.run(NONE, 0), ice.run("stiffness", 0)
    assert guarded.peak_rad() < free.peak_rad()
    assert guarded.saturated.mean() > 0.2
    assert guarded.moment_peak_nm() <= 372.73
    # without the guard the same controller turns the car round: the guard is what saves it
    assert ice.run("stiffness", 0, CornerSettings(guarded=False)).peak_rad() > SPUN_RAD


def test_moment_limit_is_the_published_one() -> None:
    assert yaw_moment_limit_nm(COMS) == pytest.approx(372.7, abs=0.05)


def test_more_rate_at_the_same_margin_holds_the_side_slip_better() -> None:
    designed = place_pi(*lateral(COMS, SPEED_MPS), 2.0 * pi)
    driver = LaneChange()
    runs = []
    for name, period, hold in (("single_rate", SLOW_S, SLOW_S), ("clones", FAST_S, 0.0)):
        gains = gains_for_margin(COMS, SPEED_MPS, designed, period, 0.005, MARGIN_DB)
        runs.append(run_lane(COMS, name, gains, 0, hold, driver))
    free = run_lane(COMS, NONE, None, 0, 0.0, driver)
    single, multi = (r.error_rms_rad(driver.begin_s) for r in runs)
    assert multi < 0.6 * single < 0.6 * free.error_rms_rad(driver.begin_s)
    # the single-rate command stands still between pictures
    moved = np.flatnonzero(np.diff(runs[0].yaw_moment_nm))
    assert (np.diff(moved) % 33 == 0).all()
    assert all(r.moment_peak_nm() <= 372.73 for r in runs)


def test_a_schedule_holds_the_side_slip_while_the_speed_changes() -> None:
    gains = place_pi(*lateral(COMS, SPEED_MPS), 2.0 * pi)
    fixed = feed_forward_gain(*lateral(COMS, SPEED_MPS))
    driver = LaneChange()
    rms = [
        run_lane(
            COMS, TRUTH, gains, 0, 0.0, driver, speed=speeding, feed_forward=forward
        ).error_rms_rad(driver.begin_s)
        for forward in (None, fixed)
    ]
    assert rms[0] < 0.75 * rms[1]
