"""Cars that start without a fix in a city that is opened by tiles, and that are misled there."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from threading import Thread

import numpy as np
import pytest

from polemap.drivelog.frames import EarthFrame, transform_points
from polemap.drivelog.samples import GnssFix
from polemap.localize import map_window
from polemap.localize.config import LocalizeConfig
from polemap.localize.localizer import Localizer
from polemap.localize.particle_filter.estimate import PfEstimate
from polemap.localize.particle_filter.filter import ParticleFilter
from polemap.localize.place.claims import PlaceClaims
from polemap.localize.place.patterns import MapPatterns
from polemap.map.city.city_map import CityMap
from polemap.map.pattern_index.build import build_index
from polemap.map.pattern_index.io import index_file, read_index, write_index
from polemap.map.pole_map import PoleMap
from polemap.vehicle.pose import relative, wrap_angle
from tests.city_maps import SlowTiles, opened, write_city
from tests.localize.place.town import Patterns, drive_in, town
from tests.localize.point_drives import play

FEW = LocalizeConfig(particles=50)
SEED = 1


def town_map() -> PoleMap:
    return town(0).surveyed(0.05, 0)


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """A town by tiles, with its index beside each file."""
    paths = write_city(town_map(), tmp_path_factory.mktemp("town"))
    for path in paths.values():
        write_index(town_map(), path)
    return paths


@pytest.fixture
def unindexed(tmp_path: Path) -> Path:
    return write_city(town_map(), tmp_path)["parquet"]


@pytest.fixture(autouse=True)
def small_windows(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(map_window, "NEEDED_M", 150.0)
    monkeypatch.setattr(map_window, "LOADED_M", 250.0)


def driven(city: CityMap, fixes: Iterable[GnssFix] = ()) -> tuple[list[PfEstimate], ParticleFilter]:
    drive, _ = drive_in(0, SEED)
    made = ParticleFilter(city, FEW, 2.7, np.random.default_rng(0))
    samples = sorted([*drive.samples(), *fixes], key=lambda sample: sample.stamp_s)
    return play(made, samples), made


def off_m(stamp_s: float, pose: np.ndarray) -> float:
    return float(np.hypot(*(pose[:2] - drive_in(0, SEED)[1].at(stamp_s)[0, :2])))


@pytest.mark.parametrize("ending", ["gpkg", "parquet"])
def test_the_window_opens_round_the_place_that_the_poles_claim(
    files: dict[str, Path], ending: str
) -> None:
    city = opened(files[ending])
    estimates, made = driven(city)
    assert made.counts["scans_without_place"] > 0
    assert estimates[0].stamp_s < 11.0
    # the very first scan is weighed against the poles around
    assert estimates[0].health.in_view > 0
    assert off_m(estimates[0].stamp_s, estimates[0].pose) < 2.0
    late = [off_m(one.stamp_s, one.pose) for one in estimates[8:]]
    assert max(late) < 1.0


def test_without_an_index_it_is_built_on_need_beside_the_map_and_said(
    unindexed: Path, caplog: pytest.LogCaptureFixture
) -> None:
    estimates, _ = driven(opened(unindexed))
    assert off_m(estimates[-1].stamp_s, estimates[-1].pose) < 1.0
    assert caplog.text.count("it has no index of patterns; it is built now") == 1
    caplog.clear()
    assert read_index(unindexed) is not None
    again, _ = driven(opened(unindexed))
    assert caplog.text == ""
    assert off_m(again[-1].stamp_s, again[-1].pose) < 1.0


def test_a_drive_with_fixes_builds_no_index(unindexed: Path) -> None:
    _, motion = drive_in(0, SEED)
    fixes = [
        GnssFix(s, s, east, north, 1.0)
        for s in np.arange(1.2, 12.0)
        for east, north, _ in motion.at(s)
    ]
    estimates, _ = driven(opened(unindexed), fixes)
    assert off_m(estimates[-1].stamp_s, estimates[-1].pose) < 1.0
    assert not index_file(unindexed).exists()


def test_where_the_folder_cannot_be_written_the_index_is_built_in_memory(
    unindexed: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def refused(*_: object, **__: object) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr("polemap.map.pattern_index.io.atomic_file", refused)
    estimates, _ = driven(opened(unindexed))
    assert off_m(estimates[-1].stamp_s, estimates[-1].pose) < 1.0
    assert "cannot be kept" in caplog.text


def test_a_map_whose_tiles_cannot_be_read_has_no_index(
    unindexed: Path, caplog: pytest.LogCaptureFixture
) -> None:
    city = opened(unindexed)
    unindexed.unlink()
    patterns = MapPatterns(city, background=False)
    assert patterns.index(needed=False) is None
    assert patterns.index(needed=True) is None
    assert "no such map" in caplog.text
    caplog.clear()
    assert patterns.index(needed=True) is None
    assert caplog.text == ""


def test_a_wrong_fix_is_overruled_in_a_city_by_tiles(files: dict[str, Path]) -> None:
    _, motion = drive_in(0, SEED)
    wrong = [
        GnssFix(s, s, east + 400.0, north + 300.0, 1.0)
        for s in np.arange(0.2, 12.0)
        for east, north, _ in motion.at(s)
    ]
    estimates, _ = driven(opened(files["gpkg"]), wrong)
    assert off_m(estimates[-1].stamp_s, estimates[-1].pose) < 1.0


def test_a_car_that_was_moved_unseen_is_found_again_in_a_city_by_tiles(
    files: dict[str, Path],
) -> None:
    """The first drive ends somewhere, the second begins elsewhere: no fix tells."""
    first, _ = drive_in(0, SEED)
    second, motion = drive_in(0, SEED + 1)
    later_s = float(first.odometry.stamp_s[-1]) + 0.02
    made = ParticleFilter(opened(files["parquet"]), FEW, 2.7, np.random.default_rng(0))
    moved = [
        replace(one, stamp_s=one.stamp_s + later_s, arrival_s=one.arrival_s + later_s)
        for one in second.samples()
    ]
    estimates = play(made, [*first.samples(), *moved])
    end = estimates[-1]
    truth = motion.at(end.stamp_s - later_s)[0]
    assert np.hypot(*(end.pose[:2] - truth[:2])) < 1.0


def test_a_car_without_a_place_is_handed_the_map_of_its_town(
    files: dict[str, Path], tmp_path: Path
) -> None:
    other = write_city(town(1).surveyed(0.05, 1), tmp_path)["parquet"]
    write_index(town(1).surveyed(0.05, 1), other)
    drive, _ = drive_in(0, SEED)
    made = ParticleFilter(opened(other), FEW, 2.7, np.random.default_rng(0))
    samples = sorted(drive.samples(), key=lambda sample: sample.stamp_s)
    half = [sample for sample in samples if sample.stamp_s < samples[0].stamp_s + 6.0]
    assert play(made, half) == []
    made.exchange_map(opened(files["gpkg"]))
    estimates = play(made, samples[len(half) :])
    assert off_m(estimates[-1].stamp_s, estimates[-1].pose) < 1.0


def test_an_index_that_is_written_over_under_a_car_is_given_up_in_one_line(
    unindexed: Path, caplog: pytest.LogCaptureFixture
) -> None:
    write_index(town_map(), unindexed)
    city = opened(unindexed)
    drive, _ = drive_in(0, SEED)
    made = ParticleFilter(city, FEW, 2.7, np.random.default_rng(0))
    samples = sorted(drive.samples(), key=lambda sample: sample.stamp_s)
    assert city.patterns is not None
    index_file(unindexed).write_bytes(b"")
    assert play(made, samples) == []
    assert caplog.text.count("was written over while it was in use") == 1
    assert len(caplog.records) == 1


def test_live_neither_the_index_nor_the_window_holds_up_a_scan(unindexed: Path) -> None:
    drive, _ = drive_in(0, SEED)
    slow = SlowTiles(opened(unindexed))
    city = CityMap(slow, name=str(unindexed))
    localizer = Localizer(city, FEW, 2.7, np.random.default_rng(0))
    samples = list(drive.samples())
    asking = Thread(target=lambda: [localizer.add_sample(s) for s in samples[:500]], daemon=True)
    asking.start()
    asking.join(60.0)
    assert not asking.is_alive(), "a scan waits for tiles that never come"
    assert slow.asked.wait(60.0)
    slow.ready.set()
    filter_ = localizer._particle_filter
    patterns = filter_._recovery.search._claims._patterns
    if patterns._building is not None:
        patterns._building.join(60.0)
    for sample in samples[500:]:
        localizer.add_sample(sample)
        loading = filter_._window._loading
        if loading is not None:
            loading.join(60.0)
    assert filter_.initialized
    pose = localizer.pose_at(samples[-1].stamp_s)
    assert pose is not None
    assert off_m(samples[-1].stamp_s, pose.pose) < 1.0


def test_a_claim_comes_in_the_zone_of_the_localizer() -> None:
    """The index is in its map's own zone; the drive is in the next one."""
    own, other = EarthFrame("utm", epsg=32632), EarthFrame("utm", epsg=32633)
    shift_m = np.array([800_000.0, 5_400_000.0])
    there = town_map()
    moved = replace(there, frame=own, points_m=there.points_m + shift_m, _tree=None)
    claims = PlaceClaims(Patterns(build_index(moved)[0]), other)
    drive, motion = drive_in(0, SEED)
    errors = []
    for scan in drive.scans:
        truth = motion.at(scan.stamp_s)[0]
        told = relative(motion.at(0.0)[0], truth)
        claims.add_scan(scan, told, 8.0 * scan.stamp_s)
        claim = claims.claim(told, needed=True)
        if claim is None:
            continue
        here = transform_points(truth[:2] + shift_m, own, other)
        ahead = transform_points(truth[:2] + shift_m + 5.0 * heading(truth), own, other)
        yaw = np.arctan2(*(ahead - here)[::-1])
        errors.append(np.hypot(*(claim.pose[:2] - here)))
        assert abs(wrap_angle(claim.pose[2] - yaw)) < 0.03
    assert len(errors) > 10
    assert max(errors) < 0.7


def heading(pose: np.ndarray) -> np.ndarray:
    return np.array([np.cos(pose[2]), np.sin(pose[2])])
