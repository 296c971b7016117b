"""Finding the car without a prior: GNSS with dead reckoning, and constellations of poles."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from drivelog.frames import EarthFrame
from drivelog.samples import GnssFix, PoleScan
from localize.config import LocalizeConfig
from localize.constellation import Candidates, ConstellationIndex, PoleMemory
from localize.exploration import draw_poses
from localize.gnss_alignment import GnssAlignment, GnssPose
from localize.relocation import Relocation
from polemap.landmark_map import PoleMap
from vehicle.pose import wrap_angle


def street(rng: np.random.Generator, count: int = 250, extent_m: float = 250.0) -> PoleMap:
    points = rng.uniform(-extent_m, extent_m, (count, 2))
    return PoleMap(
        EarthFrame("local", name="test"),
        np.arange(count),
        points,
        np.tile(np.eye(2) * 0.01, (count, 1, 1)),
        np.full(count, 0.3),
        np.full(count, np.nan),
        np.ones(count, dtype=np.int64),
        np.ones(count, dtype=np.int64),
        np.ones(count),
    )


def seen_from(world: PoleMap, pose: np.ndarray, reach_m: float) -> np.ndarray:
    c, s = np.cos(pose[2]), np.sin(pose[2])
    local = (world.points_m - pose[:2]) @ np.array([[c, -s], [s, c]])
    return local[np.hypot(*local.T) < reach_m]


def drive_and_fix(
    align: GnssAlignment,
    pose0: np.ndarray,
    sd_m: float,
    rng: np.random.Generator,
    *,
    count: int = 30,
    outliers: tuple[int, ...] = (),
    jump: tuple[int, float] = (10_000, 0.0),
) -> tuple[np.ndarray, np.ndarray]:
    """Drive an S; dead reckoning starts at the origin. Returns its last pose and the true one."""
    lasting = rng.normal(0, sd_m, 2)
    reckoned = np.zeros(3)
    true = pose0.copy()
    for k in range(count):
        way, turn = 6.0, 0.03 * np.sin(k / 5)
        for pose in (reckoned, true):
            pose[0] += way * np.cos(pose[2] + turn / 2)
            pose[1] += way * np.sin(pose[2] + turn / 2)
            pose[2] += turn
        if k == jump[0]:
            true[:2] += jump[1]
        c, s = np.cos(true[2]), np.sin(true[2])
        antenna = true[:2] + np.array([1.2 * c - 0.3 * s, 1.2 * s + 0.3 * c])
        fix = antenna + lasting + rng.normal(0, 0.3, 2)
        if k in outliers:
            fix = fix + rng.choice([-1.0, 1.0], 2) * rng.uniform(80, 200, 2)
        align.push(
            GnssFix(float(k), float(k), float(fix[0]), float(fix[1]), 1.0),
            np.array([1.2, 0.3]),
            reckoned.copy(),
        )
    return reckoned, true


@pytest.mark.parametrize("outliers", [(), (3, 4, 11, 20, 28, 29)])
def test_alignment_finds_position_and_heading(outliers: tuple[int, ...]) -> None:
    errors = []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        align = GnssAlignment(LocalizeConfig())
        pose0 = np.array([*rng.uniform(-50, 50, 2), rng.uniform(-np.pi, np.pi)])
        reckoned, true = drive_and_fix(align, pose0, 2.5, rng, outliers=outliers)
        found = align.pose(reckoned)
        assert found is not None
        assert found.heading_known
        error = found.pose - true
        error[2] = wrap_angle(error[2])
        errors.append(error)
        assert abs(error[2]) < 5 * np.sqrt(found.covariance[2, 2])
    errors = np.array(errors)
    # the lasting error of 2.5 m in each axis stays, and hardly more
    rms = np.sqrt((errors**2).mean(axis=0))
    assert 2.5 * 0.75 < rms[0] < 2.5 * 1.3
    assert 2.5 * 0.75 < rms[1] < 2.5 * 1.3
    assert rms[2] < 0.03


def test_alignment_follows_a_car_that_was_moved() -> None:
    rng = np.random.default_rng(0)
    align = GnssAlignment(LocalizeConfig())
    reckoned, true = drive_and_fix(align, np.zeros(3), 0.0, rng, jump=(26, 50.0))
    # three fixes of one second each lie beyond the jump, within the last two seconds
    found = align.pose(reckoned)
    assert found is not None
    assert np.hypot(*(found.pose[:2] - true[:2])) < 5.0


def test_a_standing_car_has_no_heading() -> None:
    align = GnssAlignment(LocalizeConfig())
    rng = np.random.default_rng(0)
    assert align.pose(np.zeros(3)) is None
    for k in range(20):
        e, n = rng.normal(0, 0.3, 2)
        align.push(GnssFix(float(k), float(k), 10 + e, 20 + n, 1.0), np.zeros(2), np.zeros(3))
    found = align.pose(np.zeros(3))
    assert found is not None
    assert not found.heading_known
    assert np.hypot(found.pose[0] - 10, found.pose[1] - 20) < 1.0
    yaw = found.sample(2000, rng)[:, 2]
    assert np.abs(np.exp(1j * yaw).mean()) < 5 / np.sqrt(2000)


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


def test_memory_joins_scans_and_forgets_what_lies_behind() -> None:
    memory = PoleMemory()
    poles = np.array([[10.0, 3.0], [20.0, -4.0], [35.0, 5.0], [60.0, -3.0], [75.0, 4.0]])
    for k in range(60):
        reckoned = np.array([2.0 * k, 0.0, 0.0])
        local = poles - reckoned[:2]
        local = local[(local[:, 0] > 2) & (local[:, 0] < 30)]
        n = len(local)
        scan = PoleScan(
            0.2 * k,
            0.2 * k,
            local,
            np.tile(np.eye(2) * 0.01, (n, 1, 1)),
            np.full(n, 0.2),
            np.full(n, -1),
            np.ones(n),
        )
        memory.push(scan, reckoned, 2.0 * k)
        if k == 25:
            around = memory.around(reckoned)
            here = poles - reckoned[:2]
            distance = np.hypot(*(around[:, None] - here[None]).transpose(2, 0, 1))
            # more than the two that the scan shows, and the first two not yet forgotten
            assert len(around) >= 4
            assert distance.min(axis=1).max() < 1e-6
    assert len(memory.around(np.array([118.0, 0.0, 0.0]))) == 0
    memory.forget()
    assert len(memory.around(np.zeros(3))) == 0


def test_draws_come_from_candidates_and_gnss() -> None:
    rng = np.random.default_rng(0)
    gnss = GnssPose(np.array([100.0, 0.0, 0.0]), np.diag([4.0, 4.0, 0.01]), True)
    good = Candidates(
        np.array([[0.0, 0.0, 1.0], [50.0, 0.0, 1.0]]), np.array([8, 3]), np.array([7.0, 2.0])
    )
    none = Candidates(np.empty((0, 3)), np.empty(0, dtype=np.int64), np.empty(0))
    assert draw_poses(500, None, none, rng).shape == (0, 3)
    assert (np.abs(draw_poses(500, gnss, none, rng)[:, 0] - 100) < 15).all()
    drawn = draw_poses(1000, gnss, good, rng)
    assert len(drawn) == 1000
    at_first = np.hypot(*drawn[:, :2].T) < 3
    assert 600 < at_first.sum() <= 800
    assert len(draw_poses(100, None, good, rng)) == 100


def test_what_gnss_says_against_a_pose() -> None:
    gnss = GnssPose(np.array([100.0, 50.0, 3.1]), np.diag([4.0, 9.0, 0.01]), True)
    at = np.array([[100.0, 50.0, 3.1], [102.0, 50.0, 3.1], [100.0, 53.0, 3.1], [100.0, 50.0, -3.1]])
    turned = wrap_angle(np.array(6.2))
    expected = [0.0, 0.5, 0.5, 0.5 * float(turned) ** 2 / 0.01]
    said = gnss.misfit(at, 1e-6)
    np.testing.assert_allclose(said - said[0], expected, atol=1e-4)
    # a receiver may be wrong altogether: a kilometre says no more than a hundred metres, nearly
    far = gnss.misfit(np.array([[140.0, 50.0, 3.1], [160.0, 50.0, 3.1]]), 0.1)
    assert 6.0 < far[0] < far[1] < 10.0
    # and says nothing of a heading that it does not know
    blind = GnssPose(gnss.pose, gnss.covariance, False)
    assert blind.misfit(np.array([[100.0, 50.0, 0.0]]), 0.1) == blind.misfit(at[:1], 0.1)


def looked_around(world: PoleMap, pose: np.ndarray, reach_m: float = 40.0) -> Relocation:
    """Stands at the pose, which dead reckoning takes for its origin, and has seen what is near."""
    relocation = Relocation(world, LocalizeConfig())
    local = seen_from(world, pose, reach_m)
    n = len(local)
    for stamp in (1.0, 2.0):
        scan = PoleScan(
            stamp,
            stamp,
            local,
            np.tile(np.eye(2) * 0.01, (n, 1, 1)),
            np.full(n, 0.3),
            np.full(n, -1),
            np.ones(n),
        )
        relocation.add_scan(scan, np.zeros(3), 0.0)
    return relocation


def test_a_place_is_confirmed_where_it_is_and_contradicted_elsewhere() -> None:
    verdicts = []
    for seed in range(10):
        rng = np.random.default_rng(seed)
        world = street(rng, count=500)
        pose = np.array([*rng.uniform(-150, 150, 2), rng.uniform(-np.pi, np.pi)])
        relocation = looked_around(world, pose)
        wrong = pose + np.array([5.0, -3.0, 0.3])
        here = relocation.verify(pose, 2.0, np.zeros(3), rng)
        verdicts.append((here, relocation.verify(wrong, 2.0, np.zeros(3), rng)))
    assert verdicts == [("confirmed", "contradicted")] * 10


def test_a_proven_place_gives_way_to_one_place_only_and_not_easily() -> None:
    rng = np.random.default_rng(0)
    pose, wrong = np.array([0.0, 0.0, 0.5]), np.array([30.0, -20.0, 2.0])
    lone = street(rng, count=60, extent_m=100.0)
    points = np.vstack([lone.points_m, lone.points_m + np.array([400.0, 0.0])])
    twice = replace(street(rng, count=120), points_m=points)

    def verdict(world: PoleMap, reach_m: float, proven: bool) -> str:
        seen = looked_around(world, pose, reach_m)
        return seen.verify(wrong, 2.0, np.zeros(3), rng, proven=proven)

    assert verdict(lone, 40.0, True) == "contradicted"
    assert verdict(twice, 40.0, False) == "contradicted"
    assert verdict(twice, 40.0, True) == "open"
    distance = np.sort(np.hypot(*(lone.points_m - pose[:2]).T))
    just_enough = float(distance[3:5].mean())
    assert verdict(lone, just_enough, False) == "contradicted"
    assert verdict(lone, just_enough, True) == "open"


def test_a_proven_place_is_not_left_for_itself() -> None:
    """Half a metre beside the pose more poles fit better: dead reckoning bends constellations."""
    rng = np.random.default_rng(0)
    pose = np.array([0.0, 0.0, 0.5])
    seen = looked_around(street(rng, count=60, extent_m=100.0), pose)
    beside = pose + np.array([0.5, 0.0, 0.0])
    assert seen.verify(beside, 2.0, np.zeros(3), rng) == "contradicted"
    assert seen.verify(beside, 2.0, np.zeros(3), rng, proven=True) != "contradicted"


def test_two_places_alike_or_few_poles_leave_the_place_open() -> None:
    rng = np.random.default_rng(0)
    pose = np.array([0.0, 0.0, 0.5])
    lone = street(rng, count=60, extent_m=100.0)
    points = np.vstack([lone.points_m, lone.points_m + np.array([400.0, 0.0])])
    twice = street(rng, count=120)
    twice = replace(twice, points_m=points)
    assert looked_around(lone, pose).verify(pose, 2.0, np.zeros(3), rng) == "confirmed"
    assert looked_around(twice, pose).verify(pose, 2.0, np.zeros(3), rng) == "open"
    nearest = np.sort(np.hypot(*(lone.points_m - pose[:2]).T))
    few = looked_around(lone, pose, float(nearest[:4].mean()))
    assert few.verify(pose, 2.0, np.zeros(3), rng) == "open"


def test_a_standing_car_does_not_start_by_gnss_until_it_has_driven() -> None:
    world = street(np.random.default_rng(1))
    relocation = Relocation(world, LocalizeConfig())
    rng = np.random.default_rng(0)
    for k in range(60):
        stamp = 1.0 + k
        fix = GnssFix(stamp, stamp, *rng.normal(0, 0.3, 2).tolist(), 1.0)
        relocation.add_fix(fix, np.zeros(2), np.zeros(3))
        assert len(relocation.start(100, stamp, np.zeros(3), rng)) == 0
    for k in range(10):
        stamp, way = 61.0 + k, 3.0 * (k + 1)
        fix = GnssFix(stamp, stamp, way + float(rng.normal(0, 0.3)), 0.0, 1.0)
        reckoned = np.array([way, 0.0, 0.0])
        relocation.add_fix(fix, np.zeros(2), reckoned)
        drawn = relocation.start(100, stamp, reckoned, rng)
        if len(drawn):
            break
    assert len(drawn) == 100
    assert np.abs(wrap_angle(drawn[:, 2])).max() < np.pi / 2
    assert np.hypot(*(drawn[:, :2].mean(axis=0) - np.array([way, 0.0]))) < 5.0
