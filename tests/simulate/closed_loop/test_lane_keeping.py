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
