"""Slices and hypotheses against the plain way: one flank, one group after the other."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from polemap.detect import hypotheses, slices
from polemap.detect.config import DetectionConfig
from polemap.detect.slices import Slices, find_slices
from polemap.stereo.depth_edges import DepthEdges
from tests.polemap.street import RIG

CONFIG = DetectionConfig()


def _flanks(rng: np.random.Generator, n: int, rows: int) -> DepthEdges:
    row, column = rng.integers(0, rows, n), rng.uniform(0, 60, n).round(1)
    order = np.lexsort((column, row))
    near = rng.choice([9.0, 20.0, 21.0, 40.0], n)
    return DepthEdges(
        row[order].astype(np.int32),
        column[order].astype(np.float32),
        (near + rng.normal(0, 0.3, n)).astype(np.float32),
        rng.uniform(1, 8, n).astype(np.float32),
        rng.random(n) < 0.5,
    )


@given(seed=st.integers(0), n=st.integers(0, 60), m=st.integers(0, 60), rows=st.integers(1, 8))
@settings(max_examples=100, deadline=None)
def test_a_left_flank_takes_the_first_right_one_of_its_disparity(
    seed: int, n: int, m: int, rows: int
) -> None:
    rng = np.random.default_rng(seed)
    left, right = _flanks(rng, n, rows), _flanks(rng, m, rows)
    expected = []
    for row, column, near in zip(left.row_px, left.column_px, left.near_px, strict=True):
        beyond = np.flatnonzero((right.row_px == row) & (right.column_px >= column - 0.5))
        for at in beyond[: slices._RANKS]:
            width = right.column_px[at] - column + np.float32(1.0)
            wide = width * RIG.baseline_m / near > 1.3 * CONFIG.width_max_m
            if not wide and abs(right.near_px[at] - near) <= 1.0 + 0.04 * near:
                depth = RIG.focal_px * RIG.baseline_m / (0.5 * float(near + right.near_px[at]))
                if 0.8 * CONFIG.range_min_m <= depth <= 1.1 * CONFIG.range_max_m:
                    expected.append((row, column, right.column_px[at], right.far_px[at]))
                break
    found = find_slices(left, right, RIG, CONFIG)
    got = zip(found.row_px, found.left_px, found.right_px, found.far_right_px, strict=True)
    assert list(got) == expected


def _line(
    rows: np.ndarray, centre: np.ndarray, width: np.ndarray, depth: np.ndarray
) -> dict[str, float]:
    """Centre line, mean width and scatter of one group, outliers left out twice."""
    inlier = np.ones(len(rows), dtype=bool)
    for sweep in range(3):
        row0, column0 = rows[inlier].mean(), centre[inlier].mean()
        down = rows - row0
        spread = np.sum(down[inlier] ** 2)
        slope = np.sum(down[inlier] * centre[inlier]) / max(spread, 1.0) * spread / (spread + 200)
        off = centre - column0 - slope * down
        aside = width - width[inlier].mean()
        if sweep < 2:
            limits = [2.0 * np.sqrt(np.mean(v[inlier] ** 2)) + 0.6 for v in (off, aside)]
            inlier = (np.abs(off) <= limits[0]) & (np.abs(aside) <= limits[1])
    return {
        "column_px": column0,
        "row_px": row0,
        "slope": slope,
        "width_px": width[inlier].mean(),
        "top_px": rows[inlier].min(),
        "bottom_px": rows[inlier].max(),
        "slices": inlier.sum(),
        "centre_sd_px": np.sqrt(np.mean(off[inlier] ** 2)),
        "disparity_px": depth[inlier].mean(),
        "disparity_sd_px": depth[inlier].std(),
    }


@pytest.mark.parametrize("seed", range(5))
def test_all_groups_at_once_are_fitted_as_one_after_the_other(seed: int) -> None:
    rng = np.random.default_rng(seed)
    n, count = 400, 12
    label = rng.integers(-1, count, n)
    label[:count] = np.arange(count)
    row = rng.integers(0, 120, n).astype(float)
    centre = 40.0 * label + rng.normal(0, 0.1, n) * row + rng.normal(0, 1.0, n)
    centre += np.where(rng.random(n) < 0.1, 15.0, 0.0)
    width, depth = rng.integers(4, 9, n).astype(float), rng.normal(20.0, 0.5, n)
    beside = rng.uniform(0, 1, (4, n))
    slices = Slices(row, centre - 0.5 * width, centre + 0.5 * width - 1.0, depth, *beside)
    fitted = hypotheses._fit(slices, label, count)
    for group in range(count):
        members = label == group
        one = _line(row[members], centre[members] - 0.5, width[members], depth[members])
        for name, value in one.items():
            assert getattr(fitted, name)[group] == pytest.approx(value, rel=1e-9, abs=1e-9), name
