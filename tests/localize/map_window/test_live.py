"""In a car windows are read by a thread, for which nothing waits; what is late or damaged."""

from __future__ import annotations

import logging
import threading
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from polemap.drivelog.errors import InputError
from polemap.localize import map_window
from polemap.localize.map_window import MapWindow
from polemap.map.city.city_map import CityMap
from polemap.map.pole_map import PoleMap
from polemap.simulate.points.drive import PointDrive
from tests.city_maps import SlowTiles, opened, write_city
from tests.localize.map_window.driving import (
    KIDNAPPED_S,
    live,
    play,
    poses_of,
    until,
)
from tests.pole_maps import plain_map, plain_scan


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
