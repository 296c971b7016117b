"""Constellations of seen poles are found in the map, and what was seen is joined on the way."""

from __future__ import annotations

import numpy as np

from polemap.localize.particle_filter.constellation import ConstellationIndex
from polemap.localize.particle_filter.recent_poles import RecentPoles
from polemap.vehicle.pose import rotation, transform_points, wrap_angle
from tests.localize.streets import seen_from, street
from tests.pole_maps import plain_map, plain_scan


def test_constellation_is_found_in_the_whole_map() -> None:
    hits = 0
    for seed in range(20):
        rng = np.random.default_rng(seed)
        world = street(rng, count=500)
        pose = np.array([*rng.uniform(-150, 150, 2), rng.uniform(-np.pi, np.pi)])
        seen = seen_from(world, pose, 45.0)
        # a third missed, a third of what is seen false, noise
        seen = seen[rng.random(len(seen)) < 0.67] + 0.1 * rng.normal(size=(1, 2))
        seen = seen + rng.normal(0, 0.1, seen.shape)
        seen = np.vstack([seen, rng.uniform(-40, 40, (len(seen) // 2, 2))])
        found = ConstellationIndex(world).find(seen, tolerance_m=0.6, min_poles=4, rng=rng)
        offset = found.poses[0] - pose if len(found) else np.full(3, 99.0)
        hits += bool(np.hypot(*offset[:2]) < 0.5 and abs(wrap_angle(offset[2])) < 0.03)
    assert hits >= 17


def test_a_region_keeps_the_search_there() -> None:
    rng = np.random.default_rng(3)
    world = street(rng)
    pose = np.array([20.0, -30.0, 2.0])
    seen = seen_from(world, pose, 40.0)
    index = ConstellationIndex(world)
    near = index.find(
        seen, tolerance_m=0.6, min_poles=3, rng=rng, centre_m=pose[:2] + 5, reach_m=20.0
    )
    np.testing.assert_allclose(near.poses[0], pose, atol=1e-6)
    assert (np.hypot(*(near.poses[:, :2] - pose[:2] - 5).T) < 22.0).all()
    assert (np.diff(near.score) <= 0).all()
    away = index.find(
        seen, tolerance_m=0.3, min_poles=len(seen), rng=rng, centre_m=pose[:2] + 120, reach_m=20.0
    )
    assert len(away) == 0


def test_too_few_poles_or_an_empty_map_find_nothing() -> None:
    rng = np.random.default_rng(0)
    world = street(rng)
    index = ConstellationIndex(world)
    assert len(index.find(np.zeros((2, 2)), tolerance_m=0.5, min_poles=3, rng=rng)) == 0
    # all in one place: no pair long enough to give a heading
    assert len(index.find(np.zeros((5, 2)), tolerance_m=0.5, min_poles=3, rng=rng)) == 0
    nothing = ConstellationIndex(street(rng, count=0))
    assert len(nothing.find(rng.normal(size=(5, 2)), tolerance_m=0.5, min_poles=3, rng=rng)) == 0


def test_a_window_of_pairs_finds_what_all_pairs_of_the_map_find() -> None:
    """Searches along a drive, from a window that moves along, against an index of everything."""
    world = street(np.random.default_rng(5), count=900)
    windowed, whole = ConstellationIndex(world), ConstellationIndex(world)
    path = np.random.default_rng(6)
    whole.find(path.uniform(-20, 20, (5, 2)), tolerance_m=0.6, min_poles=3, rng=path)
    for step in range(12):
        pose = np.array([-150.0 + 25.0 * step, 10.0 * np.sin(step), 0.1 * step])
        seen = seen_from(world, pose, 45.0) + path.normal(0, 0.05, (1, 2))
        found = [
            index.find(
                seen,
                tolerance_m=0.6,
                min_poles=3,
                rng=np.random.default_rng(step),
                centre_m=pose[:2] + 3.0,
                reach_m=40.0,
            )
            for index in (windowed, whole)
        ]
        assert len(found[0])
        np.testing.assert_array_equal(found[0].poses, found[1].poses)
        np.testing.assert_array_equal(found[0].score, found[1].score)


def test_memory_joins_scans_and_forgets_what_lies_behind() -> None:
    memory = RecentPoles()
    poles = np.array([[10.0, 3.0], [20.0, -4.0], [35.0, 5.0], [60.0, -3.0], [75.0, 4.0]])
    for k in range(60):
        odometry_pose = np.array([2.0 * k, 0.0, 0.0])
        local = poles - odometry_pose[:2]
        local = local[(local[:, 0] > 2) & (local[:, 0] < 30)]
        memory.add_scan(plain_scan(0.2 * k, local), odometry_pose, 2.0 * k)
        if k == 25:
            around = memory.around(odometry_pose)
            here = poles - odometry_pose[:2]
            distance = np.hypot(*(around[:, None] - here[None]).transpose(2, 0, 1))
            # more than the two that the scan shows, and the first two not yet forgotten
            assert len(around) >= 4
            assert distance.min(axis=1).max() < 1e-6
    assert len(memory.around(np.array([118.0, 0.0, 0.0]))) == 0


def test_two_poles_far_ahead_leave_an_arc_and_many_around_do_not() -> None:
    rng = np.random.default_rng(1)
    pose = np.array([10.0, -4.0, 0.7])
    sds = []
    for local in ([[22.0, -6.0], [27.0, -2.0]], [[20.0, 8.0], [5.0, -6.0], [12.0, 7.0], [25, -7]]):
        world = plain_map(transform_points(pose, local))
        found = ConstellationIndex(world).find(
            local, tolerance_m=0.6, min_poles=2, rng=rng, centre_m=pose[:2], reach_m=5.0
        )
        covariance = found.covariance[np.flatnonzero(found.at(pose))[0]]
        along, aside = np.linalg.eigh(covariance[:2, :2])
        sds.append(np.sqrt(along[-1]))
        if len(local) == 2:
            # the car may stand elsewhere on a circle around the two
            assert abs(aside[:, -1] @ (rotation(pose[2]) @ [0.97, -0.16])) < 0.3
            assert np.sqrt(covariance[2, 2]) > 0.03
        assert np.linalg.eigvalsh(covariance)[0] > 0.0
    assert sds[0] > 0.8
    assert sds[1] < 0.35
