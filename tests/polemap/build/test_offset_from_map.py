"""A camera's lacking disparity, told by a known map."""

from __future__ import annotations

import numpy as np
import pytest

from polemap.build.offset_from_map import offset_from_map
from polemap.map.pole_map import PoleMap
from polemap.stereo.rig import Mounting, StereoRig
from polemap.track.disparity_offset import with_disparity
from polemap.vehicle.pose import inverse_transform_points
from tests.pole_maps import plain_map

RIG = StereoRig(768, 480, 823.5, 383.5, 239.5, 0.30, Mounting(1.9, 0.15, 1.3, 0.0, 0.0, 0.0))


def street(rng: np.random.Generator) -> PoleMap:
    n = 30
    points = np.column_stack([np.linspace(10.0, 150.0, n), np.where(np.arange(n) % 2, 4.5, -5.0)])
    points = points + rng.normal(0.0, 0.2, (n, 2))  # a map scatters
    return plain_map(points, variance_m2=0.04)


@pytest.mark.parametrize("lacking_px", [-0.5, 0.0, 0.4])
def test_what_disparities_lack_is_told_among_other_things(lacking_px: float) -> None:
    rng = np.random.default_rng(3)
    mapped = street(rng)
    scans = []
    for east in np.arange(0.0, 120.0, 1.0):
        pose = np.array([float(east), 0.0, 0.0])
        true = inverse_transform_points(pose, mapped.points_m)
        true = true[(true[:, 0] > 6.0) & (true[:, 0] < 27.0)]
        seen = with_disparity(true, -lacking_px, RIG)
        other = np.column_stack([rng.uniform(6.0, 27.0, 12), rng.uniform(-8.0, 8.0, 12)])
        scans.append((pose, np.concatenate([seen, other])))
    assert offset_from_map(scans, mapped, RIG) == pytest.approx(lacking_px, abs=0.06)


def test_too_little_tells_nothing() -> None:
    mapped = street(np.random.default_rng(3))
    pose = np.zeros(3)
    assert offset_from_map([], mapped, RIG) == 0.0
    assert offset_from_map([(pose, mapped.points_m[:3])], mapped, RIG) == 0.0


def test_more_disparity_is_nearer_along_the_same_ray() -> None:
    points = np.array([[20.0, 4.0], [9.0, -3.0]])
    origin = np.array([1.9, 0.15])
    near = with_disparity(points, 0.5, RIG)
    share = (near - origin) / (points - origin)
    np.testing.assert_allclose(share[:, 0], share[:, 1])
    disparity = RIG.focal_px * RIG.baseline_m / (points[:, 0] - origin[0])
    np.testing.assert_allclose(share[:, 0], disparity / (disparity + 0.5))
    np.testing.assert_allclose(with_disparity(near, -0.5, RIG), points)
