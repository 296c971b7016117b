"""Finding the car without a prior, and holding the place it has against all others."""

from __future__ import annotations

import numpy as np

from polemap.drivelog.samples import GnssFix
from polemap.localize.gnss.alignment import GnssPose
from polemap.localize.gnss.outlier_mixture import GnssReceiver
from polemap.localize.particle_filter.constellation import Candidates
from polemap.localize.particle_filter.exploration import draw_poses
from polemap.localize.particle_filter.place_search import PlaceSearch
from polemap.map.pole_map import PoleMap
from polemap.vehicle.pose import wrap_angle
from tests.localize.streets import seen_from, street, twice
from tests.pole_maps import plain_scan


def test_draws_come_from_candidates_and_gnss() -> None:
    rng = np.random.default_rng(0)
    gnss = GnssPose(np.array([100.0, 0.0, 0.0]), np.diag([4.0, 4.0, 0.01]), True)
    good = Candidates(
        np.array([[0.0, 0.0, 1.0], [50.0, 0.0, 1.0]]), np.array([8, 3]), np.array([7.0, 2.0]),
        np.zeros((2, 3, 3)),
    )  # fmt: skip
    none = Candidates(np.empty((0, 3)), np.empty(0, dtype=np.int64), np.empty(0))
    assert draw_poses(500, None, none, rng).shape == (0, 3)
    assert (np.abs(draw_poses(500, gnss, none, rng)[:, 0] - 100) < 15).all()
    drawn = draw_poses(1000, gnss, good, rng)
    assert len(drawn) == 1000
    at_first = np.hypot(*drawn[:, :2].T) < 3
    assert 600 < at_first.sum() <= 800
    assert len(draw_poses(100, None, good, rng)) == 100


def searched_around(world: PoleMap, pose: np.ndarray, reach_m: float = 40.0) -> PlaceSearch:
    """Stands at the pose, which dead reckoning takes for its origin, and has seen what is near."""
    relocation = PlaceSearch(world, GnssReceiver())
    local = seen_from(world, pose, reach_m)
    for stamp in (1.0, 2.0):
        relocation.add_scan(plain_scan(stamp, local), np.zeros(3), 0.0)
    return relocation


def test_a_place_is_confirmed_where_it_is_and_contradicted_elsewhere() -> None:
    verdicts = []
    for seed in range(10):
        rng = np.random.default_rng(seed)
        world = street(rng, count=500)
        pose = np.array([*rng.uniform(-150, 150, 2), rng.uniform(-np.pi, np.pi)])
        relocation = searched_around(world, pose)
        wrong = pose + np.array([5.0, -3.0, 0.3])
        here = relocation.verify(pose, 2.0, np.zeros(3), rng)
        verdicts.append((here, relocation.verify(wrong, 2.0, np.zeros(3), rng)))
    assert verdicts == [("confirmed", "contradicted")] * 10


def test_a_proven_place_gives_way_to_one_place_only_and_not_easily() -> None:
    rng = np.random.default_rng(0)
    pose, wrong = np.array([0.0, 0.0, 0.5]), np.array([30.0, -20.0, 2.0])
    lone = street(rng, count=60, extent_m=100.0)

    def verdict(world: PoleMap, reach_m: float, proven: bool) -> str:
        seen = searched_around(world, pose, reach_m)
        return seen.verify(wrong, 2.0, np.zeros(3), rng, proven=proven)

    assert verdict(lone, 40.0, True) == "contradicted"
    assert verdict(twice(lone), 40.0, False) == "contradicted"
    assert verdict(twice(lone), 40.0, True) == "open"
    distance = np.sort(np.hypot(*(lone.points_m - pose[:2]).T))
    just_enough = float(distance[3:5].mean())
    assert verdict(lone, just_enough, False) == "contradicted"
    assert verdict(lone, just_enough, True) == "open"


def test_a_proven_place_is_not_left_for_itself() -> None:
    """Half a metre beside the pose more poles fit better: dead reckoning bends constellations."""
    rng = np.random.default_rng(0)
    pose = np.array([0.0, 0.0, 0.5])
    seen = searched_around(street(rng, count=60, extent_m=100.0), pose)
    beside = pose + np.array([0.5, 0.0, 0.0])
    assert seen.verify(beside, 2.0, np.zeros(3), rng) == "contradicted"
    assert seen.verify(beside, 2.0, np.zeros(3), rng, proven=True) != "contradicted"


def test_two_places_alike_or_few_poles_leave_the_place_open() -> None:
    rng = np.random.default_rng(0)
    pose = np.array([0.0, 0.0, 0.5])
    lone = street(rng, count=60, extent_m=100.0)
    assert searched_around(lone, pose).verify(pose, 2.0, np.zeros(3), rng) == "confirmed"
    assert searched_around(twice(lone), pose).verify(pose, 2.0, np.zeros(3), rng) == "open"
    nearest = np.sort(np.hypot(*(lone.points_m - pose[:2]).T))
    few = searched_around(lone, pose, float(nearest[:4].mean()))
    assert few.verify(pose, 2.0, np.zeros(3), rng) == "open"


def test_a_standing_car_does_not_start_by_gnss_until_it_has_driven() -> None:
    world = street(np.random.default_rng(1))
    relocation = PlaceSearch(world, GnssReceiver())
    rng = np.random.default_rng(0)
    for k in range(60):
        stamp = 1.0 + k
        fix = GnssFix(stamp, stamp, *rng.normal(0, 0.3, 2).tolist(), 1.0)
        relocation.add_fix(fix, np.zeros(3))
        assert len(relocation.draw_start(100, stamp, np.zeros(3), rng)) == 0
    for k in range(10):
        stamp, way = 61.0 + k, 3.0 * (k + 1)
        fix = GnssFix(stamp, stamp, way + float(rng.normal(0, 0.3)), 0.0, 1.0)
        odometry_pose = np.array([way, 0.0, 0.0])
        relocation.add_fix(fix, odometry_pose)
        drawn = relocation.draw_start(100, stamp, odometry_pose, rng)
        if len(drawn):
            break
    assert len(drawn) == 100
    assert np.abs(wrap_angle(drawn[:, 2])).max() < np.pi / 2
    assert np.hypot(*(drawn[:, :2].mean(axis=0) - np.array([way, 0.0]))) < 5.0
