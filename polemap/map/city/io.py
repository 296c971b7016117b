"""Opening a map: those of cities by tiles, all others as a whole."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

from polemap.drivelog.errors import InputError
from polemap.drivelog.frames import EarthFrame
from polemap.map.city.city_map import CityMap
from polemap.map.city.folder.io import STORES, FolderTiles
from polemap.map.city.stored import CITY_POLES
from polemap.map.city.tiles import TileStore
from polemap.map.pole_map import PoleMap


def open_map(
    path: str | Path, frame: EarthFrame | None = None, *, allow_empty: bool = False
) -> PoleMap | CityMap:
    """Open a map, in the frame that is asked for.

    A GeoPackage or GeoParquet file of a city, as `write_map` writes it, or a folder of such files
    of any size, is opened by its tiles without reading its poles; every other map is read, with a
    note where it is as large as a city.

    Args:
        path, frame, allow_empty: see `polemap.map.io.read_map`.

    Raises:
        InputError: unreadable, a column missing, a value out of range, no poles.
        FrameError: the map's frame is not the drive's, and no transformation leads there.
    """
    path = Path(path)
    city = open_city(path, frame)
    if city is not None and (len(city) >= CITY_POLES or path.is_dir()):
        return city
    # its libraries take a second and a hundred megabytes, which a city by tiles does not need
    from polemap.map.io import read_map

    pole_map = read_map(path, frame, allow_empty=allow_empty)
    if len(pole_map) < CITY_POLES:
        return pole_map
    note = (
        f"{path.name}: all of its {len(pole_map)} poles were read; polemap map --convert "
        f"{path.name} --out {path.stem}.gpkg writes a map that is opened by tiles"
    )
    return replace(pole_map, notes=(*pole_map.notes, note))


def open_city(path: str | Path, frame: EarthFrame | None = None) -> CityMap | None:
    """A map that is opened by its tiles; None of one that was not written so.

    Raises:
        InputError: it cannot be read.
        FrameError: no transformation leads to the frame.
    """
    path = Path(path)
    store: TileStore | None = None
    # os.path, unlike pathlib, says that a name of 300 letters is no file
    if os.path.isdir(path):
        store = FolderTiles.open(path)
        if store is None:
            raise InputError(f"{path}: no such map; a folder of maps holds .gpkg or .parquet files")
    elif not os.path.isfile(path):
        raise InputError(f"{path}: no such map")
    elif path.suffix.lower() in STORES:
        store = STORES[path.suffix.lower()](path)
    if store is None:
        return None
    return CityMap(store, frame, str(path))
