import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from polemap.localize.output_filter.pose_update import covariance_deficit, decorrelated_noise
from polemap.vehicle.kalman import innovate, joseph_update


def random_covariance(rng, scale=1.0):
    root = rng.normal(size=(3, 3))
    return scale * (root @ root.T + 0.05 * np.eye(3))


@given(st.integers(0, 10_000))
def test_an_update_with_decorrelated_noise_ends_at_the_covariance_that_was_offered(seed):
    rng = np.random.default_rng(seed)
    offered = random_covariance(rng)
    known = offered + random_covariance(rng)
    noise = decorrelated_noise(known, offered, 0.0)
    innovation = innovate(np.zeros(3), known, np.eye(3), noise)
    _, after = joseph_update(np.zeros(3), known, innovation, np.eye(3), noise)
    assert np.allclose(after, offered, rtol=1e-6, atol=1e-8)


@given(st.integers(0, 10_000), st.floats(0.05, 0.95))
def test_the_gain_is_never_below_the_least(seed, least):
    rng = np.random.default_rng(seed)
    known, offered = random_covariance(rng), random_covariance(rng)
    noise = decorrelated_noise(known, offered, least)
    gain = innovate(np.zeros(3), known, np.eye(3), noise).gain
    assert np.linalg.eigvals(gain).real.min() > least - 1e-9


@given(st.integers(0, 10_000))
def test_with_what_is_missing_nothing_is_claimed_beyond_the_offer(seed):
    rng = np.random.default_rng(seed)
    claimed, offered = random_covariance(rng), random_covariance(rng)
    added = covariance_deficit(claimed, offered)
    assert np.linalg.eigvalsh(added).min() > -1e-12
    assert np.linalg.eigvalsh(claimed + added - offered).min() > -1e-9
    # and no more than that: where nothing is missing, nothing is added
    assert np.allclose(
        covariance_deficit(offered + random_covariance(rng), offered), 0.0, atol=1e-12
    )


def test_the_same_pose_again_teaches_nothing():
    offered = np.diag([0.01, 0.04, 1e-4])
    known = np.diag([1.0, 1.0, 0.1])
    for _ in range(100):
        noise = decorrelated_noise(known, offered, 0.2)
        innovation = innovate(np.zeros(3), known, np.eye(3), noise)
        _, known = joseph_update(np.zeros(3), known, innovation, np.eye(3), noise)
        known = known + covariance_deficit(known, offered)
    assert np.allclose(known, offered, rtol=1e-6)
