"""Maps that hold every pole twice: two surveys that were never brought together.

Such a map fits at two places, as far apart as the surveys. Where most poles around have exactly
one neighbour at one and the same offset, the pose may be off by that offset, and its covariance
says so. A row of bollards is none: there each pole has a neighbour on either side.
"""

from __future__ import annotations

import numpy as np
import scipy
from numpy.typing import NDArray

from polemap.map.pole_map import PoleMap

Floats = NDArray[np.float64]

# surveys further apart are two places, which the search tells apart; nearer, within the map's noise
_FARTHEST_M, _NEAREST_M = 3.5, 0.25
# offsets are alike within the noise of two surveys, and their turn over the area looked at
_ALIKE_M, _AROUND_M = 0.3, 40.0
# of the poles around, those that have such a neighbour; by chance one in ten may
_SHARE, _LEAST_POLES = 0.5, 6
# poles within this of each other make the same area
_AREA_M = 15.0


class TwinPoles:
    """Looks for twins around a place, and remembers the last answer."""

    def __init__(self, pole_map: PoleMap) -> None:
        self._map = pole_map
        self._asked_m = np.full(2, np.inf)
        self._offset_m = np.zeros(2)

    def use_map(self, pole_map: PoleMap) -> None:
        """Go on with other poles, of the same frame."""
        self._map = pole_map
        self._asked_m = np.full(2, np.inf)

    def offset_at(self, place_m: Floats) -> Floats:
        """Offset `(2,)` of the twins around a place `(2,)`, zero where there are none."""
        if np.hypot(*(place_m - self._asked_m)) > _AREA_M:
            self._asked_m = np.array(place_m, dtype=np.float64)
            self._offset_m = twin_offset(self._map.points_m[self._map.within(place_m, _AROUND_M)])
        return self._offset_m


def twin_offset(points_m: Floats) -> Floats:
    """The offset `(2,)` at which most of the poles `(n, 2)` have a single neighbour, or zero."""
    if len(points_m) < _LEAST_POLES:
        return np.zeros(2)
    pairs = scipy.spatial.KDTree(points_m).query_pairs(_FARTHEST_M, output_type="ndarray")
    offsets = points_m[pairs[:, 1]] - points_m[pairs[:, 0]]
    wide = np.hypot(*offsets.T) >= _NEAREST_M
    pairs, offsets = pairs[wide], offsets[wide]
    if not len(pairs):
        return np.zeros(2)
    # both ways round, so that a pole's neighbours on either side are told apart
    source = np.concatenate([pairs[:, 0], pairs[:, 1]])
    offsets = np.concatenate([offsets, -offsets])
    near = np.hypot(*(offsets[:, None] - offsets[None]).transpose(2, 0, 1)) < _ALIKE_M
    commonest = int(near.sum(axis=1).argmax())
    offset = offsets[near[commonest]].mean(axis=0)
    ahead = np.hypot(*(offsets - offset).T) < _ALIKE_M
    behind = np.hypot(*(offsets + offset).T) < _ALIKE_M
    single = np.setdiff1d(source[ahead], source[behind])
    if 2 * len(single) < _SHARE * len(points_m):
        return np.zeros(2)
    return np.asarray(offset)
