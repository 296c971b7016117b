"""How far the place of each pole follows from its neighbours: rows and grids repeat themselves.

A tree of an avenue proves little: any other avenue with the same spacing has one there, too. A pole
is foretold by three neighbours that make a parallelogram with it, or by two in a row with it at
equal distances; chance puts a pole there more often than elsewhere, by
`share N(r; 0, spread^2)` with r the distance from the foretold place.
"""

from __future__ import annotations

from itertools import combinations_with_replacement

import numpy as np
import scipy
from numpy.typing import NDArray

Floats = NDArray[np.float64]

_NEIGHBOURS = 6
_REACH_M = 25.0
_SHARE = 0.8  # of foretold places that hold a pole
_SPREAD_M = 0.3  # of places that are foretold by three poles, each set to a decimetre or two


def chance_density(points_m: Floats, density_per_m2: float) -> Floats:
    """Density `(n,)` of poles by chance at the places of poles `(n, 2)`, 1/m^2.

    Args:
        density_per_m2: of poles that nothing foretells.
    """
    n = len(points_m)
    if n < 3:
        return np.full(n, density_per_m2)
    distance, rows = scipy.spatial.KDTree(points_m).query(points_m, k=min(_NEIGHBOURS + 1, n))
    near, known = np.asarray(rows)[:, 1:], np.asarray(distance)[:, 1:] <= _REACH_M
    triples = np.array(
        [
            (i, k, m)
            for i, k in combinations_with_replacement(range(near.shape[1]), 2)
            for m in range(near.shape[1])
            if m not in (i, k)
        ]
    ).reshape(-1, 3)
    one, two, less = (points_m[near[:, triples[:, c]]] for c in range(3))
    rest = one + two - less - points_m[:, np.newaxis]
    squared = rest[..., 0] ** 2 + rest[..., 1] ** 2
    squared = np.where(known[:, triples].all(axis=2), squared, np.inf)
    peak = _SHARE / (2.0 * np.pi * _SPREAD_M**2)
    return np.asarray(density_per_m2 + peak * np.exp(-0.5 * squared.min(axis=1) / _SPREAD_M**2))
