"""The index of patterns of a map as commands make and open it."""

from __future__ import annotations

from os.path import isfile
from pathlib import Path

import typer

from polemap.build.city.work import on_workers
from polemap.drivelog.errors import InputError, OutputError
from polemap.drivelog.frames import EarthFrame
from polemap.drivelog.jobs import LocalWorkers, Workers
from polemap.map.io import read_map
from polemap.map.pattern_index.build import build_index
from polemap.map.pattern_index.index import PatternIndex
from polemap.map.pattern_index.io import index_file, open_index, write_index
from polemap.map.pole_map import PoleMap
from polemap.tools.progress import progress


def opened_index(map_file: Path, frame: EarthFrame, workers: int) -> PatternIndex:
    """The index beside a map, built on first need; in memory where it cannot be kept.

    Args:
        frame: the drive's: that of a table of coordinates alone, others say theirs.
        workers: processes that build it.

    Raises:
        InputError: the map cannot be read.
    """
    if not isfile(map_file):
        raise InputError(f"{map_file}: no such map")

    def load() -> PoleMap:
        return read_map(map_file, frame if map_file.suffix.lower() == ".csv" else None)

    def say(message: str) -> None:
        typer.echo(f"note: {message}", err=True)

    with progress(None, "index of patterns") as advance:
        run = on_workers(LocalWorkers(workers), advance)
        try:
            return open_index(map_file, load, say=say, run=run)
        except (OutputError, PermissionError) as error:
            say(f"{index_file(map_file)}: cannot be kept ({error}); built for this call only")
            return build_index(load(), run=run)[0]


def make_index(map_file: Path, workers: Workers) -> None:
    """Build the index of a map that was just written, and say so."""
    with progress(None, "index of patterns") as advance:
        index = write_index(
            read_map(map_file, allow_empty=True), map_file, run=on_workers(workers, advance)
        )
    typer.echo(f"{index_file(map_file)}: {index.triangles} triangles of {len(index)} poles")
