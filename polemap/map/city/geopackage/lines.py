"""Lines of a city's GeoPackage, read where they are asked for, with nothing but SQLite."""

from __future__ import annotations

import sqlite3
import struct
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.errors import InputError
from polemap.drivelog.frames import EarthFrame
from polemap.map.formats.lines import LINES, are_ours, from_features
from polemap.map.line_map import LineMap

Floats = NDArray[np.float64]

# bytes of the box before a geometry, by the three bits of its flags (OGC GeoPackage 1.3, 2.1.3)
_BOX_BYTES = {0: 0, 1: 32, 2: 48, 3: 48, 4: 64}
_HEAD, _LINE, _MULTILINE = 8, 2, 5


class LineLayer:
    """The layer of lines of a map of ours.

    Args:
        database: of the file.
        system: the reference system (`srs_id`) of its poles.

    Attributes:
        is_ours: there are lines of a map.
        placed: they are in the system of the poles.
    """

    def __init__(self, database: sqlite3.Connection, frame: EarthFrame, system: int) -> None:
        self._frame = frame
        about = database.execute(f'PRAGMA table_info("{LINES}")').fetchall()
        self._columns = [str(row[1]) for row in about]
        self._key = next((str(row[1]) for row in about if row[5]), "")
        layer = database.execute(
            "SELECT column_name, srs_id FROM gpkg_geometry_columns WHERE table_name = ?", (LINES,)
        ).fetchone()
        self.placed = True
        self.is_ours = are_ours(self._columns) and layer is not None
        if not self.is_ours:
            return
        self._geometry, own = layer
        self.placed = bool(own == system)
        index = f"rtree_{LINES}_{self._geometry}"
        known = database.execute("SELECT 1 FROM sqlite_master WHERE name = ?", (index,)).fetchone()
        self._index = index if known else None

    def inside(self, database: sqlite3.Connection, boxes: Floats) -> LineMap | None:
        """The lines `LineMap` that meet boxes `(k, 4)`, whole; None where the map has none.

        Raises:
            InputError: a line that cannot be read.
        """
        if not self.is_ours:
            return None
        keys = {key for box in boxes for key in self._meeting(database, box)}
        names = [name for name in self._columns if name not in (self._key, self._geometry)]
        chosen = ", ".join(f'"{name}"' for name in (self._geometry, *names))
        vertices, told = [], []
        for key in sorted(keys):
            row = database.execute(
                f'SELECT {chosen} FROM "{LINES}" WHERE "{self._key}" = ?', (key,)
            ).fetchone()
            vertices.append(vertices_of(row[0]))
            told.append(dict(zip(names, row[1:], strict=True)))
        return from_features(self._frame, vertices, told)

    def _meeting(self, database: sqlite3.Connection, box: Floats) -> list[int]:
        if self._index is None:
            rows = database.execute(f'SELECT "{self._key}" FROM "{LINES}"')
        else:
            west, south, east, north = box.tolist()
            rows = database.execute(
                f'SELECT id FROM "{self._index}" WHERE minx <= ? AND maxx >= ? AND miny <= ? '
                "AND maxy >= ?",
                (east, west, north, south),
            )
        return [int(row[0]) for row in rows.fetchall()]


def vertices_of(blob: Any) -> Floats:
    """Vertices `(k, 2)` of a geometry of a GeoPackage: a line, or a multiline of one part.

    Raises:
        InputError: another geometry.
    """
    try:
        if blob[:2] != b"GP":
            raise ValueError("no geometry")
        start = _HEAD + _BOX_BYTES[(blob[3] >> 1) & 7]
        order, kind, count = _part(blob, start)
        if kind == _MULTILINE and count == 1:
            start += 9
            order, kind, count = _part(blob, start)
        if kind != _LINE:
            raise ValueError("no line in the plane")
        points = np.frombuffer(blob, dtype=f"{order}f8", count=2 * count, offset=start + 9)
    except (TypeError, KeyError, IndexError, ValueError, struct.error) as error:
        raise InputError(f"its layer '{LINES}' has a row that is no line ({error})") from error
    return points.reshape(-1, 2).astype(np.float64)


def _part(blob: bytes, start: int) -> tuple[str, int, int]:
    """Byte order, kind and count of a part of well-known binary."""
    order = "<" if blob[start] else ">"
    kind, count = struct.unpack_from(f"{order}II", blob, start + 1)
    return order, int(kind), int(count)
