"""A newer map is handed to a localizer that runs."""

from __future__ import annotations

import threading
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from polemap.drivelog.errors import FrameError, InputError
from polemap.localize.localizer import Localizer
from polemap.map.city.city_map import CityMap
from polemap.map.pole_map import PoleMap
from polemap.simulate.points.drive import PointDrive
from tests.city_maps import SlowTiles, opened, write_city
from tests.localize.map_window.driving import (
    CONFIG,
    KIDNAPPED_S,
    live,
    play,
    until,
)
from tests.pole_maps import plain_map


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
