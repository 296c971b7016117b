"""A car that shakes is no noisy sensor: what two sensors show is a movement."""

from __future__ import annotations

import numpy as np
import pytest

from polemap.electric.isolation.shared_movement import compare
from polemap.electric.signals import SignalLog
from tests.electric.isolation.test_isolation import faults_in

STEP_S = 0.01
BRAKES_S = ((14.0, 16.0), (22.0, 23.0))


def braked(seed: int, pulse_mps2: float = 0.0, wheel_sd_mps: float = 0.01) -> SignalLog:
    """A straight road; the brake is stamped on twice, pulses by 31 Hz, and is let go at once."""
    rng = np.random.default_rng(seed)
    draw = rng.standard_normal
    # ten times as fine as the rows: what the wheels gain within one is no mean of its ends
    fine = 0.1 * STEP_S * np.arange(30000)
    ax = 0.3 * np.sin(2 * np.pi * fine / 9.0)
    for start_s, end_s in BRAKES_S:
        inside = (fine >= start_s) & (fine < end_s)
        ax = ax - inside * (5.0 + pulse_mps2 * np.sin(2 * np.pi * 31.0 * fine))
    speed = 30.0 + 0.1 * STEP_S * np.cumsum(ax)
    t, ax, speed = fine[::10], ax[::10], speed[::10]
    rate = 0.02 * np.sin(2 * np.pi * t / 8.0)
    return SignalLog(
        t,
        {
            "road_wheel_angle_rad": rate * 2.7 / speed + 3e-4 * draw(len(t)),
            "yaw_rate_radps": rate + 0.002 * draw(len(t)),
            "ax_mps2": ax + 0.04 * draw(len(t)),
            "ay_mps2": speed * rate + 0.05 * draw(len(t)),
            "vx_mps": speed + wheel_sd_mps * draw(len(t)),
        },
    )


@pytest.mark.parametrize("pulse_mps2", [0.0, 2.5, 4.0])
@pytest.mark.parametrize("wheel_sd_mps", [0.0, 0.01, 0.03])
def test_hard_braking_and_its_release_accuse_nobody(pulse_mps2: float, wheel_sd_mps: float) -> None:
    """Slip control shakes the car by more than 20 times what the accelerometer scatters."""
    assert faults_in(braked(1, pulse_mps2, wheel_sd_mps)) == []


@pytest.mark.parametrize("from_s", [8.0, BRAKES_S[0][0]])
def test_an_accelerometer_that_is_noisy_is_found_on_the_road_and_in_the_brakes(
    from_s: float,
) -> None:
    log = braked(2)
    noisy = (log.stamp_s >= from_s) & (log.stamp_s < from_s + 2.0)
    ax = log.columns["ax_mps2"] + 1.5 * noisy * np.random.default_rng(3).standard_normal(len(log))
    found = faults_in(SignalLog(log.stamp_s, {**log.columns, "ax_mps2": ax}))
    assert [fault.sensor for fault in found] == ["forward accelerometer"]
    assert found[0].what == "ten times its noise"
    assert found[0].found_s < from_s + 1.0


def test_wheels_whose_noise_is_their_own_are_found() -> None:
    log = braked(4)
    noisy = (log.stamp_s >= 8.0) & (log.stamp_s < 10.0)
    wheel = log.columns["vx_mps"] + 0.3 * noisy * np.random.default_rng(5).standard_normal(len(log))
    found = faults_in(SignalLog(log.stamp_s, {**log.columns, "vx_mps": wheel}))
    assert [fault.sensor for fault in found] == ["wheel speed"]


def test_movement_is_shared_whichever_comes_first_and_noise_is_not() -> None:
    t = STEP_S * np.arange(101)
    rng = np.random.default_rng(0)
    shake = np.convolve(rng.standard_normal(140), np.ones(3) / 3.0, "valid")[:121]
    speed = STEP_S * np.cumsum(shake)
    for late in (-1, 0, 4):
        level = shake[10 + 1 : 10 + 102]
        assert compare(t, 5.0 * t**2 + level, speed[10 - late : 10 - late + 101]).shared
    shared = sum(
        compare(t, rng.standard_normal(101), rng.standard_normal(101)).shared for _ in range(400)
    )
    assert shared <= 4
    # a slow course in both is no shaking
    noise = rng.standard_normal((2, 101))
    assert not compare(t, noise[0] - 8.0 * t, 0.03 * noise[1] - 4.0 * t**2).shared


def test_a_signal_that_never_moves_shares_nothing() -> None:
    t = STEP_S * np.arange(101)
    assert not compare(t, np.sin(60.0 * t), np.zeros(101)).shared
    assert not compare(t[:10], np.sin(60.0 * t[:10]), np.cos(60.0 * t[:10])).shared
