"""Tiles of a city's map on the disk, and what is read of them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from polemap.drivelog.frames import EarthFrame, transform_points
from polemap.map.city.statistics import MapStatistics
from polemap.map.line_map import LineMap
from polemap.map.pole_map import PoleMap

Floats = NDArray[np.float64]
Key = tuple[int, ...]

# a box in another zone is bounded by points of its edges; between them the edge bends less
_EDGE_POINTS, _BEND_M = 9, 5.0


@dataclass(frozen=True, slots=True)
class Tile:
    """Poles that are read at once.

    Attributes:
        poles: of the tile alone, in the map's order.
        rows: `(n,)` which rows of the whole map they are.
    """

    poles: PoleMap
    rows: NDArray[np.int64]


class TileStore(Protocol):
    """A map on the disk that can be read by tiles; every pole lies in exactly one of them."""

    @property
    def frame(self) -> EarthFrame:
        """Of its coordinates."""

    @property
    def statistics(self) -> MapStatistics:
        """Of all its poles."""

    def overlapping(self, low_m: Floats, high_m: Floats) -> list[Key]:
        """Tiles that may hold poles of a box, in a fixed order."""

    def all_keys(self) -> Iterator[Key]:
        """All tiles, in a fixed order."""

    def box(self, key: Key) -> Floats:
        """West, south, east, north `(4,)` within which a tile's poles lie."""

    def read(self, key: Key, columns: Sequence[str] = ()) -> Tile:
        """The poles of a tile, with further columns where the file has them.

        Raises:
            InputError: the tile is damaged.
        """

    def lines_in(self, boxes: Floats) -> LineMap | None:
        """The lines that meet boxes `(k, 4)`, whole, with ids of their own in the whole map; None
        where it has none.

        Raises:
            InputError: they are damaged.
        """


@dataclass(frozen=True, slots=True)
class Area:
    """What a map says of some boxes.

    Attributes:
        boxes: `(k, 4)` west, south, east, north.
        poles: that stand in one of them, in the map's order, and the lines that meet one.
        unread: `(m, 4)` boxes of tiles that could not be read: of what stands there nothing is
            known.
    """

    boxes: Floats
    poles: PoleMap
    unread: Floats

    def known(self, points_m: Floats) -> NDArray[np.bool_]:
        """Which of the points `(n, 2)` lie where the poles are known."""
        return inside(self.boxes, points_m) & ~inside(self.unread, points_m)


def inside(boxes: Floats, points_m: Floats) -> NDArray[np.bool_]:
    """Which of the points `(n, 2)` lie in one of the boxes `(k, 4)`."""
    east, north = points_m[:, :1], points_m[:, 1:2]
    within = (east >= boxes[:, 0]) & (east <= boxes[:, 2])
    within &= (north >= boxes[:, 1]) & (north <= boxes[:, 3])
    return np.asarray(within.any(axis=1))


def box_around(centre_m: ArrayLike, radius_m: float) -> Floats:
    """The box `(4,)` of a circle."""
    centre = np.asarray(centre_m, dtype=np.float64).reshape(2)
    return np.concatenate([centre - radius_m, centre + radius_m])


def box_in(box: Floats, frame: EarthFrame, other: EarthFrame) -> Floats:
    """The box `(4,)` in another frame that holds a box of `frame`."""
    if frame == other:
        return box
    along = np.linspace(0.0, 1.0, _EDGE_POINTS)
    east = box[0] + along * (box[2] - box[0])
    north = box[1] + along * (box[3] - box[1])
    edge = np.concatenate(
        [np.stack(np.broadcast_arrays(x, y), axis=1)
         for x, y in ((east, box[1]), (east, box[3]), (box[0], north), (box[2], north))]
    )  # fmt: skip
    moved = transform_points(edge, frame, other)
    return np.concatenate([moved.min(axis=0) - _BEND_M, moved.max(axis=0) + _BEND_M])
