from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from polemap.drivelog.errors import InputError
from polemap.drivelog.jobs import LocalWorkers, in_order
from polemap.map.pattern_index.build import TileTask, build_index, find_triangles, kept_tiles
from polemap.map.pattern_index.cells import TILE_M
from polemap.map.pattern_index.index import DIRECTIONS, PatternIndex
from polemap.map.pattern_index.triples import neighbour_triples, quantised, triangles
from tests.pole_maps import plain_map

ARRAYS = tuple(name for name in PatternIndex.__slots__ if name != "frame")


def street(seed: int = 0, length_m: float = 3000.0, count: int = 400) -> np.ndarray:
    """Poles along a street that passes from tile to tile, in no order."""
    rng = np.random.default_rng(seed)
    return rng.uniform(
        (TILE_M - 0.5 * length_m, -20.0), (TILE_M + 0.5 * length_m, 20.0), (count, 2)
    )


def arrays(index: PatternIndex) -> list[bytes]:
    return [np.ascontiguousarray(getattr(index, name)).tobytes() for name in ARRAYS]


def on_two(function: Callable[[Any], Any], tasks: Sequence[Any]) -> list[Any]:
    return list(in_order(function, tasks, LocalWorkers(2)))


def test_it_is_the_same_for_any_number_of_workers_and_any_order_of_poles() -> None:
    points = street()
    one, digests = build_index(plain_map(points))
    two, _ = build_index(plain_map(points[::-1]), run=on_two)
    assert len(digests) > 2
    assert arrays(one) == arrays(two)


def test_tiles_see_the_triangles_of_the_whole_map() -> None:
    points = street()
    index, _ = build_index(plain_map(points))
    whole = triangles(points, neighbour_triples(points, 5))
    assert index.triangles == len(whole)


def test_an_update_works_on_its_tiles_only() -> None:
    points = street()
    before, digests = build_index(plain_map(points))
    moved = points.copy()
    moved[np.argmin(points[:, 0])] += (0.5, 0.5)
    worked: list[int] = []

    def run(function: Callable[[Any], Any], tasks: Sequence[Any]) -> list[Any]:
        worked.append(len(tasks))
        return [function(task) for task in tasks]

    old = kept_tiles(before, {str(tile): digest for tile, digest in digests.items()})
    after, _ = build_index(plain_map(moved), run=run, old=old)
    assert 0 < worked[0] < len(digests)
    assert arrays(after) == arrays(build_index(plain_map(moved))[0])


def test_every_triangle_is_found_by_its_shape() -> None:
    points = street(count=150, length_m=600.0)
    index, _ = build_index(plain_map(points))
    asked = triangles(index.points_m, neighbour_triples(index.points_m, 5))
    quanta = quantised(asked.sides_m)
    hits = index.hits(*index.ranges(quanta, quanta))
    for number in range(len(asked)):
        mine = hits.query == number
        assert asked.corners[number, 0] in hits.pole[mine]
    kept = hits.direction * (2.0 * np.pi / DIRECTIONS)
    turn = np.abs(np.exp(1j * kept) - np.exp(1j * asked.direction_rad[hits.query]))
    same = hits.pole == asked.corners[hits.query, 0]
    assert np.quantile(turn[same], 0.9) < 2e-4


def test_ranges_hold_what_lies_between_and_nothing_else() -> None:
    points = street(count=200, length_m=600.0)
    index, _ = build_index(plain_map(points))
    low, high = np.array([[40, 20, 16]]), np.array([[80, 50, 40]])
    first, stop, query = index.ranges(low, high)
    shape = quantised(triangles(points, neighbour_triples(points, 5)).sides_m)
    inside = ((shape >= low) & (shape <= high)).all(axis=1)
    assert (stop - first).sum() == inside.sum() > 0
    assert not query.any()
    assert len(index.ranges(high, low)[0]) == 0


def test_the_nearest_pole_is_that_of_a_plain_search() -> None:
    points = street()
    index, _ = build_index(plain_map(points))
    asked = np.random.default_rng(2).uniform(points.min(axis=0), points.max(axis=0), (50, 4, 2))
    distance, row = index.nearest(asked, 5.0)
    plain = np.hypot(*np.moveaxis(asked[..., np.newaxis, :] - index.points_m, -1, 0))
    near = plain.min(axis=-1) < 5.0
    np.testing.assert_allclose(distance[near], plain.min(axis=-1)[near])
    assert np.array_equal(row[near], plain.argmin(axis=-1)[near])
    assert (row[~near] == -1).all()
    assert np.isinf(distance[~near]).all()


def test_poles_within_a_distance_are_those_of_a_plain_search() -> None:
    index, _ = build_index(plain_map(street()))
    centre = np.array([TILE_M + 3.0, 1.0])
    plain = np.flatnonzero(np.hypot(*(index.points_m - centre).T) <= 120.0)
    assert np.array_equal(index.within(centre, 120.0), plain)
    assert len(plain) > 5


@pytest.mark.parametrize("points", [np.empty((0, 2)), np.array([[5.0, 5.0]]), np.zeros((4, 2))])
def test_maps_without_triangles_have_an_index(points: np.ndarray) -> None:
    index, _ = build_index(plain_map(points))
    assert len(index) == len(points)
    assert index.triangles == 0
    assert index.nearest(np.array([[5.0, 5.5]]), 1.0)[1].tolist() == [0 if len(points) == 1 else -1]
    assert len(index.ranges(np.zeros((1, 3), np.int64), np.full((1, 3), 127))[0]) == 0


def test_poles_in_a_row_at_equal_distances_are_indexed() -> None:
    row = np.column_stack([np.arange(40) * 8.0, np.zeros(40)])
    index, _ = build_index(plain_map(row))
    # of three neighbours each, and of others two steps to one side: all of them flat
    assert index.triangles > 38


def test_what_is_no_pole_or_hardly_exists_is_left_out() -> None:
    pole_map = plain_map(street(count=30))
    existence = np.where(np.arange(30) < 10, 0.1, 1.0)
    kind = np.where(np.arange(30) < 15, 1, 0).astype(np.int8)
    made = replace(pole_map, existence=existence, extra={"landmark_kind": kind})
    assert len(build_index(made)[0]) == 15


def test_a_pole_beyond_the_earth_is_named() -> None:
    points = np.array([[0.0, 0.0], [3e8, 0.0]])
    with pytest.raises(InputError, match=r"pole 1 lies 300000000 m from the origin"):
        build_index(plain_map(points))


def test_an_index_that_names_other_poles_is_damaged() -> None:
    index, _ = build_index(plain_map(street(count=60, length_m=200.0)))
    broken = replace(index, pole=index.pole + np.uint32(len(index)))
    with pytest.raises(InputError, match="names poles that are not there; delete its file"):
        broken.hits(*broken.ranges(np.zeros((1, 3), np.int64), np.full((1, 3), 127)))


def test_a_tile_without_poles_of_its_own_has_no_triangles() -> None:
    task = TileTask(street(count=10), np.zeros(10, dtype=bool))
    assert len(find_triangles(task).shape) == 0
