"""The C++ kernel of corners against the plain way, on walls that are drawn here."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
import pytest

from polemap.detect import corner_edges, corner_surface
from polemap.detect.config import DetectionConfig
from polemap.detect.constants import STEP_MIN_M, STEP_MIN_PX
from polemap.detect.ground import fit_ground
from polemap.extras import kernel
from polemap.stereo.depth_edges import depth_edges, upright_maps
from polemap.stereo.matching import DisparityPair
from tests.polemap.detect.test_corners import WALL_ENDS, Wall, matched_maps
from tests.polemap.street import RIG

NATIVE = kernel("polemap.detect.native.corners_kernel")
pytestmark = pytest.mark.skipif(NATIVE is None, reason="the kernel is not built")

_STREET = [wall for wall, _ in WALL_ENDS[::2]] + [Wall((9.0, -2.0), (9.1, -2.2), 3.0)]


def _maps(walls: list[Wall], seed: int) -> DisparityPair:
    """With holes and streaks, so that no sample is sure to be there."""
    rng = np.random.default_rng([seed, 5])
    pair = matched_maps(walls, seed, noise_px=0.6)
    holes = np.kron(rng.uniform(size=(80, 120)) < 0.15, np.ones((6, 7), dtype=bool))
    holes = holes[: RIG.height_px, : RIG.width_px]
    left = np.where(holes[: pair.left.shape[0], : pair.left.shape[1]], np.nan, pair.left)
    return DisparityPair(left.astype(np.float32), pair.right)


@pytest.mark.parametrize("seed", range(4))
def test_the_kernel_says_what_the_plain_way_says(
    seed: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = DetectionConfig()
    maps = upright_maps(_maps(_STREET, seed), config.row_step_px)
    ground = fit_ground(maps, RIG)
    sides = depth_edges(maps, STEP_MIN_PX, STEP_MIN_M / (RIG.focal_px * RIG.baseline_m))
    fast = corner_edges.find_upright_edges(sides, ground, RIG, config)
    walls = corner_surface.sample_walls(fast, fast.column_px, maps, ground, RIG)
    plain_walls = corner_surface.plain_walls(fast, fast.column_px, maps, ground, RIG)
    monkeypatch.setattr(corner_edges, "kernel", lambda name: None)
    plain = corner_edges.find_upright_edges(sides, ground, RIG, config)
    assert len(plain) >= 3
    for one, two in ((plain, fast), (plain_walls, walls)):
        for field in fields(one):
            np.testing.assert_allclose(
                getattr(two, field.name), getattr(one, field.name), rtol=1e-9, atol=1e-9,
                err_msg=field.name,
            )  # fmt: skip
