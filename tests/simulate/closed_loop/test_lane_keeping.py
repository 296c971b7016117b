"""Motion and position in one loop: what the yaw moment and the rate are worth, behind a filter."""

from __future__ import annotations

import numpy as np
import pytest

from polemap.drivelog.errors import ConfigError
from polemap.simulate.closed_loop.choice import TRUTH
from polemap.simulate.closed_loop.lane_keeping_study import (
    BOTH,
    STEERING,
    LaneShift,
    lane_keeping_study,
    run_keeping,
)
from polemap.simulate.closed_loop.margins import SLOW_S
from polemap.simulate.closed_loop.speeds import Swing
from polemap.vehicle.io import load_car

COMS = load_car("coms")
SHIFT = LaneShift(begin_s=0.5, lasts_s=2.0)


def test_a_shift_begins_and_ends_at_rest_and_its_rate_is_its_slope() -> None:
    stamps = np.linspace(0.0, 3.0, 3001)
    places, rates = np.array([SHIFT(t) for t in stamps.tolist()]).T
    assert places[0] == 0.0
    assert places[-1] == pytest.approx(SHIFT.aside_m)
    np.testing.assert_allclose(np.gradient(places, stamps), rates, atol=2e-3)


def test_the_moment_holds_the_side_slip_and_the_lane_is_kept_behind_a_filter() -> None:
    true, one, both = (
        run_keeping(COMS, name, weights, 0, 0.0, SHIFT)
        for name, weights in ((TRUTH, STEERING), ("clones", STEERING), ("clones", BOTH))
    )
    assert np.abs(true.offset_error_m()).max() < 0.02
    assert np.abs(both.offset_error_m()).max() < 0.04
    assert both.error_rms_rad() < 0.9 * one.error_rms_rad()
    assert one.moment_peak_nm() == 0.0


def test_once_a_frame_is_worse_than_every_millisecond() -> None:
    slow, fast = (run_keeping(COMS, TRUTH, BOTH, 0, hold, SHIFT) for hold in (SLOW_S, 0.0))
    assert np.std(fast.offset_error_m()) < 0.8 * np.std(slow.offset_error_m())


def test_an_estimator_without_a_lane_is_refused() -> None:
    with pytest.raises(ConfigError, match="estimator bicycle cannot serve here"):
        lane_keeping_study(COMS, 1, lambda _n: None, ("bicycle",))


def test_the_papers_ranges_of_speed_are_driven_and_the_lane_is_kept() -> None:
    swing = Swing(0.0, 30.0)
    assert swing(0.0) == 0.0
    assert swing(8.0) == pytest.approx(30.0 / 3.6)
    assert str(swing) == "0-30 km/h"
    steps = np.diff([swing(t) for t in np.linspace(0.0, 16.0, 1601).tolist()]) / 0.01
    assert np.abs(steps).max() < 0.7 * 2.0 * COMS.motor_torque_limit_nm / (
        COMS.wheel_radius_m * COMS.mass_kg
    )
    run = run_keeping(COMS, "clones", BOTH, 0, SLOW_S, SHIFT, Swing(10.0, 20.0, 6.0))
    assert run.speed_mps.max() > 5.2
    assert run.speed_mps.min() < 3.0
    assert np.abs(run.offset_error_m()).max() < 0.05
