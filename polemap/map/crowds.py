"""Where poles may stand, and how many of them: what no map has is an error of its file."""

from __future__ import annotations

import numpy as np

from polemap.drivelog.errors import InputError
from polemap.map.pole_map import PoleMap

# side of a square, and the most poles in it: a dense wood has 2000 trunks a hectare
CROWDS = ((1.0, 200), (100.0, 5000))
LARGEST_M = 1e9


def check_crowds(pole_map: PoleMap) -> None:
    """Positions on the earth, and nowhere more poles than matching in pairs can bear.

    Raises:
        InputError: a position that is none, or a crowd of poles.
    """
    points = pole_map.points_m
    if not len(points):
        return
    far = np.flatnonzero(np.abs(points).max(axis=1) > LARGEST_M)
    if len(far):
        east, north = points[far[0]]
        raise InputError(
            f"pole {pole_map.ids[far[0]]} stands at {east:.3g}, {north:.3g} m, beyond "
            f"{LARGEST_M:g} m"
        )
    for side_m, most in CROWDS:
        if len(points) <= most:
            continue
        cells, count = np.unique(np.floor(points / side_m), axis=0, return_counts=True)
        if count.max() > most:
            east, north = cells[count.argmax()] * side_m
            raise InputError(
                f"{count.max()} poles within {side_m:g} m of {east:.0f}, {north:.0f} m, a "
                f"map may have {most} there; remove what stands twice"
            )
