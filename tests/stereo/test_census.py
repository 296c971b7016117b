"""Census and rank transforms against their definition, pixel by pixel."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from polemap.stereo.census import census_pairs, census_planes, partial_ranks, rank_transform


def at(image, v, u):
    height, width = image.shape
    return int(image[min(max(v, 0), height - 1), min(max(u, 0), width - 1)])


@pytest.mark.parametrize("kind", ["centre5x5", "symmetric7x7"])
def test_every_bit_is_its_comparison(kind):
    image = np.random.default_rng(0).integers(0, 9, (6, 7)).astype(np.uint16)
    planes = census_planes(image, kind)
    pairs = census_pairs(kind)
    assert len(set(pairs)) == 24
    for v in range(6):
        for u in range(7):
            for k, (dv, du, other_dv, other_du) in enumerate(pairs):
                darker = at(image, v + dv, u + du) < at(image, v + other_dv, u + other_du)
                assert (planes[k // 8, v, u] >> (k % 8)) & 1 == darker


@given(st.integers(0, 2**31))
def test_only_the_order_of_grey_values_counts(seed):
    image = np.random.default_rng(seed).integers(0, 200, (8, 9)).astype(np.uint16)
    for kind in ("centre5x5", "symmetric7x7"):
        np.testing.assert_array_equal(census_planes(image, kind), census_planes(image**2, kind))
    np.testing.assert_array_equal(rank_transform(image, 3), rank_transform(image**2, 3))
    np.testing.assert_array_equal(partial_ranks(image), partial_ranks(image**2))


def test_ranks_span_the_bytes():
    image = np.zeros((15, 15), np.uint8)
    image[7, 7] = 9
    assert rank_transform(image, 3)[7, 7] == 255
    assert rank_transform(image, 3)[0, 0] == 0
    assert partial_ranks(image)[7, 7].tolist() == [255, 255, 255]
