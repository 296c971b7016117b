"""The index: poles by place, triangles by shape; both looked up without touching the rest."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.errors import InputError
from polemap.drivelog.frames import EarthFrame
from polemap.map.pattern_index.cells import CELL_M, cell_numbers, cell_places, members
from polemap.map.pattern_index.triples import keys

Floats = NDArray[np.float64]
Whole = NDArray[np.int64]

DIRECTIONS = 2**16
"""Steps of a full turn in which the direction of a triangle is kept."""


@dataclass(frozen=True, slots=True)
class Hits:
    """Triangles of the map that look like asked ones.

    Attributes:
        query: `(n,)` which of the asked.
        pole: `(n,)` row of the pole at its first corner.
        direction: `(n,)` of its longest side in the map, in steps of a full turn.
    """

    query: Whole
    pole: Whole
    direction: NDArray[np.uint16]


@dataclass(frozen=True, slots=True)
class PatternIndex:
    """Poles of a map and their triangles. Arrays may be mapped from a file.

    Attributes:
        frame: of the coordinates.
        points_m: `(n, 2)` poles, ordered by cell.
        sd_m: `(n,)` standard deviation of a coordinate.
        width_m: `(n,)`, NaN where unknown.
        cells: `(c,)` numbers of the cells that hold poles, ascending.
        cell_first: `(c + 1,)` first pole of each cell.
        shapes: `(s,)` keys of the triangles' shapes that there are, ascending.
        shape_first: `(s + 1,)` first triangle of each shape.
        pole: `(t,)` row of the first corner of each triangle, ordered by shape.
        direction: `(t,)` of its longest side, in steps of a full turn.
    """

    frame: EarthFrame
    points_m: Floats
    sd_m: NDArray[np.float32]
    width_m: NDArray[np.float32]
    cells: Whole
    cell_first: Whole
    shapes: NDArray[np.uint32]
    shape_first: Whole
    pole: NDArray[np.uint32]
    direction: NDArray[np.uint16]

    def __len__(self) -> int:
        return len(self.points_m)

    @property
    def triangles(self) -> int:
        """How many triangles it holds."""
        return len(self.pole)

    def ranges(self, low: Whole, high: Whole) -> tuple[Whole, Whole, Whole]:
        """Where triangles stand whose quantised sides lie between `low` and `high` `(q, 3)`.

        Returns:
            First and stop of ranges of triangles, and the query of each.
        """
        wide = np.maximum(high - low + 1, 0)
        _, query = members(np.zeros(len(low), dtype=np.int64), wide[:, 0] * wide[:, 1])
        number, _ = members(np.zeros(len(low), dtype=np.int64), wide[:, 0] * wide[:, 1])
        longest, second = np.divmod(number, np.maximum(wide[query, 1], 1))
        sides = low[query].copy()
        sides[:, 0] += longest
        sides[:, 1] += second
        begin = np.searchsorted(self.shapes, keys(sides))
        sides[:, 2] = high[query, 2]
        end = np.searchsorted(self.shapes, keys(sides), side="right")
        filled = end > begin
        begin, end = begin[filled], end[filled]
        # whatever stands in a damaged file, no range leads beyond the triangles that there are
        first = np.clip(self.shape_first[begin], 0, len(self.pole))
        stop = np.clip(self.shape_first[end], first, len(self.pole))
        return first, stop, query[filled]

    def hits(self, first: Whole, stop: Whole, query: Whole) -> Hits:
        """The triangles of ranges that `ranges` gave.

        Raises:
            InputError: the index names poles that it does not hold.
        """
        number, owner = members(first, stop)
        pole = self.pole[number].astype(np.int64)
        if len(pole) and pole.max() >= len(self.points_m):
            raise InputError(
                "index of patterns: it names poles that are not there; delete its file"
            )
        return Hits(query[owner], pole, self.direction[number])

    def nearest(self, points_m: Floats, limit_m: float) -> tuple[Floats, Whole]:
        """Distance and row of the nearest pole of each point `(..., 2)`.

        Infinite distance and row -1 where none lies within `limit_m`, at most half a cell.
        """
        asked = np.asarray(points_m, dtype=np.float64)
        flat = asked.reshape(-1, 2)
        # of the cells around, those on the nearer side each way reach half a cell at least
        corner = cell_places(flat - 0.5 * CELL_M)
        steps = np.array([(0, 0), (1, 0), (0, 1), (1, 1)])
        rows, owner = self._of_cells((corner[:, np.newaxis] + steps).reshape(-1, 2))
        owner //= 4
        offset = self.points_m[rows] - flat[owner]
        squared = offset[:, 0] ** 2 + offset[:, 1] ** 2
        close = squared < min(limit_m, 0.5 * CELL_M) ** 2
        rows, owner, squared = rows[close], owner[close], squared[close]
        order = np.lexsort((rows, squared, owner))
        owner = owner[order]
        lead = np.ones(len(owner), dtype=bool)
        lead[1:] = owner[1:] != owner[:-1]
        distance, row = np.full(len(flat), np.inf), np.full(len(flat), -1, dtype=np.int64)
        distance[owner[lead]] = np.sqrt(squared[order][lead])
        row[owner[lead]] = rows[order][lead]
        return distance.reshape(asked.shape[:-1]), row.reshape(asked.shape[:-1])

    def within(self, centre_m: Floats, radius_m: float) -> Whole:
        """Rows of the poles within a distance of a place `(2,)`, ascending."""
        low = cell_places(centre_m - radius_m)
        high = cell_places(centre_m + radius_m)
        east, north = (np.arange(low[i], high[i] + 1) for i in (0, 1))
        places = np.stack(np.meshgrid(east, north), axis=-1).reshape(-1, 2)
        rows, _ = self._of_cells(places)
        offset = self.points_m[rows] - centre_m
        return np.sort(rows[np.hypot(offset[:, 0], offset[:, 1]) <= radius_m])

    def _of_cells(self, places: Whole) -> tuple[Whole, Whole]:
        """Poles in cells `(n, 2)`, and the cell of each."""
        number = cell_numbers(places)
        at = np.searchsorted(self.cells, number)
        at[at == len(self.cells)] = 0
        there = np.zeros(len(number), dtype=bool)
        if len(self.cells):
            there = self.cells[at] == number
        first = np.clip(np.where(there, self.cell_first[at], 0), 0, len(self))
        stop = np.clip(np.where(there, self.cell_first[at + there], 0), first, len(self))
        return members(first, stop)
