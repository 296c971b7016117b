"""A map that is opened by tiles holds what the whole map holds."""

from __future__ import annotations

import copy
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from polemap.drivelog.errors import FrameError
from polemap.drivelog.frames import EarthFrame
from polemap.map.city.city_map import CityMap
from polemap.map.city.geopackage.io import TILE_M, GeoPackageTiles
from polemap.map.city.io import open_city
from polemap.map.city.parquet.io import ParquetTiles
from polemap.map.city.statistics import MapStatistics
from polemap.map.city.tiles import box_around
from polemap.map.io import read_map
from polemap.map.pole_map import PoleMap
from tests.polemap.map.city.cities import (
    ENDINGS,
    ORIGIN,
    SIDE_M,
    assert_same,
    by_id,
)


@ENDINGS
@settings(max_examples=40, deadline=None)
@given(
    east=st.floats(-0.2, 1.2), north=st.floats(-0.2, 1.2), radius_m=st.floats(0.0, 900.0),
    on_border=st.booleans(),
)  # fmt: skip
def test_a_window_holds_what_the_whole_map_holds(
    city: PoleMap, files: dict[str, Path], ending: str, east: float, north: float,
    radius_m: float, on_border: bool,
) -> None:  # fmt: skip
    opened = open_city(files[ending])
    assert opened is not None
    centre = ORIGIN + SIDE_M * np.array([east, north])
    if on_border:
        centre, radius_m = np.round(centre / TILE_M) * TILE_M, np.round(radius_m / TILE_M) * TILE_M
    distance = np.hypot(*(city.points_m - centre).T)
    assert_same(
        by_id(opened.poles_within(centre, radius_m)), by_id(city.rows(distance <= radius_m))
    )
    box = box_around(centre, radius_m)
    within = ((city.points_m >= box[:2]) & (city.points_m <= box[2:])).all(axis=1)
    assert_same(by_id(opened.poles_in(box)), by_id(city.rows(within)))


@ENDINGS
def test_poles_come_in_the_order_in_which_the_file_is_read_whole(
    files: dict[str, Path], ending: str
) -> None:
    opened, whole = open_city(files[ending]), read_map(files[ending])
    assert opened is not None
    centre = ORIGIN + SIDE_M / 2
    assert_same(opened.poles_within(centre, 700.0), whole.rows(whole.within(centre, 700.0)))


@ENDINGS
def test_two_boxes_that_overlap_give_each_pole_once(
    city: PoleMap, files: dict[str, Path], ending: str
) -> None:
    opened = open_city(files[ending])
    assert opened is not None
    boxes = np.array([box_around(ORIGIN + 800.0, 300.0), box_around(ORIGIN + 1000.0, 300.0)])
    area = opened.area(boxes)
    assert_same(by_id(area.poles), by_id(city.rows(area.known(city.points_m))))
    assert len(area.unread) == 0


@ENDINGS
def test_all_tiles_together_are_the_map(city: PoleMap, files: dict[str, Path], ending: str) -> None:
    opened = open_city(files[ending])
    assert opened is not None
    tiles = list(opened.tiles(("history",)))
    ids = np.concatenate([tile.poles.ids for tile in tiles])
    texts = np.concatenate([tile.poles.extra["history"] for tile in tiles])
    order = np.argsort(ids)
    np.testing.assert_array_equal(ids[order], np.sort(city.ids))
    np.testing.assert_array_equal(texts[order], by_id(city).extra["history"])
    rows = np.concatenate([tile.rows for tile in tiles])
    assert len(np.unique(rows)) == len(city)
    assert len(opened) == len(city)


@ENDINGS
def test_opening_reads_no_poles_and_knows_all_of_them(
    city: PoleMap, files: dict[str, Path], ending: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def read(*_: object) -> None:
        raise AssertionError("a tile was read")

    for store in (GeoPackageTiles, ParquetTiles):
        monkeypatch.setattr(store, "read", read)
    opened = open_city(files[ending])
    assert opened is not None
    assert opened.statistics == replace(
        MapStatistics.of(city), further=opened.statistics.further
    ) or str(opened.statistics) == str(MapStatistics.of(city))
    assert opened.kinds == (0,)


@ENDINGS
def test_memory_is_bounded_by_what_is_kept(files: dict[str, Path], ending: str) -> None:
    first = open_city(files[ending])
    assert first is not None
    opened = CityMap(first._store, cached_poles=500)
    for east in np.linspace(0.0, SIDE_M, 30):
        opened.poles_within(ORIGIN + np.array([east, SIDE_M / 2]), 50.0)
        assert sum(len(tile.rows) for tile in opened._cache.values()) == opened._cached
        assert opened._cached <= 500 or len(opened._cache) == 1


@ENDINGS
def test_another_zone_is_transformed_tile_by_tile(
    city: PoleMap, files: dict[str, Path], ending: str
) -> None:
    other = EarthFrame("utm", 32632)
    opened, moved = open_city(files[ending], other), by_id(city.to_frame(other))
    assert opened is not None
    assert opened.notes == moved.notes
    centre = moved.points_m.mean(axis=0)
    chosen = moved.rows(np.hypot(*(moved.points_m - centre).T) <= 400.0)
    assert_same(by_id(opened.poles_within(centre, 400.0)), chosen)
    extent = np.array(opened.statistics.extent_m)
    assert (moved.points_m >= extent[:2]).all()
    assert (moved.points_m <= extent[2:]).all()
    with pytest.raises(FrameError, match="no transformation leads"):
        open_city(files[ending], EarthFrame("local", name="park"))


@ENDINGS
def test_it_can_be_sent_to_another_process(files: dict[str, Path], ending: str) -> None:
    opened = open_city(files[ending])
    assert opened is not None
    again = copy.deepcopy(opened)
    assert_same(
        again.poles_within(ORIGIN + 500.0, 200.0), opened.poles_within(ORIGIN + 500.0, 200.0)
    )


@ENDINGS
def test_distances_to_the_nearest_pole(city: PoleMap, files: dict[str, Path], ending: str) -> None:
    opened = open_city(files[ending])
    assert opened is not None
    places = ORIGIN + np.array([[10.0, 10.0], [1500.0, 700.0], [-500.0, 0.0]])
    nearest = city.nearest(places, 300.0)[0]
    np.testing.assert_allclose(opened.nearest_m(places, 300.0), nearest, rtol=1e-12)
