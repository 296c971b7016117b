"""Queries against a plain loop, and what a map refuses."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from polemap.drivelog.detections import VisibleRegion
from polemap.drivelog.errors import InputError
from polemap.map.pole_map import PoleMap, join_maps
from tests.polemap.map.test_map_io import LOCAL, make_map


def spread(n: int, seed: int) -> PoleMap:
    points = np.random.default_rng(seed).uniform(-60, 60, (n, 2))
    return replace(make_map(LOCAL, n), points_m=points, _tree=None)


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 60), st.integers(0, 10_000), st.floats(0.0, 80.0))
def test_queries_equal_a_loop(n: int, seed: int, radius: float) -> None:
    pole_map = spread(n, seed)
    centres = np.random.default_rng(seed + 1).uniform(-70, 70, (4, 2))
    distance = np.linalg.norm(pole_map.points_m[None] - centres[:, None], axis=2)
    expected = [np.flatnonzero(row <= radius) for row in distance]
    for centre, rows in zip(centres, expected, strict=True):
        np.testing.assert_array_equal(pole_map.within(centre, radius), rows)
    near, row = pole_map.nearest(centres, limit_m=20.0)
    for i in range(4):
        if n and distance[i].min() < 20.0:
            assert row[i] == distance[i].argmin()
            assert near[i] == pytest.approx(distance[i].min())
        else:
            assert row[i] == -1
            assert np.isinf(near[i])


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10_000), st.floats(-4, 4))
def test_field_of_view_equals_a_loop(seed: int, yaw: float) -> None:
    pole_map = spread(50, seed)
    view = VisibleRegion(np.array([1.5, 0.3]), -0.6, 0.9, 2.0, np.array([30.0, 12.0, 45.0]))
    pose = np.array([3.0, -4.0, yaw])
    expected = []
    for i, (east, north) in enumerate(pole_map.points_m):
        x = np.cos(yaw) * (east - 3.0) + np.sin(yaw) * (north + 4.0)
        y = -np.sin(yaw) * (east - 3.0) + np.cos(yaw) * (north + 4.0)
        if view.contains(np.array([x, y])):
            expected.append(i)
    np.testing.assert_array_equal(pole_map.in_view(pose, view), expected)


def test_lean_maps_answer_alike_in_two_thirds_of_the_room() -> None:
    pole_map = replace(spread(50, 1), extra={})
    lean = pole_map.lean()
    assert lean.bytes_per_pole < 0.66 * pole_map.bytes_per_pole
    np.testing.assert_array_equal(lean.within((0, 0), 30), pole_map.within((0, 0), 30))
    np.testing.assert_allclose(lean.covariance_m2, pole_map.covariance_m2, rtol=1e-6)


def test_arrays_are_read_only() -> None:
    pole_map = make_map()
    with pytest.raises(ValueError, match="read-only"):
        pole_map.points_m[0, 0] = 1.0


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"width_m": np.zeros(3)}, "width_m has 3 rows, ids 5"),
        ({"points_m": np.full((5, 2), np.inf)}, "pole 3 has a position that is not finite"),
        ({"covariance_m2": np.full((5, 2, 2), np.nan)}, "pole 3 has a covariance with a NaN"),
        ({"existence": np.full(5, 1.2)}, "existence 1.2, not 0 to 1"),
        ({"extra": {"a": np.zeros(2)}}, "column a has 2 rows"),
    ],
)
def test_what_a_map_refuses(change: dict[str, object], message: str) -> None:
    with pytest.raises(InputError, match=message):
        replace(make_map(), **change, _tree=None)


def test_joining_and_choosing_rows() -> None:
    one, two = make_map(seed=1), make_map(seed=2)
    both = join_maps(one, two)
    assert len(both) == 10
    np.testing.assert_array_equal(both.rows(np.arange(5, 10)).points_m, two.points_m)
    assert set(both.extra) == {"passes", "history"}
