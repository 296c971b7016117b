"""Assignment: the kernel against scipy, on random and on degenerate problems."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import linear_sum_assignment

from polemap.localize.particle_filter import assignment
from polemap.localize.particle_filter.assignment import assign

needs_kernel = pytest.mark.skipif(
    not assignment.HAVE_KERNEL, reason="the assignment kernel was not built here"
)


@st.composite
def problems(draw: st.DrawFn) -> tuple[np.ndarray, np.ndarray]:
    """Costs with ties, forbidden pairs and empty sides; prices that may be infinite."""
    rows, columns = draw(st.integers(0, 6)), draw(st.integers(0, 7))
    value = st.one_of(
        st.integers(-3, 3).map(float),
        st.floats(-10, 10, allow_nan=False),
        st.just(float("inf")),
    )
    costs = draw(st.lists(value, min_size=rows * columns, max_size=rows * columns))
    price = st.one_of(st.floats(-5, 5, allow_nan=False), st.just(0.0), st.just(float("inf")))
    unassigned = draw(st.lists(price, min_size=rows, max_size=rows))
    return np.array(costs).reshape(1, rows, columns), np.array(unassigned).reshape(1, rows)


@needs_kernel
@settings(max_examples=400, deadline=None)
@given(problems())
def test_kernel_has_the_least_total_cost(problem: tuple[np.ndarray, np.ndarray]) -> None:
    costs, unassigned = problem
    try:
        expected, _ = assign(costs, unassigned, backend="scipy")
    except ValueError:
        with pytest.raises(ValueError, match="problem 0 has no assignment of finite cost"):
            assign(costs, unassigned, backend="native")
        return
    total, match = assign(costs, unassigned, backend="native")
    assert total == pytest.approx(expected, abs=1e-9)
    chosen = match[0][match[0] >= 0]
    assert len(np.unique(chosen)) == len(chosen)
    paid = sum(
        costs[0, i, j] if j >= 0 else unassigned[0, i] for i, j in enumerate(match[0].tolist())
    )
    assert paid == pytest.approx(expected[0], abs=1e-9)


@needs_kernel
def test_kernel_equals_scipy_on_dense_problems_of_many_sizes() -> None:
    rng = np.random.default_rng(0)
    for rows, columns in ((1, 30), (30, 1), (12, 12), (20, 35), (35, 20)):
        costs = rng.normal(size=(40, rows, columns))
        # integers make ties
        costs[20:] = np.round(3 * costs[20:])
        unassigned = rng.normal(0.5, 1.0, (40, rows))
        total, _ = assign(costs, unassigned, backend="native")
        expected, _ = assign(costs, unassigned, backend="scipy")
        np.testing.assert_allclose(total, expected, atol=1e-9)


@pytest.mark.parametrize("backend", ["scipy", pytest.param("native", marks=needs_kernel)])
def test_without_a_way_out_the_classic_assignment_comes_back(backend: str) -> None:
    costs = np.random.default_rng(1).normal(size=(7, 9))
    total, match = assign(costs, np.inf, backend=backend)
    row, column = linear_sum_assignment(costs)
    assert total == pytest.approx(costs[row, column].sum())
    np.testing.assert_array_equal(match, column)


@pytest.mark.parametrize("backend", ["scipy", pytest.param("native", marks=needs_kernel)])
@pytest.mark.parametrize("bad", [np.nan, -np.inf])
def test_values_without_meaning_are_refused(backend: str, bad: float) -> None:
    costs = np.zeros((2, 3, 3))
    costs[1, 2, 0] = bad
    with pytest.raises(ValueError, match="problem 1 has a cost that is NaN or minus infinity"):
        assign(costs, 0.5, backend=backend)
    with pytest.raises(ValueError, match=r"costs has 4 axes"):
        assign(np.zeros((1, 1, 1, 1)), 0.0, backend=backend)


def test_missing_kernel_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(assignment, "HAVE_KERNEL", False)
    total, match = assign(np.array([[1.0, 0.0]]), 2.0)
    assert (total, match.tolist()) == (0.0, [1])
    with pytest.raises(ValueError, match="kernel was not built"):
        assign(np.zeros((1, 1)), 0.0, backend="native")
