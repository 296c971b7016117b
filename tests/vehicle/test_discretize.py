import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad_vec
from scipy.linalg import expm

from polemap.vehicle.discretize import van_loan, zero_order_hold, zero_order_hold_series
from polemap.vehicle.errors import VehicleError


@given(st.integers(0, 10_000), st.floats(0.001, 0.5))
def test_van_loan_equals_the_integral(seed, period):
    rng = np.random.default_rng(seed)
    a, root = rng.normal(size=(3, 3)), rng.normal(size=(3, 3))
    density = root @ root.T
    transition, noise = van_loan(a, density, period)
    exact, _ = quad_vec(lambda s: expm(a * s) @ density @ expm(a * s).T, 0.0, period)
    assert np.allclose(transition, expm(a * period), atol=1e-11)
    assert np.allclose(noise, exact, rtol=1e-8, atol=1e-11)
    assert np.array_equal(noise, noise.T)


@given(st.integers(0, 10_000), st.floats(0.001, 0.5))
def test_zero_order_hold_equals_the_integral(seed, period):
    rng = np.random.default_rng(seed)
    a, b = rng.normal(size=(4, 4)), rng.normal(size=(4, 2))
    g, h = zero_order_hold(a, b, period)
    exact, _ = quad_vec(lambda s: expm(a * s) @ b, 0.0, period)
    assert np.allclose(g, expm(a * period), atol=1e-11)
    assert np.allclose(h, exact, rtol=1e-8, atol=1e-11)


@given(st.integers(0, 10_000))
def test_the_series_of_many_models_differs_from_the_hold_by_its_fifth_order(seed):
    rng = np.random.default_rng(seed)
    a, b = rng.normal(size=(6, 3, 3)), rng.normal(size=(6, 3, 2))
    period = rng.uniform(0.001, 0.2, 6)
    g, h = zero_order_hold_series(a, b, period)
    for k in range(6):
        exact_g, exact_h = zero_order_hold(a[k], b[k], period[k])
        size = np.linalg.norm(a[k], 2) * period[k]
        left = np.exp(size) / 120.0
        assert np.linalg.norm(g[k] - exact_g, 2) <= left * size**5 + 1e-13
        reach = period[k] * np.linalg.norm(b[k], 2)
        assert np.linalg.norm(h[k] - exact_h, 2) <= left * size**4 * reach + 1e-13


def test_two_half_steps_are_a_whole_one():
    a = np.array([[0.0, 1.0], [-2.0, -0.3]])
    density = np.diag([0.0, 0.7])
    g, q = van_loan(a, density, 0.1)
    g_half, q_half = van_loan(a, density, 0.05)
    assert np.allclose(g_half @ g_half, g, atol=1e-14)
    assert np.allclose(g_half @ q_half @ g_half.T + q_half, q, atol=1e-15)


def test_a_double_integrator_has_its_textbook_noise():
    _, q = van_loan(np.array([[0.0, 1.0], [0.0, 0.0]]), np.diag([0.0, 3.0]), 0.2)
    assert np.allclose(q, 3.0 * np.array([[0.2**3 / 3, 0.2**2 / 2], [0.2**2 / 2, 0.2]]))


def test_models_that_do_not_fit_are_refused():
    with pytest.raises(VehicleError, match=r"shapes \(2, 3\) and \(2, 1\) do not fit"):
        zero_order_hold(np.zeros((2, 3)), np.zeros((2, 1)), 0.1)
    with pytest.raises(VehicleError, match=r"period is -0\.1 s, it must not be negative"):
        van_loan(np.zeros((2, 2)), np.zeros((2, 2)), -0.1)
