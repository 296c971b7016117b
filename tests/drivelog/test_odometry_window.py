"""The window of recent odometry: late, doubled and broken samples, forgetting, interpolation."""

from __future__ import annotations

import numpy as np
import pytest

from polemap.drivelog.odometry_window import OdometryWindow
from polemap.drivelog.samples import OdometrySample


def _window(stamps: list[float], keep_s: float = 10.0, slack: float = 1.0) -> OdometryWindow:
    window = OdometryWindow(keep_s, slack=slack)
    for number, stamp in enumerate(stamps):
        assert window.insert(OdometrySample(stamp, stamp, float(number), 0.1 * number))
    return window


def test_any_order_of_arrival_gives_the_same_window() -> None:
    rng = np.random.default_rng(3)
    stamps = np.cumsum(rng.uniform(0.01, 0.2, 50))
    speeds = rng.normal(size=50)
    window = OdometryWindow(100.0)
    for i in rng.permutation(50):
        window.insert(OdometrySample(float(stamps[i]), 0.0, float(speeds[i]), 0.0))
    assert window.stamps_s == stamps.tolist()
    assert window.speeds_mps == speeds.tolist()


def test_a_doubled_stamp_replaces_and_a_broken_value_is_left_out() -> None:
    window = _window([0.0, 0.2, 0.1, 0.2])
    assert (window.stamps_s, window.speeds_mps) == ([0.0, 0.1, 0.2], [0.0, 2.0, 3.0])
    for bad in ((np.nan, 1.0, 0.0), (0.3, np.inf, 0.0), (0.3, 1.0, np.nan)):
        assert not window.insert(OdometrySample(bad[0], 0.3, bad[1], bad[2]))
    assert len(window) == 3
    assert window.newest_s == 0.2


def test_only_what_is_too_old_is_forgotten() -> None:
    window = _window([float(k) for k in range(16)], keep_s=10.0, slack=1.5)
    assert window.forget() == 0
    window.insert(OdometrySample(16.0, 16.0, 0.0, 0.0))
    assert window.forget() == 6
    assert window.stamps_s[0] == 6.0
    assert len(window.speeds_mps) == len(window.yaw_rates_radps) == len(window) == 11
    assert OdometryWindow(1.0).forget() == 0


def test_rates_are_linear_between_and_held_beyond() -> None:
    window = _window([1.0, 3.0])
    assert window.rates_at(2.0) == pytest.approx((0.5, 0.05))
    assert window.rates_at(0.0) == (0.0, 0.0)
    assert window.rates_at(9.0) == (1.0, 0.1)
    assert OdometryWindow(1.0).rates_at(0.0) == (0.0, 0.0)
