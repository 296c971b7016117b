"""Connected components against scipy's."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from polemap.detect.hypotheses import components


@given(n=st.integers(1, 200), share=st.floats(0.0, 2.5), near=st.booleans(), seed=st.integers(0))
@settings(max_examples=200, deadline=None)
def test_labels_are_those_of_scipy(n: int, share: float, near: bool, seed: int) -> None:
    rng = np.random.default_rng(seed)
    one = rng.integers(0, n, int(share * n))
    # long chains, as the slices of a candidate are, or links between anything
    two = np.clip(one + rng.integers(-3, 4, len(one)), 0, n - 1) if near else rng.permutation(one)
    label, count = components(n, one, two)
    graph = coo_matrix((np.ones(len(one)), (one, two)), shape=(n, n))
    true_count, true_label = connected_components(graph, directed=False)
    assert count == true_count
    assert np.array_equal(label, true_label)


def test_a_chain_in_any_order_is_one_component() -> None:
    chain = np.random.default_rng(3).permutation(999)
    label, count = components(1000, chain, chain + 1)
    assert count == 1
    assert not label.any()


def test_without_nodes_there_is_nothing() -> None:
    nothing = np.empty(0, dtype=np.int64)
    label, count = components(0, nothing, nothing)
    assert (len(label), count) == (0, 0)
