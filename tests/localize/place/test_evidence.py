from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from polemap.drivelog.detections import VisibleRegion
from polemap.localize.place.coverage import Coverage, seen_ground
from polemap.localize.place.evidence import judge, misses
from polemap.localize.place.local_map import LocalMap
from polemap.localize.place.local_map_builder import LocalMapBuilder
from polemap.localize.place.proposals import _reached_sd, propose
from polemap.localize.place.regularity import chance_density
from polemap.map.pattern_index.build import build_index
from polemap.vehicle.pose import inverse_transform_points, transform_points, wrap_angle
from tests.localize.place.town import drive_in, index_of
from tests.pole_maps import plain_map


def local_map(town: int = 0, seed: int = 0) -> tuple[LocalMap, np.ndarray]:
    """What a car has seen at the end of its drive, and where it is."""
    drive, motion = drive_in(town, seed)
    builder = LocalMapBuilder()
    for scan in drive.scans:
        pose = motion.at(scan.stamp_s)[0]
        builder.add_scan(scan, pose, 8.0 * scan.stamp_s)
        last = pose
    made = builder.local_map()
    assert made is not None
    return made.confirmed(), last


def test_the_true_pose_is_among_the_first_proposed() -> None:
    local, truth = local_map()
    found = propose(index_of(), local, 10)
    away = np.hypot(*(found.poses[:, :2] - truth[:2]).T)
    turned = np.abs(wrap_angle(found.poses[:, 2] - truth[2]))
    best = np.argmax(found.votes)
    assert away[best] < 2.0
    assert turned[best] < 0.1


def test_a_pose_near_the_truth_is_drawn_to_it_and_explains_the_poles() -> None:
    local, truth = local_map()
    off = truth + np.array([0.6, -0.4, 0.01])
    wrong = truth + np.array([300.0, 150.0, 1.0])
    judged = judge(index_of(), local, np.array([off, wrong]))
    assert np.hypot(*(judged.poses[0, :2] - truth[:2])) < 0.2
    assert judged.log_ratio[0] > 20.0 > 0.0 > judged.log_ratio[1]
    assert judged.matched[0] > 0.6 * len(local)
    rows = judged.rows[0][judged.rows[0] >= 0]
    assert len(np.unique(rows)) == len(rows)


def test_map_poles_that_should_have_been_seen_speak_against_a_pose() -> None:
    local, truth = local_map()
    index = index_of()
    ahead = transform_points(
        local.looks[len(local.looks) // 2], np.array([[8.0, 1.0], [9.0, -1.0]])
    )
    crowded, _ = build_index(
        plain_map(np.concatenate([index.points_m, transform_points(truth, ahead)]))
    )
    as_it_is = misses(index, local, judge(index, local, truth[np.newaxis]))[0]
    with_more = misses(crowded, local, judge(crowded, local, truth[np.newaxis]))[0]
    assert with_more < as_it_is - 2.0


def test_a_sensor_that_does_not_say_where_it_looks_misses_nothing() -> None:
    local, truth = local_map()
    blind = replace(local, ground=np.empty((0, 3)))
    assert Coverage.of(blind.ground) is None
    assert misses(index_of(), blind, judge(index_of(), blind, truth[np.newaxis])).tolist() == [0.0]


def test_looks_are_counted_where_the_sensor_looked() -> None:
    view = VisibleRegion(np.array([1.0, 0.0]), -0.5, 0.5, 3.0, np.array([20.0]))
    ground = seen_ground(view)
    assert view.contains(ground[:, :2]).all()
    np.testing.assert_allclose(len(ground), 0.5 * (20.0**2 - 3.0**2), rtol=0.05)
    coverage = Coverage.of(np.concatenate([ground, ground]))
    assert coverage is not None
    looks = coverage.looks_at(np.array([[8.0, 0.5], [-5.0, 0.0], [1e6, 0.0]]))
    assert 1.5 < looks[0] < 2.5
    assert looks[1:].tolist() == [0.0, 0.0]


def test_rows_and_grids_foretell_their_poles_and_strewn_poles_do_not() -> None:
    row = np.column_stack([np.arange(8) * 9.0, np.zeros(8)])
    grid = np.stack(np.meshgrid(np.arange(4) * 8.0, np.arange(4) * 16.0), axis=-1).reshape(-1, 2)
    strewn = np.random.default_rng(0).uniform(0.0, 100.0, (25, 2))
    for regular in (row, grid, row * (1.0, -1.0)):
        assert (chance_density(regular, 0.02) > 1.0).all()
    assert np.median(chance_density(strewn, 0.02)) < 0.1
    for few in range(3):
        assert chance_density(strewn[:few], 0.02).tolist() == [0.02] * few


def test_evidence_does_not_depend_on_where_the_map_lies() -> None:
    local, truth = local_map()
    index = index_of()
    move = np.array([5e5, 5e6, 0.7])
    moved, _ = build_index(plain_map(transform_points(move, index.points_m), variance_m2=0.0025))
    same, _ = build_index(plain_map(index.points_m, variance_m2=0.0025))
    there = np.array([*transform_points(move, truth[:2]), truth[2] + 0.7])
    one = judge(same, local, truth[np.newaxis])
    two = judge(moved, local, there[np.newaxis])
    np.testing.assert_allclose(one.log_ratio, two.log_ratio, atol=1e-3)
    back = inverse_transform_points(move, two.poses[0, :2])
    np.testing.assert_allclose(back, one.poses[0, :2], atol=1e-4)


@pytest.mark.parametrize(
    ("mapped", "sd"), [(0, 2.0), (1_000_000, 2.0), (6_000_000, 1.1), (60_000_000, 1.0)]
)
def test_the_larger_the_map_the_nearer_its_triangles_must_be(mapped: int, sd: float) -> None:
    assert _reached_sd(mapped) == pytest.approx(sd, abs=0.01)
