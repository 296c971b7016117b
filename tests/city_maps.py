"""Maps written to be opened by tiles, however small they are; and tiles that come late."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from threading import Event

import pytest

from polemap.map.city.city_map import CityMap
from polemap.map.city.io import open_city
from polemap.map.city.packing import packed_order
from polemap.map.city.parquet.io import write_tiles
from polemap.map.city.tiles import Tile
from polemap.map.formats.geopackage.io import write_geopackage
from polemap.map.pole_map import PoleMap

TILE_POLES = 64


def write_city(city: PoleMap, folder: Path, tile_poles: int = TILE_POLES) -> dict[str, Path]:
    """The map in every format that is read by tiles, by ending; rows in one order."""
    folder.mkdir(exist_ok=True)
    paths = {ending: folder / f"city.{ending}" for ending in ("gpkg", "parquet")}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("polemap.map.formats.geopackage.io.CITY_POLES", 1)
        packed = partial(packed_order, tile_poles=tile_poles)
        patch.setattr("polemap.map.formats.geopackage.io.packed_order", packed)
        write_geopackage(city, paths["gpkg"])
    write_tiles(city, paths["parquet"], tile_poles)
    return paths


def opened(path: Path) -> CityMap:
    city = open_city(path)
    assert city is not None
    return city


class SlowTiles:
    """The tiles of a city that nobody gets before `ready` is set."""

    def __init__(self, city: CityMap) -> None:
        self._store = city._store
        self.ready = Event()
        self.asked = Event()
        self.frame, self.statistics = self._store.frame, self._store.statistics
        self.overlapping, self.all_keys = self._store.overlapping, self._store.all_keys
        self.box, self.lines_in = self._store.box, self._store.lines_in

    def read(self, key: tuple[int, ...], columns: tuple[str, ...] = ()) -> Tile:
        self.asked.set()
        assert self.ready.wait(60.0)
        return self._store.read(key, columns)
