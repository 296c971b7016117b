"""Which parameters of a fit the data tell from where they started."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

_TOLD_SD = 2.0


def told_from_start(units: Floats, covariance: Floats) -> NDArray[np.bool_]:
    """Backward elimination: which parameters cannot stay at their start, `(n,)`.

    The one that stands nearest to its start, in its deviations, is put back there and the others
    move as their correlation with it says, u - P_i / P_ii u_i; again, until all that are left
    stand two deviations off. One at a time, since of two that the data tell only together
    (the place of a reference and the rear tyres, say) the other has to answer for both.

    Args:
        units: `(n,)` fitted values less their starts.
        covariance: `(n, n)` of them.

    Source: N. R. Draper, H. Smith, Applied Regression Analysis, 3rd ed., 1998, ch. 15.
    """
    left, spread = units.astype(np.float64), covariance.astype(np.float64)
    told = np.ones(len(units), dtype=bool)
    while told.any():
        sds = np.sqrt(np.maximum(np.diag(spread), 0.0))
        off = np.where(told, np.abs(left) / np.maximum(sds, 1e-12), np.inf)
        nearest = int(np.argmin(off))
        if off[nearest] >= _TOLD_SD:
            break
        told[nearest] = False
        moved = spread[:, nearest] / spread[nearest, nearest]
        left = left - moved * left[nearest]
        spread = spread - np.outer(moved, spread[nearest])
    return told
