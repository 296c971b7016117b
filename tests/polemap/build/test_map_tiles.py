"""Merging by tiles: row for row what one process gives, whatever the tiles and the order."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from polemap.build.assemble import assemble_map
from polemap.build.city.cutting import Buckets, LandmarkCut, places
from polemap.build.city.tiles import TileTask, here, merge_tile, merge_tiles
from polemap.build.config import MappingConfig
from polemap.build.drive_observations import DriveObservations, observe_drive
from polemap.build.history import open_history
from polemap.build.map_diff import match_points
from polemap.build.traversals import TraversalLandmarks
from polemap.drivelog.errors import InputError
from polemap.map.pole_map import PoleMap
from tests.polemap.town import FRAME, drive_through, make_town, route

CONFIG = MappingConfig()
NONE = np.empty((0, 2), dtype=np.int64)


@pytest.fixture(scope="module")
def days() -> list[DriveObservations]:
    """Three drives through one block, seen by a stereo camera: all columns differ from zero."""
    rng = np.random.default_rng(3)
    town = make_town(rng, 1)
    drives = [drive_through(town, rng, start_s=1e5 * day, poses=route(1)) for day in (1, 2, 3)]
    return [
        observe_drive(f"day {day}", FRAME, drive.scans, drive.reference, CONFIG, FRAME, 247.0)
        for day, drive in enumerate(drives)
    ]


@pytest.fixture(scope="module")
def whole(days: list[DriveObservations]) -> PoleMap:
    return assemble_map(days, CONFIG, FRAME).pole_map


def assert_same_rows(one: PoleMap, other: PoleMap) -> None:
    """Bit for bit: ids, places, covariances, evidence, history, and what awaits proof."""
    assert len(one) > 10
    names = ("ids", "points_m", "covariance_m2", "width_m", "observations", "drives", "existence")
    pairs = [(one, other)]
    assert (one.doubtful is None) == (other.doubtful is None)
    if one.doubtful is not None and other.doubtful is not None:
        pairs.append((one.doubtful, other.doubtful))
    for a, b in pairs:
        for name in names:
            np.testing.assert_array_equal(getattr(a, name), getattr(b, name))
        assert set(a.extra) == set(b.extra)
        for name, values in a.extra.items():
            np.testing.assert_array_equal(values, b.extra[name])


@pytest.mark.parametrize("tile_m", [7.0, 31.0, 200.0, 1e7])
def test_the_rows_do_not_depend_on_the_tiles(
    days: list[DriveObservations], whole: PoleMap, tile_m: float
) -> None:
    shuffled = [days[i] for i in np.random.default_rng(int(tile_m)).permutation(3)]

    def backwards(function: object, tasks: object) -> list[object]:
        # workers finish in any order
        return here(function, tasks[::-1])[::-1]  # type: ignore[arg-type, index]

    tiled = assemble_map(shuffled, CONFIG, FRAME, run=backwards, tile_m=tile_m)
    assert_same_rows(tiled.pole_map, whole)


def test_borders_that_run_through_poles(days: list[DriveObservations], whole: PoleMap) -> None:
    """Tiles cut so that a pole's own coordinates, to the last bit, are a border or a corner."""
    for row in (0, len(whole) // 2):
        east, north = whole.points_m[row]
        for edge in (east / 9000.0, north / 90000.0):
            tiled = assemble_map(days, CONFIG, FRAME, tile_m=float(edge))
            assert_same_rows(tiled.pole_map, whole)


def test_an_update_by_tiles(days: list[DriveObservations]) -> None:
    first = assemble_map(days[:1], CONFIG, FRAME).pole_map
    plain = assemble_map(days[1:], CONFIG, FRAME, update=first).pole_map
    tiled = assemble_map(days[1:], CONFIG, FRAME, update=first, tile_m=25.0).pole_map
    assert_same_rows(tiled, plain)


def test_histories_of_older_maps_are_read(days: list[DriveObservations]) -> None:
    """Traversals with the sixteen values that they had before drift and disparity were modelled."""
    first = assemble_map(days[:1], CONFIG, FRAME).pole_map

    def older(text: str) -> str:
        entries = json.loads(text)
        for entry in entries:
            entry["passes"] = [values[:16] for values in entry["passes"]]
        return json.dumps(entries)

    history = np.array([older(text) for text in first.extra["history"]])
    before = replace(first, extra={**first.extra, "history": history}, doubtful=None)
    updated = assemble_map(days[1:2], CONFIG, FRAME, update=before).pole_map
    assert len(match_points(updated.points_m, first.points_m, 0.3)) >= 0.9 * len(first)
    broken = np.array([text.replace("[[", "[[1.0,", 1) for text in first.extra["history"]])
    with pytest.raises(InputError, match="another number of values"):
        open_history(replace(first, extra={**first.extra, "history": broken}))


def fence(n: int, step_m: float) -> TraversalLandmarks:
    """Traversals of two drives along a fence, each post near enough to be linked to the next."""
    rng = np.random.default_rng(0)
    along = np.repeat(np.arange(n) * step_m, 2)
    points = np.column_stack([along, 0.3 * along]) + rng.normal(0.0, 0.02, (2 * n, 2))
    ones = np.ones(2 * n)
    return TraversalLandmarks(
        drive=np.array(["a", "b"] * n),
        start_s=np.array([0.0, 1.0] * n),
        kind=np.zeros(2 * n, dtype=np.int8),
        points_m=points[:, ::-1].copy(),
        covariance_m2=np.tile(np.eye(2) * 1e-3, (2 * n, 1, 1)),
        reference_sd_m=0.02 * ones,
        gain_m_per_px=0.1 * np.ones((2 * n, 2)),
        aligned_sd_m=0.0 * ones,
        lever_m=10.0 * ones,
        direction_rad=ones,
        width_m=0.1 * ones,
        width_sd_m=0.01 * ones,
        height_m=ones,
        height_sd_m=ones,
        observations=np.full(2 * n, 20),
        first_s=0.0 * ones,
        last_s=ones,
        directions=np.ones(2 * n, dtype=np.int64),
        range_min_m=5.0 * ones,
        range_max_m=9.0 * ones,
    )


def test_a_group_that_spans_many_tiles_is_merged_by_one() -> None:
    landmarks = fence(200, 0.7)
    one, _ = merge_tiles(landmarks, NONE, [], CONFIG)
    rounds = []

    def run(function: object, tasks: list[TileTask]) -> list[object]:
        rounds.append((function, len(tasks)))
        return here(function, tasks)  # type: ignore[arg-type]

    tiled, _ = merge_tiles(landmarks, NONE, [], CONFIG, run=run, tile_m=5.0)
    merging = [count for function, count in rounds if function is merge_tile]
    assert len(merging) > 3  # the margin had to grow
    assert merging[-1] < merging[0]
    np.testing.assert_array_equal(tiled.owner, one.owner)
    np.testing.assert_array_equal(tiled.points_m, one.points_m)
    np.testing.assert_array_equal(tiled.covariance_m2, one.covariance_m2)
    assert len(one) > 100


def test_cutting() -> None:
    rng = np.random.default_rng(1)
    points = rng.uniform(-50.0, 50.0, (300, 2))
    low, high = np.array([-12.0, 3.0]), np.array([20.0, 40.0])
    inside = np.flatnonzero(((points >= low) & (points <= high)).all(axis=1))
    for tile_m in (0.5, 7.0, 400.0):
        np.testing.assert_array_equal(Buckets(points, tile_m).within(low, high), inside)
    landmarks = fence(20, 1.0)
    cannot_link = np.array([[3, 5], [3, 30], [6, 7], [0, 1]])
    cut = LandmarkCut(landmarks, cannot_link, 10.0)
    assert cut.cannot_link(np.array([3, 5, 6, 8, 30])).tolist() == [[0, 1], [0, 4]]
    rows = np.concatenate([np.flatnonzero(cut.core(k, np.arange(40))) for k in cut.keys])
    assert sorted(rows.tolist()) == list(range(40))
    assert places(np.array([2, 5]), np.array([5, 1, 2, 9])).tolist() == [1, -1, 0, -1]
