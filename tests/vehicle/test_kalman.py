import math
import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import chi2

from polemap.vehicle.errors import VehicleError
from polemap.vehicle.kalman import (
    angle_residual,
    chi_square_gate,
    chi_square_quantile,
    innovate,
    is_covariance,
    joseph_update,
    normalized_error,
    predict,
)


def random_covariance(rng, size):
    root = rng.normal(size=(size, size))
    return root @ root.T + 0.1 * np.eye(size)


@given(st.integers(0, 10_000), st.integers(1, 6), st.integers(1, 4))
def test_an_update_equals_the_information_form(seed, n, m):
    rng = np.random.default_rng(seed)
    p, r = random_covariance(rng, n), random_covariance(rng, m)
    h, x, z = rng.normal(size=(m, n)), rng.normal(size=n), rng.normal(size=m)
    innovation = innovate(z - h @ x, p, h, r)
    state, covariance = joseph_update(x, p, innovation, h, r)
    information = np.linalg.inv(p) + h.T @ np.linalg.inv(r) @ h
    expected = np.linalg.solve(information, np.linalg.solve(p, x) + h.T @ np.linalg.solve(r, z))
    assert np.allclose(covariance, np.linalg.inv(information), atol=1e-8)
    assert np.allclose(state, expected, atol=1e-7)
    assert is_covariance(covariance)
    residual = z - h @ x
    assert innovation.nis == pytest.approx(
        residual @ np.linalg.inv(h @ p @ h.T + r) @ residual, rel=1e-8
    )


def test_joseph_form_stays_positive_definite_where_the_short_form_fails():
    p = np.diag([1e12, 1.0])
    h, r = np.array([[1.0, 1e-3]]), np.array([[1e-10]])
    innovation = innovate(np.array([0.5]), p, h, r)
    _, covariance = joseph_update(np.zeros(2), p, innovation, h, r)
    assert np.linalg.eigvalsh(covariance).min() > -1e-12


def test_prediction_is_symmetric_to_the_last_bit():
    rng = np.random.default_rng(3)
    p, q, f = random_covariance(rng, 5), random_covariance(rng, 5), rng.normal(size=(5, 5))
    predicted = predict(p, f, q)
    assert np.array_equal(predicted, predicted.T)
    assert np.allclose(predicted, f @ p @ f.T + q)


def test_angles_are_wrapped_before_the_gate():
    near, far = np.array([0.0, math.pi - 0.01]), np.array([0.0, -math.pi + 0.01])
    residual = angle_residual(far, near, angle_rows=(1,))
    assert residual[1] == pytest.approx(0.02)
    assert angle_residual(far, near)[1] == pytest.approx(0.02 - 2 * math.pi)


@pytest.mark.parametrize("dof", [1, 2, 3, 5])
@pytest.mark.parametrize("probability", [0.9, 0.99, 0.999])
def test_the_gate_keeps_its_probability_on_the_squared_distance(dof, probability):
    rng = np.random.default_rng(dof)
    n = 40_000
    squared = (rng.normal(size=(n, dof)) ** 2).sum(axis=1)
    inside = (squared <= chi_square_gate(probability, dof)).mean()
    sd = math.sqrt(probability * (1 - probability) / n)
    assert abs(inside - probability) < 4 * sd


def test_nis_of_true_measurements_follows_chi_square():
    rng = np.random.default_rng(11)
    p, r, h = random_covariance(rng, 4), random_covariance(rng, 2), rng.normal(size=(2, 4))
    n = 4000
    errors = rng.multivariate_normal(np.zeros(4), p, n) @ h.T
    residuals = errors + rng.multivariate_normal(np.zeros(2), r, n)
    mean = np.mean([innovate(residual, p, h, r).nis for residual in residuals])
    assert abs(mean - 2.0) < 4 * math.sqrt(2 * 2 / n)


def test_bad_gates_are_refused():
    with pytest.raises(VehicleError, match=r"probability is 1\.0, it must lie between 0 and 1"):
        chi_square_gate(1.0, 3)
    with pytest.raises(VehicleError, match="at least 1 degree of freedom, not 0"):
        chi_square_gate(0.9, 0)


def test_a_measurement_covariance_that_is_not_one_is_refused():
    with pytest.raises(VehicleError, match="innovation covariance is not positive definite"):
        innovate(np.zeros(2), np.eye(2), np.eye(2), -2.0 * np.eye(2))


@pytest.mark.parametrize(
    "matrix",
    [
        np.full((2, 2), np.nan),
        np.ones((2, 3)),
        np.array([[1.0, 0.5], [0.2, 1.0]]),
        np.array([[1.0, 2.0], [2.0, 1.0]]),
        np.zeros((2, 2)),
    ],
)
def test_what_is_no_covariance_is_recognised(matrix):
    assert not is_covariance(matrix)


def test_normalized_error_of_unusable_input_is_nan():
    assert normalized_error(np.array([3.0, 4.0]), np.eye(2)) == 25.0
    assert math.isnan(normalized_error(np.array([np.nan, 0.0]), np.eye(2)))
    assert math.isnan(normalized_error(np.ones(2), np.zeros((2, 2))))


@pytest.mark.parametrize("dof", [1, 2, 3, 5, 2.5, 17.3, 400.0])
def test_the_quantile_is_that_of_scipy(dof: float) -> None:
    for probability in (0.001, 0.025, 0.5, 0.9, 0.975, 0.9999):
        assert chi_square_quantile(probability, dof) == chi2.ppf(probability, dof)


def test_the_localizer_does_not_wait_for_scipy_stats() -> None:
    text = "import sys, polemap.localize.localizer; print('scipy.stats' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", text], capture_output=True, text=True, check=True)
    assert done.stdout == "False\n"
