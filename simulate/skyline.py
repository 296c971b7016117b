"""What houses hide of the sky beside a street, and where GNSS receivers hear their echoes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from polemap.vehicle.pose import rotate, rotate_back

Floats = NDArray[np.float64]
_ANTENNA_M = 1.5
# fronts lower than this do no harm, those higher than that as much as a front can
_LOW_RAD, _HIGH_RAD = np.deg2rad(18.0), np.deg2rad(50.0)


@dataclass(frozen=True, slots=True)
class Fronts:
    """Street fronts of houses, `(n,)` each: middle, heading along the front, width, height."""

    x_m: Floats
    y_m: Floats
    yaw_rad: Floats
    width_m: Floats
    height_m: Floats

    @classmethod
    def of(cls, rows: list[tuple[float, float, float, float, float]]) -> Fronts:
        """From rows of x, y, yaw, width, height."""
        return cls(*np.array(rows, dtype=np.float64).reshape(-1, 5).T)


def echoes(places_m: Floats, fronts: Fronts) -> tuple[Floats, Floats]:
    """How much the highest front in sight disturbs, 0 to 1, `(m,)`, and its direction `(m, 2)`.

    The direction is a unit vector, along which an echo makes the place wrong: the way of a
    reflected signal is longer by what lies between antenna and front.
    """
    share, toward = np.zeros(len(places_m)), np.zeros((len(places_m), 2))
    toward[:, 0] = 1.0
    if len(fronts.x_m) == 0:
        return share, toward
    middle = np.stack([fronts.x_m, fronts.y_m], axis=-1)
    for row, (x, y) in enumerate(places_m):
        offset = (x, y) - middle
        along = rotate_back(offset, fronts.yaw_rad)[:, 0]
        along = np.clip(along, -fronts.width_m / 2, fronts.width_m / 2)
        on_front = np.stack([along, np.zeros_like(along)], axis=-1)
        gap_x, gap_y = (offset - rotate(on_front, fronts.yaw_rad)).T
        distance = np.maximum(np.hypot(gap_x, gap_y), 0.5)
        rise = np.arctan2(fronts.height_m - _ANTENNA_M, distance)
        worst = int(np.argmax(rise))
        share[row] = np.clip((rise[worst] - _LOW_RAD) / (_HIGH_RAD - _LOW_RAD), 0.0, 1.0)
        toward[row] = -gap_x[worst] / distance[worst], -gap_y[worst] / distance[worst]
    return share, toward
