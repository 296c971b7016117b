"""Mapped lines around the car as straight parts, with what the sensor model asks of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from polemap.map.line_map import LineMap

Floats = NDArray[np.float64]
Rows = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class NearLines:
    """Straight parts of mapped lines around the car, `(s,)` each, about `origin_m`.

    Attributes:
        origin_m: `(2,)` east, north that `start_m` is counted from.
        line: row of the polyline in the map; ids: its identifier.
        kind, style: of the line.
        start_m, along: `(s, 2)` begin, and unit vector along.
        length_m, before_m, after_m: of the part, and of its line before and after it.
        angle_rad: of `along`.
        variance_m2: across.
        existence: of the line.
    """

    origin_m: Floats
    line: Rows
    ids: Rows
    kind: NDArray[np.int8]
    style: NDArray[np.int8]
    start_m: Floats
    along: Floats
    length_m: Floats
    before_m: Floats
    after_m: Floats
    angle_rad: Floats
    variance_m2: Floats
    existence: Floats

    def __len__(self) -> int:
        return len(self.line)


class LineIndex:
    """The parts of all lines of a map, with what the sensor model asks of them."""

    def __init__(self, lines: LineMap) -> None:
        self._lines = lines
        parts = lines.segments
        way = parts.end_m - parts.start_m
        self._length = np.hypot(*way.T)
        self._along = way / np.maximum(self._length, 1e-9)[:, None]
        # way along each polyline up to the begin of a part
        total = np.concatenate([[0.0], np.cumsum(self._length)])
        first = np.searchsorted(parts.line, parts.line, side="left")
        last = np.searchsorted(parts.line, parts.line, side="right")
        self._before = total[:-1] - total[first]
        self._after = total[last] - total[1:]

    def near(self, centre_m: Floats, radius_m: float) -> NearLines:
        """Parts within a radius of a place `(2,)`."""
        rows = self._lines.within(centre_m, radius_m)
        parts = self._lines.segments
        along = self._along[rows]
        return NearLines(
            origin_m=np.array(centre_m, dtype=np.float64),
            line=parts.line[rows],
            ids=np.asarray(self._lines.ids[parts.line[rows]], dtype=np.int64),
            kind=parts.kind[rows],
            style=parts.style[rows],
            start_m=parts.start_m[rows] - centre_m,
            along=along,
            length_m=self._length[rows],
            before_m=self._before[rows],
            after_m=self._after[rows],
            angle_rad=np.arctan2(along[:, 1], along[:, 0]),
            variance_m2=parts.sd_m[rows] ** 2,
            existence=np.clip(parts.existence[rows], 0.05, 1.0),
        )
