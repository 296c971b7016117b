from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from polemap.localize.particle_filter.pole_adjustment import Sightings, solve

Floats = NDArray[np.float64]


def sightings(seed: int, n: int = 60, poles: int = 7, columns: int = 5) -> Sightings:
    rng = np.random.default_rng(seed)
    member = np.zeros((poles, n))
    # the last pole is seen by none
    member[rng.integers(poles - 1, size=n), np.arange(n)] = 1.0
    target = rng.normal(size=(n, 2))
    target[::9] *= 20.0
    return Sightings.of(
        rng.normal(size=(n, 2, columns)), rng.normal(size=(n, 2, 2)), member, target,
        rng.uniform(0.2, 1.0, n),
    )  # fmt: skip


def dense(seen: Sightings, prior: Floats) -> tuple[Floats, Floats, Floats, Floats]:
    """All columns at once: values, covariance, weights and residuals."""
    own = np.einsum("pn,nab->napb", seen.member, seen.place).reshape(len(seen), 2, -1)
    design = np.concatenate([seen.common, own], axis=2)
    weight = np.ones(len(seen))
    for _ in range(3):
        weighted = (design * (seen.share * weight)[:, None, None]).reshape(-1, design.shape[2])
        information = weighted.T @ design.reshape(weighted.shape) + np.diag(prior)
        covariance = np.linalg.inv(information)
        values = covariance @ (weighted.T @ seen.target.ravel())
        rest = seen.target - design @ values
        weight = np.minimum(1.0, 2.5 / np.hypot(*rest.T))
    return values, covariance, seen.share * weight, rest


@pytest.mark.parametrize("seed", range(4))
def test_the_poles_eliminated_solve_as_all_columns_at_once(seed: int) -> None:
    seen = sightings(seed)
    prior, place_prior = np.full(5, 0.3), np.linspace(1.0, 400.0, 7)
    solved = solve(seen, prior, place_prior)
    all_prior = np.append(prior, np.repeat(place_prior, 2))
    values, covariance, weight, rest = dense(seen, all_prior)
    np.testing.assert_allclose(solved.values, values[:5], rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(solved.covariance, covariance[:5, :5], rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(solved.weight, weight, rtol=1e-9)
    np.testing.assert_allclose(solved.rest, rest, rtol=1e-8, atol=1e-10)
    # the far ones pull less
    assert solved.weight[::9].max() < 0.5
    factors = np.random.default_rng(seed).normal(size=(3, 5 + 14))
    variance = solved.variance_of(factors[:, :5], factors[:, 5:].reshape(3, 7, 2))
    np.testing.assert_allclose(
        variance, np.einsum("ki,ij,kj->k", factors, covariance, factors), rtol=1e-9
    )


def test_rows_and_further_columns() -> None:
    seen = sightings(5)
    kept = np.arange(len(seen)) % 3 > 0
    column = np.random.default_rng(6).normal(size=(len(seen), 2))
    more = seen.with_columns(column).rows(kept)
    assert len(more) == np.count_nonzero(kept)
    np.testing.assert_array_equal(more.common[:, :, -1], column[kept])
    np.testing.assert_array_equal(more.common[:, :, :-1], seen.common[kept])
