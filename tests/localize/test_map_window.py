"""A city of which only what lies around the car is read gives the poses of the whole map."""

import copy
import logging
import threading
import time
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from polemap.drivelog.errors import FrameError, InputError
from polemap.drivelog.frames import EarthFrame
from polemap.localize import map_window
from polemap.localize.config import LocalizeConfig
from polemap.localize.localizer import Localizer
from polemap.localize.map_window import MapWindow
from polemap.localize.replay import Run, replay
from polemap.map.city.city_map import CityMap
from polemap.map.io import read_map
from polemap.map.pole_map import PoleMap
from polemap.simulate.points.drive import STREWN_CITY, PointDrive, gnss, simulate_points
from tests.city_maps import SlowTiles, opened, write_city
from tests.pole_maps import plain_map, plain_scan

CONFIG = LocalizeConfig(particles=150, output={"rate_hz": 20})
DURATION_S = 26.0
KIDNAPPED_S, KIDNAPPED_M = 14.0, 200.0


@pytest.fixture(scope="module")
def drive() -> PointDrive:
    """Through several squares, and put further on from one to another."""
    scenario = replace(
        STREWN_CITY, duration_s=DURATION_S, poles_per_m2=0.01, gnss=gnss(wander_sd_m=0.7),
        kidnap_s=KIDNAPPED_S, kidnap_m=KIDNAPPED_M,
    )  # fmt: skip
    return simulate_points(scenario, np.random.default_rng(4))


@pytest.fixture(scope="module")
def files(drive: PointDrive, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    return write_city(drive.pole_map, tmp_path_factory.mktemp("city"))


@pytest.fixture
def small_windows(monkeypatch: pytest.MonkeyPatch) -> None:
    """So that a drive of half a kilometre needs several; 175 m are needed by the search."""
    monkeypatch.setattr(map_window, "NEEDED_M", 190.0)
    monkeypatch.setattr(map_window, "LOADED_M", 260.0)


Poses = tuple[np.ndarray, ...]


def poses_of(drive: PointDrive, pole_map: PoleMap | CityMap) -> tuple[Run, Poses]:
    run = replay(drive.drive, pole_map, drive.scans, CONFIG, seed=3)
    return run, (run.pf.stamp_s, run.pf.poses, run.kf.poses, run.kf.covariance)


@pytest.fixture(scope="module")
def whole(drive: PointDrive, files: dict[str, Path]) -> Poses:
    """The poses in the map as it is read at once."""
    run, poses = poses_of(drive, read_map(files["gpkg"]))
    assert run.counts["pf_reinitializations"] >= 1
    return poses


def assert_equal(found: Poses, expected: Poses) -> None:
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("ending", ["gpkg", "parquet"])
@pytest.mark.usefixtures("small_windows")
def test_a_window_gives_the_poses_of_the_whole_map_bit_for_bit(
    drive: PointDrive, files: dict[str, Path], whole: Poses, ending: str
) -> None:
    # both formats keep the poles in one order
    city = opened(files[ending])
    windowed, found = poses_of(drive, city)
    assert windowed.counts["pf_map_windows"] >= 3
    assert "pf_poles_beyond_window" not in windowed.counts
    assert_equal(found, whole)
    if ending == "parquet":  # nor does it depend on what was read before
        assert_equal(poses_of(drive, city)[1], whole)


@pytest.mark.usefixtures("small_windows")
def test_another_process_gets_the_same_poses(
    drive: PointDrive, files: dict[str, Path], whole: Poses
) -> None:
    city = copy.deepcopy(opened(files["gpkg"]))
    assert_equal(poses_of(drive, city)[1], whole)


@pytest.mark.usefixtures("small_windows")
def test_a_drive_that_leaves_the_map_and_comes_back(drive: PointDrive, tmp_path: Path) -> None:
    """A part of the way has no poles in the map, as if it had never been mapped."""
    at = drive.motion.at(np.array([8.0]))[0, :2]
    gap = np.hypot(*(drive.pole_map.points_m - at).T) < 30.0
    files = write_city(drive.pole_map.rows(~gap), tmp_path)
    _, expected = poses_of(drive, read_map(files["parquet"]))
    run, found = poses_of(drive, opened(files["parquet"]))
    assert_equal(found, expected)
    late = (run.kf.stamp_s > KIDNAPPED_S - 2.0) & (run.kf.stamp_s < KIDNAPPED_S)
    true = drive.motion.at(run.kf.stamp_s[late])[:, :2]
    assert np.median(np.hypot(*(run.kf.poses[late, :2] - true).T)) < 0.5


def test_a_map_smaller_than_a_window_is_read_once(
    drive: PointDrive, files: dict[str, Path], whole: Poses, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(map_window, "LOADED_M", 20_000.0)
    run, found = poses_of(drive, opened(files["gpkg"]))
    assert run.counts["pf_map_windows"] == 1
    assert_equal(found, whole)


# live


def live(drive: PointDrive, pole_map: PoleMap | CityMap, **options) -> Localizer:
    return Localizer(pole_map, CONFIG, drive.drive.wheelbase_m, np.random.default_rng(3), **options)


def play(localizer: Localizer, samples, settle: bool = False):
    """Adds samples, asks at each for the pose; `settle` waits for what is being read."""
    answers = []
    for sample in samples:
        localizer.add_sample(sample)
        loading = localizer._particle_filter._window._loading
        if settle and loading is not None:
            loading.join(60.0)
        answers.append(localizer.pose_at(sample.arrival_s))
    return [answer for answer in answers if answer is not None]


def until(drive: PointDrive, end_s: float):
    return [sample for sample in drive.samples if sample.arrival_s < end_s]


@pytest.mark.usefixtures("small_windows")
def test_live_a_thread_reads_and_the_poses_are_good(
    drive: PointDrive, files: dict[str, Path]
) -> None:
    localizer = live(drive, opened(files["parquet"]))
    answers = play(localizer, until(drive, KIDNAPPED_S), settle=True)
    assert localizer.summary()["pf_map_windows"] >= 2
    late = [answer for answer in answers if answer.stamp_s > 10.0]
    stamps = np.array([answer.stamp_s for answer in late])
    off = np.array([a.pose[:2] for a in late]) - drive.motion.at(stamps)[:, :2]
    assert np.median(np.hypot(*off.T)) < 0.4
    assert np.mean([answer.healthy for answer in late]) > 0.9


@pytest.mark.usefixtures("small_windows")
def test_poles_of_tiles_that_come_late_are_neither_expected_nor_strange(
    drive: PointDrive, files: dict[str, Path]
) -> None:
    """The car drives out of what was read; the scans there say nothing, and it goes on."""
    slow = SlowTiles(opened(files["parquet"]))
    city = CityMap(slow)
    localizer = live(drive, city)
    samples = until(drive, KIDNAPPED_S)
    first = [sample for sample in samples if sample.arrival_s < 4.0]
    rest = samples[len(first) :]
    slow.ready.set()
    play(localizer, first, settle=True)
    slow.ready.clear()
    city._cache.clear()
    window = localizer._particle_filter._window
    # all that is known ends where the car is now
    here = localizer._particle_filter._pose[:2]
    window._area = replace(window._area, boxes=np.array([[*here - 5.0, *here + 5.0]]))
    window.poles = PoleMap.empty(city.frame)
    window._tell()
    blind = [sample for sample in rest if sample.arrival_s < 7.0]
    answers = play(localizer, blind)
    assert slow.asked.is_set()
    counts = localizer.summary()
    assert counts["pf_poles_beyond_window"] > 15
    assert "pf_poles_contradict" not in counts
    assert counts.get("pf_reinitializations", 0) == 0
    # dead reckoning spreads, and nothing speaks against the pose
    assert answers[-1].distrust in ("", "spread")
    slow.ready.set()
    window._loading.join(60.0)
    before = counts["pf_poles_beyond_window"]
    answers = play(localizer, rest[len(blind) :], settle=True)
    assert localizer.summary()["pf_poles_beyond_window"] - before < 20
    true = drive.motion.at(np.array([answers[-1].stamp_s]))[0, :2]
    assert np.hypot(*(answers[-1].pose[:2] - true)) < 1.0


def test_a_start_awaits_the_poles_around_the_fix(drive: PointDrive, files: dict[str, Path]) -> None:
    slow = SlowTiles(opened(files["gpkg"]))
    localizer = live(drive, CityMap(slow))
    play(localizer, until(drive, 3.0))
    assert localizer.summary()["pf_scans_before_map"] > 0
    assert not localizer._particle_filter.initialized
    slow.ready.set()
    play(localizer, [s for s in until(drive, 10.0) if s.arrival_s >= 3.0], settle=True)
    assert localizer._particle_filter.initialized


def test_the_pose_never_waits_for_a_tile(drive: PointDrive, files: dict[str, Path]) -> None:
    slow = SlowTiles(opened(files["parquet"]))
    localizer = live(drive, CityMap(slow))
    done = threading.Event()

    def ask() -> None:
        for sample in until(drive, 3.0):
            localizer.add_sample(sample)
            localizer.pose_at(sample.arrival_s)
        done.set()

    asking = threading.Thread(target=ask, daemon=True)
    asking.start()
    assert done.wait(30.0), "a sample or a pose waits for the tiles, which never come"
    slow.ready.set()


@pytest.mark.usefixtures("small_windows")
def test_a_damaged_tile_is_said_once_and_the_drive_goes_on(
    drive: PointDrive, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = write_city(drive.pole_map, tmp_path)["parquet"]
    at = drive.motion.at(np.array([8.0]))[0, :2]
    city = opened(path)
    (hit,) = city._store.overlapping(at, at)[:1]
    read = city._store.read

    def broken(key, columns=()):
        if key == hit:
            raise InputError("city.parquet: row group 3 is damaged (checksum); restore it")
        return read(key, columns)

    city._store.read = broken
    with caplog.at_level(logging.WARNING, logger="polemap"):
        run, _ = poses_of(drive, city)
    assert [record.getMessage() for record in caplog.records] == [
        "city.parquet: row group 3 is damaged (checksum); restore it; its poles are left out"
    ]
    assert run.counts["pf_map_tiles_damaged"] == 1
    assert run.counts["pf_poles_beyond_window"] > 0
    late = (run.kf.stamp_s > 9.0) & (run.kf.stamp_s < KIDNAPPED_S)
    true = drive.motion.at(run.kf.stamp_s[late])[:, :2]
    assert np.median(np.hypot(*(run.kf.poses[late, :2] - true).T)) < 0.5


def test_a_parked_car_finds_its_surroundings_without_a_fix(
    drive: PointDrive, files: dict[str, Path]
) -> None:
    localizer = live(drive, opened(files["gpkg"]), load_in_background=False)
    start = drive.motion.at(np.array([0.0]))[0]
    localizer.start_at(0.0, start, np.diag([0.01, 0.01, 1e-4]))
    blind = [s for s in until(drive, 8.0) if type(s).__name__ != "GnssFix"]
    answers = play(localizer, blind)
    true = drive.motion.at(np.array([answers[-1].stamp_s]))[0, :2]
    assert np.hypot(*(answers[-1].pose[:2] - true)) < 0.5
    assert localizer.summary()["pf_map_windows"] >= 1


# a newer map


def aged(pole_map: PoleMap, share: float = 0.1) -> PoleMap:
    """As it was before a share of its poles was set, with as many that are gone since."""
    rng = np.random.default_rng(0)
    new = rng.random(len(pole_map)) < share
    moved = np.where(new[:, None], pole_map.points_m + rng.uniform(-30, 30, (len(new), 2)),
                     pole_map.points_m)  # fmt: skip
    return replace(pole_map, points_m=moved, _tree=None)


@pytest.mark.parametrize("kind", ["memory", "city"])
def test_a_newer_map_is_taken_without_a_jump(
    drive: PointDrive, files: dict[str, Path], tmp_path: Path, kind: str
) -> None:
    old: PoleMap | CityMap = aged(drive.pole_map)
    new: PoleMap | CityMap = drive.pole_map
    if kind == "city":
        old = opened(write_city(aged(drive.pole_map), tmp_path)["parquet"])
        new = opened(files["gpkg"])
    localizer = live(drive, old)
    samples = until(drive, KIDNAPPED_S)
    first = [s for s in samples if s.arrival_s < 9.0]
    assert play(localizer, first, settle=True)[-1].healthy
    matched = []
    localizer.exchange_map(new)
    answers = []
    for sample in samples[len(first) :]:
        estimate = localizer.add_sample(sample)
        loading = localizer._particle_filter._window._loading
        if loading is not None:
            loading.join(60.0)
        if estimate is not None:
            matched.append(estimate.health.matched / max(estimate.health.seen, 1))
        answers.append(localizer.pose_at(sample.arrival_s))
    assert localizer.summary()["maps_exchanged"] == 1
    assert all(answer.flag == "" for answer in answers)
    stamps = np.array([answer.stamp_s for answer in answers])
    off = np.hypot(*(np.array([a.pose[:2] for a in answers]) - drive.motion.at(stamps)[:, :2]).T)
    assert off.max() < 1.0
    assert np.mean(matched[-20:]) > 0.6
    assert localizer._particle_filter._window.poles.frame == drive.pole_map.frame


def test_another_map_must_be_of_the_same_frame_and_hold_poles(drive: PointDrive) -> None:
    localizer = live(drive, drive.pole_map)
    with pytest.raises(FrameError, match="exchange_map: the new map is in local frame 'other'"):
        localizer.exchange_map(plain_map([[0.0, 0.0]], name="other"))
    with pytest.raises(InputError, match="exchange_map: the new map holds no poles"):
        localizer.exchange_map(PoleMap.empty(drive.pole_map.frame))
    without = Localizer(None, CONFIG, 2.7, np.random.default_rng(0))
    with pytest.raises(InputError, match="this localizer has no map"):
        without.exchange_map(drive.pole_map)
    assert "maps_exchanged" not in localizer.summary()


def test_an_exchange_while_tiles_of_the_old_map_are_read_forgets_them(
    drive: PointDrive, files: dict[str, Path]
) -> None:
    slow = SlowTiles(opened(files["parquet"]))
    localizer = live(drive, CityMap(slow))
    samples = until(drive, 9.0)
    half = [s for s in samples if s.arrival_s < 3.0]
    play(localizer, half)
    localizer.exchange_map(drive.pole_map)
    slow.ready.set()
    play(localizer, samples[len(half) :])
    assert localizer._particle_filter._window.poles is drive.pole_map
    assert "pf_map_windows" not in localizer.summary()


def test_exchanges_from_another_thread_while_samples_come(
    drive: PointDrive, files: dict[str, Path]
) -> None:
    localizer = live(drive, drive.pole_map)
    maps = [opened(files["gpkg"]), drive.pole_map, opened(files["parquet"])]
    stop = threading.Event()

    def exchange() -> None:
        number = 0
        while not stop.is_set():
            localizer.exchange_map(maps[number % 3])
            number += 1
            time.sleep(0.005)

    exchanging = threading.Thread(target=exchange)
    exchanging.start()
    answers = play(localizer, until(drive, 9.0))
    stop.set()
    exchanging.join()
    true = drive.motion.at(np.array([answers[-1].stamp_s]))[0, :2]
    assert np.hypot(*(answers[-1].pose[:2] - true)) < 1.5


# the window itself


def test_it_follows_the_car_and_reads_ahead(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    city = replace(plain_map(rng.uniform(-4000, 4000, (4000, 2))))
    counts: Counter[str] = Counter()
    window = MapWindow(opened(write_city(city, tmp_path)["parquet"]), counts, background=False)
    speed = np.array([20.0, 0.0])
    for east in np.arange(-3000.0, 3000.0, 10.0):
        place = np.array([east, 100.0])
        window.follow([place], speed)
        near = np.hypot(*(city.points_m - place).T) <= map_window.NEEDED_M
        assert set(city.ids[near]) <= set(window.poles.ids)
        assert len(window.poles) < 200
    # 600 m ahead of a point 100 m ahead, less the 300 m that are needed: every 400 m
    assert counts["map_windows"] <= 16


def test_a_fix_far_from_the_particles_gets_a_square_of_its_own(tmp_path: Path) -> None:
    city = plain_map(np.random.default_rng(1).uniform(-4000, 4000, (4000, 2)))
    counts: Counter[str] = Counter()
    window = MapWindow(opened(write_city(city, tmp_path)["gpkg"]), counts, background=False)
    places = [np.array([-2000.0, 0.0]), np.array([2000.0, 0.0])]
    window.follow(places, np.zeros(2))
    for place in places:
        near = np.hypot(*(city.points_m - place).T) <= map_window.NEEDED_M
        assert set(city.ids[near]) <= set(window.poles.ids)
    window.follow(places, np.zeros(2))
    assert counts["map_windows"] == 1
    scan = plain_scan(0.0, [[5.0, 0.0], [2000.0, 0.0]])
    assert len(window.mapped(scan, np.array([-2000.0, 0.0, 0.0]))) == 1
    assert counts["poles_beyond_window"] == 1


def test_a_map_in_memory_is_its_own_window() -> None:
    pole_map = plain_map([[0.0, 0.0]])
    counts: Counter[str] = Counter()
    window = MapWindow(pole_map, counts, background=True)
    window.follow([np.array([1e6, 0.0])], np.zeros(2))
    assert window.whole
    assert window.poles is pole_map
    scan = plain_scan(0.0, [[5.0, 0.0]])
    assert window.mapped(scan, np.zeros(3)) is scan
    assert not counts


def test_a_city_of_another_frame_is_refused_by_replay(
    drive: PointDrive, files: dict[str, Path]
) -> None:
    other = replace(drive.drive, frame=EarthFrame("local", name="elsewhere"))
    with pytest.raises(FrameError, match="map is in"):
        replay(other, opened(files["gpkg"]), drive.scans, CONFIG, seed=0)
