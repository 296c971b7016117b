from __future__ import annotations

import numpy as np
import pytest

from polemap.map.pattern_index.triples import keys, neighbour_triples, quantised, triangles
from polemap.vehicle.pose import transform_points, wrap_angle

POINTS = np.random.default_rng(1).uniform(0.0, 80.0, (60, 2))


@pytest.mark.parametrize("pose", [(100.0, -7.0, 0.0), (0.0, 0.0, 2.0), (1e6, 5e6, -3.0)])
def test_moved_and_turned_poles_have_the_same_triangles(pose: tuple[float, float, float]) -> None:
    triples = neighbour_triples(POINTS, 5)
    here = triangles(POINTS, triples)
    there = triangles(transform_points(np.array(pose), POINTS), triples)
    assert np.array_equal(here.corners, there.corners)
    np.testing.assert_allclose(here.sides_m, there.sides_m, atol=1e-6)
    turned = wrap_angle(there.direction_rad - here.direction_rad - pose[2])
    np.testing.assert_allclose(turned, 0.0, atol=1e-6)


def test_the_mirror_image_has_the_last_two_sides_exchanged() -> None:
    triples = neighbour_triples(POINTS, 4)
    here, mirrored = triangles(POINTS, triples), triangles(POINTS * (1.0, -1.0), triples)
    np.testing.assert_allclose(here.sides_m, mirrored.sides_m[:, [0, 2, 1]])
    assert np.array_equal(here.corners[:, [1, 0, 2]], mirrored.corners)


def test_corners_go_round_counter_clockwise_from_the_longest_side() -> None:
    found = triangles(POINTS, neighbour_triples(POINTS, 5))
    a, b, c = (POINTS[found.corners[:, i]] for i in range(3))
    area = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]
    assert (area >= 0.0).all()
    assert (found.sides_m.argmax(axis=1) == 0).all()


def test_each_triple_of_neighbours_is_taken_once_and_no_pole_twice() -> None:
    twice = np.concatenate([POINTS, POINTS[:5]])  # poles in one place
    triples = neighbour_triples(twice, 5)
    assert len(np.unique(triples, axis=0)) == len(triples)
    assert (np.diff(triples, axis=1) > 0).all()


@pytest.mark.parametrize("count", [0, 1, 2])
def test_fewer_than_three_poles_make_no_triangle(count: int) -> None:
    assert len(triangles(POINTS[:count], neighbour_triples(POINTS[:count], 5))) == 0


def test_a_key_holds_three_lengths_in_their_order() -> None:
    quanta = quantised(np.array([[30.0, 12.1, 3.0], [30.0, 12.1, 3.3], [30.0, 12.4, 3.0]]))
    first, more, most = keys(quanta).tolist()
    assert first < more < most
    assert quantised(np.array([1e9, -1.0])).tolist() == [127, 0]
