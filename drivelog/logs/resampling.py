"""Values at other stamps than those at which they were sampled."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from polemap.vehicle.pose import wrap_angle

Floats = NDArray[np.float64]


def held_or_linear(
    at_s: Floats,
    stamps_s: Floats,
    values: Floats,
    how: str,
    most_s: float,
    *,
    is_angle: bool = False,
) -> Floats:
    """Values `(n,)` at stamps `(n,)` from samples `(m,)`; NaN where they are too far away.

    Args:
        at_s: where values are asked for.
        stamps_s, values: the samples, stamps rising.
        how: `linear` between two samples, or `previous`.
        most_s: the two samples may be apart by this; the previous one may be as old.
        is_angle: radians, the short way around.
    """
    if not len(stamps_s):
        return np.full(len(at_s), np.nan)
    after = np.searchsorted(stamps_s, at_s, side="left")
    exact = (after < len(stamps_s)) & (stamps_s[np.minimum(after, len(stamps_s) - 1)] == at_s)
    before = np.where(exact, after, after - 1)
    inside = before >= 0
    low = np.maximum(before, 0)
    if how == "previous":
        return np.where(inside & (at_s - stamps_s[low] <= most_s), values[low], np.nan)
    high = np.minimum(np.where(exact, low, low + 1), len(stamps_s) - 1)
    near = inside & (
        exact | ((before + 1 < len(stamps_s)) & (stamps_s[high] - stamps_s[low] <= most_s))
    )
    smooth = np.unwrap(values) if is_angle else values
    found = np.interp(at_s, stamps_s, smooth)
    return np.where(near, wrap_angle(found) if is_angle else found, np.nan)
