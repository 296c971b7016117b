"""The error model: tables, first-order covariances against sampling, and recorded truth."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from polemap.stereo.error_model import (
    OUTLIER_PX,
    DisparityErrorModel,
    ground_covariance_m2,
    range_sd_m,
    texture,
)
from polemap.stereo.errors import StereoError
from polemap.stereo.rig import Mounting, StereoRig

RIG = StereoRig(768, 480, 820.0, 383.5, 239.5, 0.3, Mounting(1.9, 0.15, 1.3, 0.01, 0.03, -0.1))


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


@given(st.floats(-300, 300), st.floats(-150, 150), st.floats(8, 60))
def test_covariance_equals_finite_differences(u, v, d):
    centre = np.array([RIG.cx_px + u, RIG.cy_px + v, d])

    def ground(place):
        return RIG.vehicle_points(RIG.camera_points(*place))[:2]

    steps = []
    for k, sd in ((2, 0.7), (0, 0.4)):
        move = np.zeros(3)
        move[k] = 1e-4
        steps.append((ground(centre + move) - ground(centre - move)) / 2e-4 * sd)
    expected = sum(np.outer(step, step) for step in steps)
    got = ground_covariance_m2(RIG, *centre, 0.7, 0.4)
    np.testing.assert_allclose(got, expected, rtol=1e-5, atol=1e-9)
    assert (np.linalg.eigvalsh(got) > 0).all()


def test_range_grows_with_the_square_of_depth():
    near, far = range_sd_m(RIG, np.array([20.0, 10.0]), np.array([0.5, 0.5]))
    assert far == pytest.approx(4 * near)
    assert near == pytest.approx(12.3**2 / (820 * 0.3) * 0.5)


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
