"""The cloud: mean, covariance, modes, resampling, and how many particles it is worth."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from polemap.localize.config import KldConfig, LocalizeConfig
from polemap.localize.odometry_watch import Held
from polemap.localize.particle_filter.estimate import (
    find_modes,
    mean_and_covariance,
    modes_of,
    position_sd,
)
from polemap.localize.particle_filter.particles import (
    ParticleSet,
    effective_count,
    kld_count,
    log_mean,
    low_variance_indices,
    normalized,
    particles_needed,
)

KLD = {"bin_m": 0.5, "bin_rad": 0.1, "error": 0.05, "quantile": 2.33, "least": 50, "most": 2000}


@settings(max_examples=100, deadline=None)
@given(st.lists(st.floats(-2000, 50), min_size=1, max_size=40))
def test_weights_sum_to_one_and_n_eff_is_within_its_limits(log_weights: list[float]) -> None:
    weights, log_sum = normalized(np.array(log_weights))
    assert weights.sum() == pytest.approx(1.0)
    assert 1.0 - 1e-9 <= effective_count(weights) <= len(weights) + 1e-9
    assert log_sum >= max(log_weights) - 1e-9


def test_particles_without_any_weight_become_equal() -> None:
    weights, log_sum = normalized(np.full(4, -np.inf))
    np.testing.assert_allclose(weights, 0.25)
    assert log_sum == -np.inf
    assert log_mean(np.full(4, -np.inf), weights) == -np.inf
    assert log_mean(np.log([1.0, 3.0]), np.array([0.5, 0.5])) == pytest.approx(np.log(2.0))


def test_mean_and_covariance_match_a_sampled_gaussian_across_the_wrap() -> None:
    rng = np.random.default_rng(0)
    true_cov = np.array([[0.4, 0.1, 0.01], [0.1, 0.3, 0.0], [0.01, 0.0, 0.02]])
    centre = np.array([396_000.0, 5_820_000.0, np.pi - 0.02])
    n = 20_000
    poses = rng.multivariate_normal(centre, true_cov, n)
    mean, cov = mean_and_covariance(poses, np.full(n, 1.0 / n))
    np.testing.assert_allclose(mean[:2], centre[:2], atol=5 * np.sqrt(0.4 / n))
    turned = (mean[2] - centre[2] + np.pi) % (2 * np.pi) - np.pi
    assert abs(turned) < 5 * np.sqrt(0.02 / n)
    # the standard deviation of a sampled (co)variance is at most sqrt(2 / n) of the variances
    scale = np.sqrt(np.outer(np.diag(true_cov), np.diag(true_cov)))
    assert (np.abs(cov - true_cov) < 5 * np.sqrt(2 / n) * scale).all()
    assert (np.linalg.eigvalsh(cov) > 0).all()
    major, minor = position_sd(cov)
    np.testing.assert_allclose([minor**2, major**2], np.linalg.eigvalsh(cov[:2, :2]), rtol=1e-9)


def test_two_modes_are_found_and_neither_is_their_middle() -> None:
    rng = np.random.default_rng(1)
    first = rng.normal([0, 0, 3.1], [0.2, 0.2, 0.05], (700, 3))
    second = rng.normal([12, 5, -1.0], [0.3, 0.3, 0.05], (300, 3))
    poses = np.vstack([first, second])
    weights = np.full(1000, 1e-3)
    modes = find_modes(poses, weights, radius_m=1.5, radius_rad=0.35, share_min=0.1)
    assert [round(mode.share, 1) for mode in modes] == [0.7, 0.3]
    np.testing.assert_allclose(modes[0].mean, [0, 0, 3.1], atol=0.05)
    np.testing.assert_allclose(modes[1].mean, [12, 5, -1.0], atol=0.1)
    mean, covariance = mean_and_covariance(poses, weights)
    assert len(modes_of(poses, weights, mean, covariance)) == 2
    assert (
        len(
            modes_of(
                first,
                weights[:700] / 0.7,
                *mean_and_covariance(first, weights[:700] / 0.7),
            )
        )
        == 1
    )


def test_a_turned_copy_is_a_mode_of_its_own() -> None:
    rng = np.random.default_rng(2)
    poses = rng.normal([0, 0, 0], [0.1, 0.1, 0.03], (400, 3))
    poses[200:, 2] += np.pi
    modes = find_modes(poses, np.full(400, 1 / 400), radius_m=1.5, radius_rad=0.35, share_min=0.1)
    assert len(modes) == 2


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**31), st.integers(1, 300))
def test_low_variance_sampler_keeps_every_particle_floor_or_ceil_times(
    seed: int, count: int
) -> None:
    rng = np.random.default_rng(seed)
    weights = rng.random(50) ** 4
    weights /= weights.sum()
    chosen = np.bincount(low_variance_indices(weights, count, rng), minlength=50)
    assert chosen.sum() == count
    assert (chosen >= np.floor(count * weights - 1e-9)).all()
    assert (chosen <= np.ceil(count * weights + 1e-9)).all()


def test_low_variance_sampler_is_unbiased() -> None:
    rng = np.random.default_rng(0)
    weights = np.array([0.5, 0.3, 0.15, 0.05])
    runs = 4000
    total = sum(
        np.bincount(low_variance_indices(weights, 7, rng), minlength=4) for _ in range(runs)
    )
    # a count is floor or ceil of its expectation, so its variance is below 1/4
    np.testing.assert_allclose(total / runs, 7 * weights, atol=5 * 0.5 / np.sqrt(runs))


def test_kld_needs_more_particles_for_a_wider_spread() -> None:
    rng = np.random.default_rng(0)
    flat = np.full(3000, 1 / 3000)
    narrow = kld_count(rng.normal(0, [0.05, 0.05, 0.01], (3000, 3)), flat, **KLD)
    middle = kld_count(rng.normal(0, [0.3, 0.3, 0.05], (3000, 3)), flat, **KLD)
    wide = kld_count(rng.normal(0, [10, 10, 1.0], (3000, 3)), flat, **KLD)
    assert 50 <= narrow < middle < wide == 2000
    assert kld_count(np.zeros((10, 3)), np.full(10, 0.1), **KLD) == 50


def test_kld_count_is_the_wilson_hilferty_quantile() -> None:
    """Fox (2003): n = chi2_{k-1, 1-delta} / (2 epsilon)."""
    from scipy.stats import chi2

    poses = np.zeros((40, 3))
    poses[:, 0] = np.arange(40) + 0.25
    n = kld_count(poses, np.full(40, 1 / 40), **KLD)
    assert n == pytest.approx(chi2.ppf(0.9901, 39) / (2 * 0.05), rel=0.01)


def test_particle_count_is_fixed_unless_adaptive() -> None:
    poses, weights = np.zeros((10, 3)), np.full(10, 0.1)
    assert particles_needed(poses, weights, LocalizeConfig(particles=700)) == 700
    assert particles_needed(poses, weights, LocalizeConfig(kld=KldConfig(adaptive=True))) == 50


def test_who_followed_an_odometry_for_a_while_is_led_off_as_well() -> None:
    particles = ParticleSet(LocalizeConfig(particles=400), 2.7, np.random.default_rng(5))
    particles.place_all(np.zeros((400, 3)), np.zeros(400))
    particles.release(Held(0.0, 10.0, 0.0, step_mps=-10.0), 0.5, sure=True)
    motion = particles.motion
    assert motion is not None
    never = motion.free.copy()
    for _ in range(20):
        motion.switch(0.1, 0.0, 0.0)
        never &= motion.free
    assert not np.array_equal(never, motion.free)
    particles.drop_followers()
    assert particles.weights[never].sum() > 0.9


def test_what_is_kept_of_the_particles_follows_them() -> None:
    config = LocalizeConfig()
    rng = np.random.default_rng(0)
    particles = ParticleSet(config, 2.7, rng)

    def check() -> None:
        np.testing.assert_allclose(particles.rear[:, :2] + 2.7 * np.stack(
            [np.cos(particles.poses[:, 2]), np.sin(particles.poses[:, 2])], axis=1
        ), particles.poses[:, :2], atol=1e-12)  # fmt: skip
        np.testing.assert_array_equal(particles.weights, normalized(particles.log_weights)[0])
        for kept, fresh in zip(
            particles.moments, mean_and_covariance(particles.rear, particles.weights), strict=True
        ):
            np.testing.assert_array_equal(kept, fresh)

    particles.place_all(rng.normal(0.0, 1.0, (50, 3)), np.zeros(50))
    check()
    particles.log_weights = rng.normal(0.0, 1.0, 50)
    check()
    particles.poses = particles.poses + np.array([1.0, 2.0, 0.1])
    check()
    particles.resample_by_weight(1.0)
    check()
    particles.scatter(0.5, 10.0)
    check()
    for values in (particles.poses, particles.rear, particles.log_weights, particles.weights):
        with pytest.raises(ValueError, match="read-only"):
            values[0] = 1.0
