"""Cities are written by tiles, with what they say of themselves."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from polemap.drivelog.frames import EarthFrame
from polemap.map.city.city_map import CityMap
from polemap.map.city.io import open_map
from polemap.map.city.packing import boxes_of, packed_order
from polemap.map.city.statistics import MapStatistics
from polemap.map.io import read_map, write_map
from polemap.map.pole_map import PoleMap
from tests.pole_maps import plain_map
from tests.polemap.map.city.cities import (
    assert_same,
    by_id,
    make_city,
)


def test_a_large_map_is_written_and_opened_by_tiles(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What is smaller than a city stays a map in memory, row for row."""
    small = make_city(count=300)
    for ending in ("gpkg", "parquet"):
        write_map(small, tmp_path / f"small.{ending}")
        read = open_map(tmp_path / f"small.{ending}")
        assert isinstance(read, PoleMap)
        assert_same(read, small)
    for module in ("city.io", "formats.geopackage.io", "io"):
        monkeypatch.setattr(f"polemap.map.{module}.CITY_POLES", 300)
    for ending in ("gpkg", "parquet"):
        write_map(small, tmp_path / f"city.{ending}")
        assert isinstance(open_map(tmp_path / f"city.{ending}"), CityMap)
        assert_same(by_id(read_map(tmp_path / f"city.{ending}")), by_id(small))
    write_map(small, tmp_path / "city.geojson")
    read = open_map(tmp_path / "city.geojson")
    assert isinstance(read, PoleMap)
    assert any("all of its 300 poles were read" in note for note in read.notes)


@pytest.mark.parametrize("count", [0, 1, 63, 64, 65, 1000])
def test_packed_tiles_hold_neighbours(count: int) -> None:
    points = np.random.default_rng(count).uniform(0.0, 1000.0, (count, 2))
    order = packed_order(points, 64)
    np.testing.assert_array_equal(np.sort(order), np.arange(count))
    boxes = boxes_of(points[order], 64)
    assert len(boxes) == -(-count // 64)
    if count == 1000:
        # 16 squares of a quarter of the side each, were they perfect
        assert np.prod(boxes[:, 2:] - boxes[:, :2], axis=1).sum() < 1.3 * 1000.0**2


def test_statistics_of_a_map_without_poles_and_of_one(tmp_path: Path) -> None:
    for pole_map in (PoleMap.empty(EarthFrame("local", name="x")), plain_map([[1.0, 2.0]])):
        found = MapStatistics.of(pole_map)
        assert str(MapStatistics.from_dict(json.loads(json.dumps(found.to_dict())))) == str(found)
        assert found.poles == len(pole_map)


def test_neighbours_of_a_large_map_are_looked_for_in_some_tiles(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    city = make_city()
    exact = MapStatistics.of(city)
    monkeypatch.setattr("polemap.map.city.statistics._ALL_NEIGHBOURS", 100)
    monkeypatch.setattr("polemap.map.city.statistics.TILE_POLES", 256)
    sampled = MapStatistics.of(city)
    assert sampled.spacing_m == pytest.approx(exact.spacing_m, rel=0.15)
    assert replace(sampled, spacing_m=0.0, doubled=0, neighbours=0, height_m=(0.0,) * 3) == replace(
        exact, spacing_m=0.0, doubled=0, neighbours=0, height_m=(0.0,) * 3
    )
