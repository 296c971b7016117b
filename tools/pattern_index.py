"""The index of patterns of a map as commands make and open it."""

from __future__ import annotations

from pathlib import Path

import typer

from polemap.build.city.work import on_workers
from polemap.drivelog.drive import Drive
from polemap.drivelog.errors import InputError
from polemap.drivelog.frames import EarthFrame
from polemap.drivelog.jobs import LocalWorkers, Workers
from polemap.map.city.city_map import CityMap
from polemap.map.city.io import open_map
from polemap.map.files.io import State, map_state, require_map
from polemap.map.pattern_index.index import PatternIndex
from polemap.map.pattern_index.io import index_file, open_index, write_index
from polemap.map.pole_map import PoleMap
from polemap.parsing.errors import named
from polemap.tools.progress import progress


def opened_index(map_file: Path, frame: EarthFrame, workers: int) -> PatternIndex:
    """The index beside a map or folder of maps, built on first need; in memory where it cannot
    be kept.

    Args:
        frame: the drive's: that of a table of coordinates alone, others say theirs.
        workers: processes that build it.

    Raises:
        InputError: the map cannot be read.
    """
    with progress(None, "index of patterns") as advance:
        return open_index(
            map_file,
            lambda: _opened(map_file, frame),
            say=lambda message: typer.echo(f"note: {message}", err=True),
            run=on_workers(LocalWorkers(workers), advance),
        )


def index_for_start(
    pole_map: PoleMap | CityMap | None, map_file: Path | None, drive: Drive, workers: int
) -> None:
    """Have the index of a city before a drive without any fix is to be found in it."""
    fixes = drive.gnss is not None and len(drive.gnss) > 0
    if isinstance(pole_map, CityMap) and map_file is not None and not fixes:
        opened_index(map_file, drive.frame, workers)


def make_index(map_file: Path, workers: Workers) -> None:
    """Build the index of a map or folder of maps, and say so."""
    state = _state(map_file)
    with progress(None, "index of patterns") as advance:
        run = on_workers(workers, advance)
        index = write_index(_opened(map_file), map_file, run=run, state=state)
    typer.echo(f"{index_file(map_file)}: {index.triangles} triangles of {len(index)} poles")


def _opened(map_file: Path, frame: EarthFrame | None = None) -> PoleMap | CityMap:
    """A map in its own frame, by tiles where it can be."""
    opened = open_map(
        map_file, frame if map_file.suffix.lower() == ".csv" else None, allow_empty=True
    )
    if isinstance(opened, CityMap):
        # every tile is read once
        return opened.uncached()
    return opened


def _state(map_file: Path) -> State:
    require_map(map_file)
    with named(map_file, InputError, "map"):
        return map_state(map_file)
