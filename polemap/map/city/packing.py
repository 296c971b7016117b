"""Poles packed into tiles of equally many, however densely they stand.

Source: Leutenegger, Lopez, Edgington (1997), STR: a simple and efficient algorithm for R-tree
packing.
"""

from __future__ import annotations

from math import ceil, sqrt

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

# poles a tile: read in a millisecond or two, and ten million poles make no more than 2500 of them
TILE_POLES = 4096


def packed_order(points_m: Floats, tile_poles: int = TILE_POLES) -> NDArray[np.int64]:
    """The order `(n,)` of points `(n, 2)` in which every `tile_poles` in a row are neighbours.

    Slices from west to east, in each of them from south to north; equal ones, and those of a single
    tile, stay in their order.
    """
    n = len(points_m)
    if n <= tile_poles:
        return np.arange(n)
    slices = max(1, ceil(sqrt(ceil(n / tile_poles))))
    order = np.argsort(points_m[:, 0], kind="stable")
    parts = [
        order[start : start + slices * tile_poles] for start in range(0, n, slices * tile_poles)
    ]
    sorted_parts = [part[np.argsort(points_m[part, 1], kind="stable")] for part in parts]
    return np.concatenate(sorted_parts) if parts else order


def boxes_of(points_m: Floats, tile_poles: int = TILE_POLES) -> Floats:
    """Bounding boxes `(k, 4)` (west, south, east, north) of every `tile_poles` points in a row."""
    starts = np.arange(0, len(points_m), tile_poles)
    if not len(starts):
        return np.empty((0, 4))
    low = np.minimum.reduceat(points_m, starts, axis=0)
    high = np.maximum.reduceat(points_m, starts, axis=0)
    return np.hstack([low, high])
