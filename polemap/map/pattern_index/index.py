"""The index: poles by place, triangles by shape; both looked up without touching the rest."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.errors import InputError
from polemap.drivelog.frames import EarthFrame
from polemap.map.pattern_index.blocks import CheckedBlocks
from polemap.map.pattern_index.cells import CELL_M, cell_numbers, cell_places, members
from polemap.map.pattern_index.triples import keys

Floats = NDArray[np.float64]
Whole = NDArray[np.int64]

DIRECTIONS = 2**16
"""Steps of a full turn in which the direction of a triangle is kept."""
_SOME = 1000


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
        blocks: hold what is touched of a file against its checksums; None of arrays in memory.
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
    blocks: CheckedBlocks | None = field(default=None, repr=False, compare=False)

    def __len__(self) -> int:
        return len(self.points_m)

    @property
    def triangles(self) -> int:
        """How many triangles it holds."""
        return len(self.pole)

    @property
    def sd_typical_m(self) -> float:
        """Median standard deviation of a coordinate, of some poles; 0 without any."""
        some = np.arange(min(len(self), _SOME))
        self._check("sd_m", some)
        return float(np.median(self.sd_m[some])) if len(some) else 0.0

    def widths_m(self, most: int) -> Floats:
        """The known widths of some poles from all over the map, so many or a few more at most.

        Raises:
            InputError: the file is damaged there.
        """
        rows = np.arange(0, len(self), max(1, len(self) // most))
        self._check("width_m", rows)
        some = self.width_m[rows].astype(np.float64)
        return some[np.isfinite(some)]

    def ranges(self, low: Whole, high: Whole) -> tuple[Whole, Whole, Whole]:
        """Where triangles stand whose quantised sides lie between `low` and `high` `(q, 3)`.

        Returns:
            First and stop of ranges of triangles, and the query of each.

        Raises:
            InputError: the file is damaged there.
        """
        wide = np.maximum(high - low + 1, 0)
        _, query = members(np.zeros(len(low), dtype=np.int64), wide[:, 0] * wide[:, 1])
        number, _ = members(np.zeros(len(low), dtype=np.int64), wide[:, 0] * wide[:, 1])
        longest, second = np.divmod(number, np.maximum(wide[query, 1], 1))
        sides = low[query].copy()
        sides[:, 0] += longest
        sides[:, 1] += second
        begin = self._place("shapes", keys(sides), "left")
        sides[:, 2] = high[query, 2]
        end = self._place("shapes", keys(sides), "right")
        filled = end > begin
        begin, end = begin[filled], end[filled]
        self._check("shape_first", begin)
        self._check("shape_first", end)
        # whatever stands in a damaged file, no range leads beyond the triangles that there are
        first = np.clip(self.shape_first[begin], 0, len(self.pole))
        stop = np.clip(self.shape_first[end], first, len(self.pole))
        return first, stop, query[filled]

    def hits(self, first: Whole, stop: Whole, query: Whole) -> Hits:
        """The triangles of ranges that `ranges` gave.

        Raises:
            InputError: the index names poles that it does not hold, or its file is damaged.
        """
        for name in ("pole", "direction"):
            self._check_ranges(name, first, stop)
        number, owner = members(first, stop)
        pole = self.pole[number].astype(np.int64)
        if len(pole) and pole.max() >= len(self.points_m):
            raise InputError(
                "index of patterns: it names poles that are not there; delete its file"
            )
        self._check("points_m", pole)
        return Hits(query[owner], pole, self.direction[number])

    def nearest(self, points_m: Floats, limit_m: float) -> tuple[Floats, Whole]:
        """Distance and row of the nearest pole of each point `(..., 2)`.

        Infinite distance and row -1 where none lies within `limit_m`, at most half a cell.

        Raises:
            InputError: the file is damaged there.
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
        """Rows of the poles within a distance of a place `(2,)`, ascending.

        Raises:
            InputError: the file is damaged there.
        """
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
        at = self._place("cells", number, "left")
        at[at == len(self.cells)] = 0
        there = np.zeros(len(number), dtype=bool)
        if len(self.cells):
            there = self.cells[at] == number
            self._check("cell_first", at[there])
            self._check("cell_first", at[there] + 1)
        first = np.clip(np.where(there, self.cell_first[at], 0), 0, len(self))
        stop = np.clip(np.where(there, self.cell_first[at + there], 0), first, len(self))
        for name in ("points_m", "sd_m", "width_m"):
            self._check_ranges(name, first, stop)
        return members(first, stop)

    def _place(self, name: str, asked: NDArray[Any], side: Literal["left", "right"]) -> Whole:
        """Where numbers belong in an ascending array."""
        values: NDArray[Any] = getattr(self, name)
        if self.blocks is not None:
            self.blocks.check_unchanged()
        at = np.searchsorted(values, asked, side)
        if self.blocks is None or not len(values):
            return at
        # bisection also reads what is not checked: but where both neighbours are as written, and
        # the number belongs between them, it can belong nowhere else
        before, behind = np.maximum(at - 1, 0), np.minimum(at, len(values) - 1)
        self.blocks.check(name, before)
        self.blocks.check(name, behind)
        low, high = values[before], values[behind]
        right = side == "right"
        placed = (at == 0) | ((low <= asked) if right else (low < asked))
        placed &= (at == len(values)) | ((high > asked) if right else (high >= asked))
        if not placed.all():
            raise self.blocks.damaged(name)
        return at

    def _check(self, name: str, rows: Whole) -> None:
        if self.blocks is not None:
            self.blocks.check(name, rows)

    def _check_ranges(self, name: str, first: Whole, stop: Whole) -> None:
        if self.blocks is not None:
            self.blocks.check_ranges(name, first, stop)
