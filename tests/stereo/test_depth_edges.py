"""Depth edges on maps whose half-occlusions follow from geometry."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from polemap.stereo.depth_edges import depth_edges, upright_maps
from polemap.stereo.matching import DisparityPair

_HEIGHT, _WIDTH = 20, 200


def _bar(near: int, far: int, first: int, last: int) -> DisparityPair:
    """A bar of columns first..last before a background, and the band that each view lacks."""
    left = np.full((_HEIGHT, _WIDTH), float(far), dtype=np.float32)
    left[:, :far] = np.nan
    left[:, first : last + 1] = near
    left[:, max(0, first - (near - far)) : first] = np.nan
    right = np.full((_HEIGHT, _WIDTH), float(far), dtype=np.float32)
    right[:, _WIDTH - far :] = np.nan
    right[:, first - near : last + 1 - near] = near
    right[:, last + 1 - near : last + 1 - far] = np.nan
    return DisparityPair(left, right)


@given(near=st.integers(12, 40), far=st.integers(2, 9), width=st.integers(3, 30))
@settings(max_examples=60, deadline=None)
def test_flanks_of_a_bar_are_where_they_are(near: int, far: int, width: int) -> None:
    first, last = 90, 90 + width - 1
    left, right = depth_edges(upright_maps(_bar(near, far, first, last), 2), 1.0, 0.0)
    assert set(left.row_px) == set(range(0, _HEIGHT, 2))
    assert (left.column_px[left.occluding] == first).all()
    assert (right.column_px[right.occluding] == last).all()
    assert np.count_nonzero(left.occluding) == np.count_nonzero(right.occluding) == _HEIGHT // 2
    for edges in (left, right):
        assert (edges.near_px == near).all()
        assert (edges.far_px == far).all()
        # the other view shows the jump without a band, in the same column
        assert np.isin(edges.column_px, (first, last)).all()
        assert (np.diff(edges.row_px * 1000.0 + edges.column_px) >= 0).all()


def test_a_hole_wider_than_the_jump_is_no_edge() -> None:
    left = np.full((_HEIGHT, _WIDTH), 20.0, dtype=np.float32)
    left[:, :100] = 14.0
    left[:, 60:100] = np.nan  # a jump of 6 leaves a band of 6, not of 40
    empty = np.full_like(left, np.nan)
    edges, _ = depth_edges(upright_maps(DisparityPair(left, empty), 1), 1.0, 0.0)
    assert len(edges) == 0


def test_a_slanted_surface_has_no_edges() -> None:
    ramp = np.tile(np.linspace(10, 60, _WIDTH, dtype=np.float32), (_HEIGHT, 1))
    left, right = depth_edges(upright_maps(DisparityPair(ramp, ramp), 1), 1.0, 0.0)
    assert len(left) == len(right) == 0


def test_small_depth_jumps_count_by_metres() -> None:
    maps = upright_maps(_bar(30, 25, 90, 99), 1)
    per_metre = 1.0 / 400.0  # 400 px m: disparities 30 and 25 are 2.7 m apart
    assert len(depth_edges(maps, 1.0, 2.0 * per_metre)[0])
    assert not len(depth_edges(maps, 1.0, 3.0 * per_metre)[0])


def test_specks_vanish_and_pinholes_close() -> None:
    rng = np.random.default_rng(2)
    flat: NDArray[np.float32] = np.full((60, 100), 12.0, dtype=np.float32)
    speckled = flat.copy()
    rows, columns = rng.integers(1, 59, 40), rng.permutation(100)[:40]  # one a column
    speckled[rows, columns] = np.where(np.arange(40) % 2, 50.0, np.nan)
    cleaned = upright_maps(DisparityPair(speckled, flat), 1)
    assert (cleaned.left[1:-1] == 12.0).all()
    left, right = depth_edges(cleaned, 1.0, 0.0)
    inner = [np.count_nonzero((e.row_px > 0) & (e.row_px < 59)) for e in (left, right)]
    assert inner == [0, 0]
