"""Margins by python-control, against the spectral radius of the closed loop."""

from __future__ import annotations

from math import pi

import numpy as np
import pytest

from polemap.electric.control.body_slip import PiGains, place_pi
from polemap.simulate.closed_loop.margins import (
    FAST_S,
    SLOW_S,
    frequency_response,
    gains_for_margin,
    loop_margins,
    margin_with_estimator_db,
    open_loop,
    scaled,
)
from polemap.vehicle.discretize import zero_order_hold
from polemap.vehicle.errors import VehicleError
from polemap.vehicle.io import load_car
from polemap.vehicle.single_track import lateral

COMS, SPEED = load_car("coms"), 25.0 / 3.6
GAINS = place_pi(*lateral(COMS, SPEED), 2.0 * pi)


def radius(gains: PiGains, period_s: float) -> float:
    """Spectral radius of the sampled loop, state `[beta, gamma, integral]`."""
    a, b = lateral(COMS, SPEED)
    g, h = zero_order_hold(a, b[:, 1:], period_s)
    kp, ki = gains.proportional_nm_per_rad, gains.integral_nm_per_rads * period_s
    closed = np.zeros((3, 3))
    closed[:2, :2] = g
    closed[:2, 0] -= (kp + ki) * h[:, 0]
    closed[:2, 2] = h[:, 0]
    closed[2] = (-ki, 0.0, 1.0)
    return float(np.abs(np.linalg.eigvals(closed)).max())


@pytest.mark.parametrize("period_s", [SLOW_S, FAST_S])
def test_the_loop_is_stable_up_to_its_margin_and_not_beyond(period_s: float) -> None:
    found = loop_margins(COMS, SPEED, GAINS, period_s)
    edge = 10.0 ** (found.gain_db / 20.0)
    assert radius(scaled(GAINS, 0.999 * edge), period_s) < 1.0
    assert radius(scaled(GAINS, 1.001 * edge), period_s) > 1.0


def test_the_fast_loop_bears_twenty_decibels_more() -> None:
    slow, fast = (loop_margins(COMS, SPEED, GAINS, t) for t in (SLOW_S, FAST_S))
    assert fast.gain_db - slow.gain_db >= 20.0
    assert fast.phase_deg > slow.phase_deg > 45.0


def test_gain_is_scaled_to_the_margin_asked_for() -> None:
    gains = gains_for_margin(COMS, SPEED, GAINS, FAST_S, 0.005, 12.0)
    assert loop_margins(COMS, SPEED, gains, FAST_S, 0.005).gain_db == pytest.approx(12.0, abs=0.01)


def test_with_the_running_estimator_the_gap_stays() -> None:
    single = margin_with_estimator_db("single_rate", COMS, SPEED, GAINS, period_s=SLOW_S)
    multi = margin_with_estimator_db("clones", COMS, SPEED, GAINS)
    assert multi - single >= 20.0
    # an exact filter without noise knows the state: the loop is that of the state itself
    known = loop_margins(COMS, SPEED, GAINS, FAST_S).gain_db
    assert multi == pytest.approx(known, abs=0.5)


def test_an_unstable_loop_has_no_margin() -> None:
    with pytest.raises(VehicleError, match="unstable as it is"):
        margin_with_estimator_db("bicycle", COMS, SPEED, scaled(GAINS, -5.0))


def test_the_bode_plot_crosses_where_the_margin_says() -> None:
    loop = open_loop(COMS, 25 / 3.6, place_pi(*lateral(COMS, 25 / 3.6), 2.0 * np.pi), FAST_S)
    margins = loop_margins(COMS, 25 / 3.6, place_pi(*lateral(COMS, 25 / 3.6), 2.0 * np.pi), FAST_S)
    answer = frequency_response(loop, np.array([margins.gain_hz]))[0]
    assert answer.real == pytest.approx(-(10.0 ** (-margins.gain_db / 20.0)), rel=1e-3)
    assert abs(answer.imag) < 1e-3 * abs(answer.real)
