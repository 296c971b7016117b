"""Which layers of a GeoPackage are a map's own: others in it are somebody's work."""

from __future__ import annotations

import os
import sqlite3
from contextlib import closing
from pathlib import Path

from polemap.drivelog.errors import OutputError
from polemap.map.city.geopackage.io import LAYER
from polemap.map.formats.lines import LINES, are_ours
from polemap.parsing.errors import short

DOUBTFUL = "doubtful"
_MARKS = frozenset({"existence", "observations", "drives"})  # of every layer of points of a map
_OURS = frozenset({LAYER, DOUBTFUL, LINES, "layer_styles"})


def check_layers(path: Path) -> None:
    """Refuse to replace a GeoPackage in which somebody else keeps layers.

    Raises:
        OutputError: it holds a layer that no map has, or is no GeoPackage at all.
    """
    if not path.is_file() or not path.stat().st_size:
        return
    address = f"{Path(os.path.realpath(path)).as_uri()}?mode=ro"
    try:
        with closing(sqlite3.connect(address, uri=True)) as database:
            found = database.execute("SELECT table_name FROM gpkg_contents").fetchall()
            columns = {
                name: [row[1] for row in database.execute(f'PRAGMA table_info("{name}")')]
                for name in (LAYER, DOUBTFUL, LINES)
            }
    except (sqlite3.Error, UnicodeError) as error:
        raise OutputError(
            f"{path}: is there already and is no GeoPackage that can be read "
            f"({short(str(error))}); name another file, or delete it"
        ) from error
    # a GIS calls its streets lines, an inventory its points poles
    theirs = {name for name in (LAYER, DOUBTFUL) if not set(columns[name]) >= _MARKS}
    theirs |= set() if are_ours(columns[LINES]) else {LINES}
    ours = _OURS - theirs
    others = sorted(str(name) for (name,) in found if name not in ours)
    if others:
        raise OutputError(
            f"{path}: holds the layer {ascii(others[0])[:60]}, which polemap did not write and "
            "would replace; choose another file, or move the layer to one of its own"
        )
