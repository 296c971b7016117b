"""Square tiles and cells of the map's grid, by which poles are ordered and looked up.

Tiles and cells lie at whole multiples of their edges whatever the map holds, so that a map that
grows keeps them. A cell's number orders cells by tile first: what belongs to a tile stands
together.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Whole = NDArray[np.int64]

CELL_M = 16.0
TILE_CELLS = 128
TILE_M = CELL_M * TILE_CELLS
MOST_M = 1e8
"""Coordinates beyond are no place on the earth."""
_HALF = 2**24  # cells from the middle to the edge of the numbering
_BITS = 7  # of a cell within its tile, each way


def cell_places(points_m: Floats) -> Whole:
    """Column and row `(..., 2)` of the cells that points `(..., 2)` lie in."""
    return np.floor(np.asarray(points_m) / CELL_M).astype(np.int64) + _HALF


def cell_numbers(places: Whole) -> Whole:
    """One number `(...,)` for column and row `(..., 2)`."""
    east, north = places[..., 0], places[..., 1]
    tile = ((north >> _BITS) << 20) | (east >> _BITS)
    return (tile << 2 * _BITS) | ((north & (TILE_CELLS - 1)) << _BITS) | (east & (TILE_CELLS - 1))


def tile_of(cell_number: Whole) -> Whole:
    """The tile's number of cells' numbers."""
    return cell_number >> 2 * _BITS


def tile_corner_m(tile_number: int) -> tuple[float, float]:
    """South-west corner of a tile."""
    east, north = tile_number & (2**20 - 1), tile_number >> 20
    return (
        ((east << _BITS) - _HALF) * CELL_M,
        ((north << _BITS) - _HALF) * CELL_M,
    )


def members(first: Whole, stop: Whole) -> tuple[Whole, Whole]:
    """For ranges `first` to `stop` `(n,)`: all numbers in them, and the range of each."""
    count = np.maximum(stop - first, 0)
    ends = np.cumsum(count)
    owner = np.repeat(np.arange(len(count)), count)
    numbers = np.arange(int(ends[-1]) if len(ends) else 0) + np.repeat(
        first - (ends - count), count
    )
    return numbers, owner
