"""Depth edges against the plain way: all matched pixels in one row after the other, compared."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

import polemap.stereo.depth_edges as fast
from polemap.stereo.depth_edges import DepthEdges, UprightMaps, depth_edges, upright_maps
from polemap.stereo.matching import DisparityPair

Floats = NDArray[np.float32]


def _plain_median(disparity: Floats, step: int) -> Floats:
    thin = np.nan_to_num(disparity[::step], nan=0.0)
    median = thin.copy()
    if len(thin) > 2:
        median[1:-1] = np.median(np.stack([thin[:-2], thin[1:-1], thin[2:]]), axis=0)
    return median


def _plain_jumps(
    disparity: Floats, toward_right: bool, step_min: float, depth: float
) -> tuple[Any, ...]:
    flat, width = disparity.ravel(), disparity.shape[1]
    position = np.flatnonzero(flat > 0)
    value = flat[position]
    step = np.diff(value)
    at = np.flatnonzero(step <= -step_min if toward_right else step >= step_min)
    near_at, far_at = (at, at + 1) if toward_right else (at + 1, at)
    near, far = value[near_at], value[far_at]
    gap, jump = position[at + 1] - position[at] - 1, near - far
    row = position[near_at] // width
    inward = 1 if not toward_right else -1
    last = len(value) - 1
    good = (row == position[far_at] // width) & (jump >= depth * near * far)
    good &= gap <= 2.0 * jump + 4.0
    beyond = value[np.clip(near_at + inward, 0, last)]
    good &= np.abs(beyond - near) <= 1.0 + 0.03 * near
    good &= value[np.clip(far_at - inward, 0, last)] <= near - 0.5 * jump
    band = (gap >= np.maximum(1.0, 0.4 * jump))[good]
    column = (position[near_at] - row * width)[good].astype(np.float32)
    return row[good].astype(np.int32), column, near[good], far[good], band


def _plain_edges(maps: UprightMaps, step_min: float, depth: float) -> tuple[DepthEdges, DepthEdges]:
    sides = []
    for toward_right in (False, True):
        own, other = (maps.right, maps.left) if toward_right else (maps.left, maps.right)
        seen = _plain_jumps(own, toward_right, step_min, depth)
        bare = _plain_jumps(other, toward_right, step_min, depth)
        moved = (seen if toward_right else bare)[2]
        columns = (seen[1] + moved, bare[1]) if toward_right else (seen[1], bare[1] + moved)
        row, column = np.concatenate([seen[0], bare[0]]), np.concatenate(columns)
        near, far = (np.concatenate([seen[k], bare[k]]) for k in (2, 3))
        occluding = np.concatenate([seen[4], np.zeros(len(bare[0]), dtype=bool)])
        order = np.argsort(row * np.float64(1 << 20) + column, kind="stable")
        row = (row[order] * maps.row_step_px).astype(np.int32)
        sides.append(DepthEdges(row, column[order], near[order], far[order], occluding[order]))
    return sides[0], sides[1]


def _scene(rng: np.random.Generator, height: int, width: int, holes: float) -> Floats:
    """Random surfaces side by side with steps, slopes, specks and holes, some of them long."""
    ends = rng.random((height, width)) < rng.uniform(0.02, 0.4)
    level = np.cumsum(ends * rng.normal(0.0, 4.0, (height, width)), axis=1)
    scene = np.abs(level) + rng.uniform(0.0, 0.5, (height, width)) + 0.3
    missing = rng.random((height, width)) < holes
    missing |= np.cumsum(rng.random((height, width)) < 0.03, axis=1) % 3 == 0
    return np.where(missing & (holes > 0), np.nan, scene).astype(np.float32)


@given(
    seed=st.integers(0, 10**6),
    height=st.integers(1, 40),
    width=st.integers(1, 60),
    holes=st.sampled_from([0.0, 0.05, 0.4, 0.97]),
    step=st.integers(1, 4),
    strip=st.sampled_from([2, 7, 64, 30_000]),
)
@settings(max_examples=150, deadline=None)
def test_strips_and_breaks_find_what_the_plain_way_finds(
    seed: int, height: int, width: int, holes: float, step: int, strip: int
) -> None:
    rng = np.random.default_rng(seed)
    scenes = [_scene(rng, height, width, holes) for _ in range(2)]
    pair = DisparityPair(scenes[0], scenes[1])
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(fast, "_STRIP_ROWS", max(1, strip // 4))
        patch.setattr(fast, "_STRIP_PIXELS", strip)
        maps = upright_maps(pair, step)
        found = depth_edges(maps, 0.8, 0.002)
    for view, disparity in ((maps.left, pair.left), (maps.right, pair.right)):
        assert np.array_equal(view, _plain_median(disparity, step))
    for one, two in zip(found, _plain_edges(maps, 0.8, 0.002), strict=True):
        for name in DepthEdges.__slots__:
            quick, plain = getattr(one, name), getattr(two, name)
            assert quick.dtype == plain.dtype
            assert np.array_equal(quick, plain), name
