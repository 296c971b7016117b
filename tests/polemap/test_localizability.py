"""The bound against a least-squares fit that reaches it, and what thin maps do."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from drivelog.samples import VisibleRegion
from polemap.landmark_map import PoleMap
from polemap.localizability import localizability, sensor_covariance
from stereo.rig import StereoRig
from tests.polemap.test_map_io import LOCAL, make_map

VIEW = VisibleRegion(np.array([0.0, 0.0]), -0.7, 0.7, 1.0, np.array([40.0]))
RIG = StereoRig(1242, 375, 720.0, 610.0, 173.0, 0.54)


def poles(points: list[tuple[float, float]]) -> PoleMap:
    n = len(points)
    return replace(
        make_map(LOCAL, n),
        points_m=np.array(points),
        covariance_m2=np.tile(np.eye(2) * 1e-4, (n, 1, 1)),
        existence=np.ones(n),
        _tree=None,
    )


def test_the_bound_is_reached_by_least_squares() -> None:
    """2000 noisy looks at five poles, each solved for the pose; sd within its sampling error."""
    points = [(10.0, 4.0), (15.0, -5.0), (22.0, 6.0), (30.0, -4.0), (12.0, -3.0)]
    pole_map = poles(points)
    bound = localizability(pole_map, np.zeros((1, 3)), VIEW, rig=RIG, detection=1.0)
    rng = np.random.default_rng(0)
    true = np.array(points)
    spread = sensor_covariance(true, RIG) + 1e-4 * np.eye(2)
    root = np.linalg.cholesky(spread)
    weight = np.linalg.inv(spread)
    jacobian = np.zeros((5, 2, 3))
    jacobian[:, 0, 0] = jacobian[:, 1, 1] = -1.0
    jacobian[:, 0, 2], jacobian[:, 1, 2] = true[:, 1], -true[:, 0]
    normal = np.einsum("nij,nik,nkl->jl", jacobian, weight, jacobian)
    noise = np.einsum("nij,knj->kni", root, rng.standard_normal((2000, 5, 2)))
    fits = np.linalg.solve(normal, np.einsum("nij,nil,knl->jk",
                                             jacobian, weight, noise))  # fmt: skip
    sd = fits.std(axis=1)
    tolerance = 4.0 / np.sqrt(2 * 2000)
    assert bound.longitudinal_sd_m[0] == pytest.approx(sd[0], rel=tolerance)
    assert bound.lateral_sd_m[0] == pytest.approx(sd[1], rel=tolerance)
    assert bound.yaw_sd_rad[0] == pytest.approx(sd[2], rel=tolerance)
    assert bound.poles_in_view[0] == pytest.approx(5.0)


def test_thin_places_show() -> None:
    pole_map = poles([(10.0, 4.0), (15.0, -5.0), (22.0, 6.0)])
    poses = np.array([[0.0, 0.0, 0.0], [17.0, 0.0, 0.0], [50.0, 0.0, 0.0]])
    bound = localizability(pole_map, poses, VIEW, rig=RIG)
    assert bound.lateral_sd_m[0] < 0.2
    # a single pole bounds nothing by itself, no pole neither
    assert np.isinf(bound.lateral_sd_m[2])
    assert np.isinf(bound.yaw_sd_rad[2])
    assert bound.poles_in_view.tolist() == pytest.approx([2.1, 0.0, 0.0])


def test_more_poles_never_hurt_and_range_does() -> None:
    few = poles([(10.0, 4.0), (15.0, -5.0)])
    more = poles([(10.0, 4.0), (15.0, -5.0), (20.0, 2.0)])
    far = poles([(30.0, 12.0), (35.0, -5.0)])
    pose = np.zeros((1, 3))
    values = [localizability(m, pose, VIEW, rig=RIG).longitudinal_sd_m[0] for m in (more, few, far)]
    assert values == sorted(values)
