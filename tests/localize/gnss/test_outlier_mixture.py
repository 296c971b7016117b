"""Antenna, noise and outliers of a GNSS receiver."""

from __future__ import annotations

import math

import numpy as np
import pytest

from polemap.localize.config import GnssConfig
from polemap.localize.gnss.outlier_mixture import GnssReceiver
from polemap.vehicle.pose import compose, transform_points

RECEIVER = GnssReceiver((1.2, -0.4), GnssConfig(sd_m=3.0))


def test_the_antenna_stands_where_the_pose_puts_it() -> None:
    pose, moved = np.array([10.0, 20.0, 0.7]), np.array([3.0, -0.5, 0.2])
    lever_arm = np.array([1.2, -0.4])
    expected = transform_points(compose(pose, moved), lever_arm)
    found = RECEIVER.positions(pose[np.newaxis], moved)[0]
    np.testing.assert_allclose(found, expected, atol=1e-12)
    at = transform_points(pose, lever_arm)
    east, north = RECEIVER.residual((10.0, 20.0, 0.7), at[0] + 1.0, at[1] - 2.0)
    assert (east, north) == pytest.approx((1.0, -2.0))


def test_hdop_scales_the_error_down_to_its_floor() -> None:
    assert RECEIVER.sd_m(2.0) == 6.0
    assert RECEIVER.sd_m(0.1) == RECEIVER.sd_m(0.5) == 1.5


def test_an_outlier_says_hardly_anything() -> None:
    near = RECEIVER.mixture(np.array([0.0, 1.0, 4.0]))
    np.testing.assert_allclose(near - near[0], [0.0, -0.5, -2.0], atol=3e-3)
    far = RECEIVER.mixture(np.array([20.0**2, 21.0**2]))
    assert -0.1 < far[1] - far[0] < 0.0
    here = (0.0, 0.0, 0.0)
    at = RECEIVER.evidence(here, 1.2, -0.4, 2.0)
    assert at == pytest.approx(math.log(1.02))
    assert RECEIVER.evidence(here, 500.0, 0.0, 2.0) == pytest.approx(math.log(0.02))
