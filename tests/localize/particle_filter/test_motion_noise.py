"""The learned scale of the motion noise, on a linear filter whose true noise is known."""

from __future__ import annotations

import numpy as np
import pytest

from polemap.localize.config import OdometryConfig
from polemap.localize.particle_filter.motion_noise import (
    MEMORY_WINDOWS,
    SCALE_START,
    WINDOW,
    NoiseScale,
)

NOISE_SD = np.array([0.10, 0.06, 0.006])  # of one step, as the alphas have it
SCAN_SD = np.array([0.15, 0.12, 0.01])
INDEPENDENT_SHARE = 0.5


def drive(true_factors: np.ndarray, config: OdometryConfig, *, seed: int, steps: int) -> NoiseScale:
    """A Kalman filter along, aside and in yaw of a car that heads north-east."""
    rng = np.random.default_rng(seed)
    scale = NoiseScale(config)
    yaw = np.pi / 4
    c, s = np.cos(yaw), np.sin(yaw)
    to_world = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    error, variance = np.zeros(3), SCAN_SD**2
    for _ in range(steps):
        error = error + true_factors * NOISE_SD * rng.standard_normal(3)
        prior = variance + (scale.factors * NOISE_SD) ** 2
        gain = prior / (prior + SCAN_SD**2)
        after = error + gain * (SCAN_SD * rng.standard_normal(3) - error)
        variance = (1.0 - gain) * prior
        pose = np.array([100.0, 200.0, yaw])
        scale.add_correction(
            (pose + to_world @ error, to_world @ np.diag(prior) @ to_world.T),
            (pose + to_world @ after, to_world @ np.diag(variance) @ to_world.T),
            INDEPENDENT_SHARE,
            trusted=True,
        )
        error = after
    return scale


@pytest.mark.parametrize("true_factors", [(0.6, 0.6, 0.6), (1.0, 0.5, 2.0)])
def test_the_true_noise_is_learned_for_each_direction(
    true_factors: tuple[float, float, float],
) -> None:
    config = OdometryConfig()
    steps = round(120 * WINDOW / INDEPENDENT_SHARE)
    learned = [
        drive(np.array(true_factors), config, seed=seed, steps=steps).factors for seed in range(8)
    ]
    # a mean of C^2 over the memory of 30 windows scatters by sqrt(2 / 30), a root of it by half
    expected = np.sqrt(1.0 / (2.0 * MEMORY_WINDOWS) / len(learned))
    assert np.mean(learned, axis=0) == pytest.approx(true_factors, rel=5.0 * expected)


def test_it_starts_from_its_prior_and_can_be_switched_off() -> None:
    assert NoiseScale(OdometryConfig()).factors == pytest.approx(SCALE_START)
    off = drive(np.full(3, 3.0), OdometryConfig(learn_noise=False), seed=0, steps=200)
    assert off.factors.tolist() == [1.0, 1.0, 1.0]


def test_what_poles_do_not_hold_says_nothing() -> None:
    scale = NoiseScale(OdometryConfig())
    small, large = np.diag([0.01, 0.01, 1e-4]), np.diag([0.02, 0.02, 2e-4])
    for trusted in [True] * 7 + [False]:
        # the eighth part of a window's news: it would close at the eighth trusted scan
        jump = np.array([5.0, 0.0, 0.0])
        scale.add_correction((np.zeros(3), large), (jump, small), WINDOW / 8, trusted=trusted)
    assert scale.factors == pytest.approx(SCALE_START)


def test_one_shock_does_not_decide() -> None:
    scale = NoiseScale(OdometryConfig())
    small, large = np.diag([0.01, 0.01, 1e-4]), np.diag([0.02, 0.02, 2e-4])
    scale.add_correction((np.zeros(3), large), (np.full(3, 50.0), small), WINDOW, trusted=True)
    assert 1.0 < scale.factors.max() <= 2.0
