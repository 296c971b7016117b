from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from polemap.localize.place.along import find_along
from polemap.localize.place.finder import PlaceFinder, Search, distinct
from polemap.localize.place.local_map_builder import LocalMapBuilder
from polemap.map.pattern_index.build import build_index
from polemap.map.pattern_index.index import PatternIndex
from polemap.vehicle.pose import wrap_angle
from tests.localize.place.town import drive_in, index_of
from tests.pole_maps import plain_map, plain_scan


@pytest.mark.parametrize("seed", range(2))
def test_a_car_is_found_by_its_poles_alone(seed: int) -> None:
    drive, motion = drive_in(0, seed)
    assert drive.odometry is not None
    found = find_along(drive.scans, drive.odometry, index_of())
    assert found.claimed
    assert found.search is not None
    truth = motion.at(found.stamp_s)[0]
    assert np.hypot(*(found.search.poses[0, :2] - truth[:2])) < 0.5
    assert abs(wrap_angle(found.search.poses[0, 2] - truth[2])) < np.radians(1.0)
    assert found.after_m < 100.0
    assert found.after_s == pytest.approx(found.after_m / 8.0, rel=0.1)


def test_in_another_town_no_place_is_claimed() -> None:
    drive, _ = drive_in(1, 0)
    assert drive.odometry is not None
    found = find_along(drive.scans, drive.odometry, index_of())
    assert not found.claimed
    assert found.searches > 5


def test_of_two_places_that_are_alike_none_is_claimed() -> None:
    index = index_of()
    other = index.points_m + np.array([3000.0, 500.0])
    both, _ = build_index(plain_map(np.concatenate([index.points_m, other]), variance_m2=0.0025))
    drive, _ = drive_in(0, 0)
    assert drive.odometry is not None
    found = find_along(drive.scans, drive.odometry, both)
    assert not found.claimed
    assert found.search is not None
    apart = found.search.poses[1, :2] - found.search.poses[0, :2]
    np.testing.assert_allclose(np.abs(apart), (3000.0, 500.0), atol=0.5)
    assert found.search.wrong_at_most == pytest.approx(0.5, abs=0.1)


def test_a_search_may_begin_anywhere() -> None:
    drive, _ = drive_in(0, 1)
    assert drive.odometry is not None
    late = find_along(drive.scans, drive.odometry, index_of(), since_s=4.0)
    assert late.stamp_s > 4.0
    assert late.after_m == pytest.approx(8.0 * late.after_s, rel=0.1)
    none = find_along(drive.scans, drive.odometry, index_of(), since_s=1e6)
    assert none.search is None
    assert (none.claimed, none.after_m, none.after_s) == (False, 0.0, 0.0)


@pytest.mark.parametrize(
    "points",
    [
        np.empty((0, 2)),
        np.array([[3.0, 4.0]]),
        np.column_stack([np.arange(60) * 10.0, np.zeros(60)]),
        np.stack(np.meshgrid(np.arange(12) * 8.0, np.arange(12) * 16.0), axis=-1).reshape(-1, 2),
    ],
)
def test_maps_that_tell_no_place_give_none(points: np.ndarray) -> None:
    drive, _ = drive_in(0, 2)
    assert drive.odometry is not None
    index, _ = build_index(plain_map(points))
    assert not find_along(drive.scans, drive.odometry, index).claimed


def grid_drive(index: PatternIndex) -> list[Search]:
    """Through the middle of a grid of poles, as exact as can be."""
    finder, searches = PlaceFinder(index), []
    for way in np.arange(0.0, 40.0, 1.0):
        pose = np.array([20.0 + way, 24.0, 0.0])
        seen = index.points_m - pose[:2]
        finder.add_scan(plain_scan(way, seen[np.hypot(*seen.T) < 20.0]), pose, float(way))
        search = finder.search() if way % 10 == 9 else None
        if search is not None:
            searches.append(search)
    return searches


def test_within_a_grid_the_place_is_not_known() -> None:
    grid = np.stack(np.meshgrid(np.arange(30) * 8.0, np.arange(12) * 16.0), axis=-1).reshape(-1, 2)
    index, _ = build_index(plain_map(grid))
    assert min(search.wrong_at_most for search in grid_drive(index)) > 0.3


def test_no_search_without_poles() -> None:
    finder = PlaceFinder(index_of())
    assert finder.search() is None
    finder.add_scan(plain_scan(0.0, np.empty((0, 2))), np.zeros(3), 0.0)
    assert finder.search() is None


def test_the_probability_of_a_wrong_place_grows_with_what_others_explain() -> None:
    builder = LocalMapBuilder()
    builder.add_scan(plain_scan(0.0, [[5.0, 1.0]]), np.zeros(3), 0.0)
    local = builder.local_map()
    assert local is not None
    search = Search(
        np.zeros((2, 3)), np.array([40.0, 0.0]), np.zeros((2, 3, 3)), np.array([9, 3]),
        np.zeros((2, 1), np.int64), local, -10.0,
    )  # fmt: skip
    close = replace(search, log_evidence=np.array([40.0, 39.0]))
    regular = replace(search, by_chance=38.0)
    poor = replace(search, log_evidence=np.array([2.0, -30.0]))
    assert search.wrong_at_most < 1e-4
    assert min(one.wrong_at_most for one in (close, regular, poor)) > 0.1
    nowhere = replace(search, log_evidence=np.array([-14.0, -40.0]))
    assert nowhere.wrong_at_most > 0.9
    none = replace(search, poses=np.empty((0, 3)))
    assert none.wrong_at_most == 1.0


def test_distinct_places_are_kept_in_their_order() -> None:
    poses = np.array([[0, 0, 0], [1, 0, 0], [0, 0, 3.1], [50, 0, 0], [0, 0.5, 0.01], [9, 0, 0]])
    assert distinct(poses, np.array([1, 0, 4, 2, 5, 3]), 3).tolist() == [1, 2, 5]
