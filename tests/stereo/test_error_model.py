"""The error model: its tables, and recorded truth."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from polemap.stereo.error_model import (
    OUTLIER_PX,
    DisparityErrorModel,
    texture,
)
from polemap.stereo.errors import StereoError


@given(st.floats(0, 300), st.floats(0, 255))
def test_between_the_grids_the_table_is_not_left(grey, margin):
    model = DisparityErrorModel()
    sd = float(model.sd_px(grey, margin))
    assert model.sd_px_table.min() - 1e-12 <= sd <= model.sd_px_table.max() + 1e-12


def test_the_table_is_met_on_its_grid():
    model = DisparityErrorModel()
    t, m = np.meshgrid(model.texture_grid, model.margin_grid, indexing="ij")
    np.testing.assert_allclose(model.sd_px(t, m), model.sd_px_table)


def test_texture_is_the_slope_of_a_ramp_in_8_bit_grey():
    ramp = np.tile(np.arange(0, 120, 3), (30, 1))
    inner = (slice(5, -5), slice(5, -5))
    np.testing.assert_allclose(texture(ramp.astype(np.uint8))[inner], 3.0)
    np.testing.assert_allclose(texture((16 * ramp).astype(np.uint16), bits=12)[inner], 3.0)


def test_a_broken_table_is_refused():
    with pytest.raises(StereoError, match="table of that shape"):
        DisparityErrorModel(margin_grid=np.array([1.0, 2.0]))
    with pytest.raises(StereoError, match="ascend"):
        DisparityErrorModel(margin_grid=DisparityErrorModel().margin_grid[::-1].copy())
    with pytest.raises(StereoError, match="positive"):
        DisparityErrorModel(sd_px_table=0 * DisparityErrorModel().sd_px_table)


def test_recorded_errors_are_as_large_as_the_model_says(held_out_pairs):
    model = DisparityErrorModel()
    squares = []
    for one in held_out_pairs:
        grey, margin = texture(one.left)[one.known], one.pair.left_margin[one.known]
        inlier = one.error_px < OUTLIER_PX
        squares.append((one.error_px / model.sd_px(grey, margin))[inlier] ** 2)
    # errors within a frame hang together, so pairs count rather than pixels: a factor of 1.3
    assert 1 / 1.3 < np.sqrt(np.concatenate(squares).mean()) < 1.3
