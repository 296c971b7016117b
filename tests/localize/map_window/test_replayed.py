"""A city of which only what lies around the car is read gives the poses of the whole map."""

from __future__ import annotations

import copy
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from polemap.drivelog.errors import FrameError
from polemap.drivelog.frames import EarthFrame
from polemap.localize import map_window
from polemap.localize.map_window import MapWindow
from polemap.localize.replay import replay
from polemap.map.io import read_map
from polemap.simulate.points.drive import PointDrive
from tests.city_maps import opened, write_city
from tests.localize.map_window.driving import (
    CONFIG,
    KIDNAPPED_S,
    Poses,
    poses_of,
)
from tests.pole_maps import plain_map, plain_scan


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
