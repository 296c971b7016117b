"""How often the ground around the way was looked at: where a pole should have been seen."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.detections import VisibleRegion

Floats = NDArray[np.float64]


def seen_ground(view: VisibleRegion) -> Floats:
    """Middles `(g, 2)` of the square metres of a view, vehicle frame, and in a third column what a
    look at each counts.

    Towards the limit R of its range a sensor misses more: the factor is `1 - (r / R)^2`.
    """
    reach = float(view.free_range_m.max())
    side = np.arange(-np.ceil(reach), np.ceil(reach)) + 0.5
    offset = np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2)
    points = offset + view.origin_vehicle_m
    rows = view.contains(points)
    weight = 1.0 - np.einsum("gi,gi->g", offset[rows], offset[rows]) / reach**2
    return np.column_stack([points[rows], weight])


@dataclass(frozen=True, slots=True)
class Coverage:
    """How often the ground around the way was looked at, by squares of a metre.

    Attributes:
        origin_m: `(2,)` of the first square, in the frame of the local map.
        looks: `(columns, rows)`.
    """

    origin_m: Floats
    looks: Floats

    @classmethod
    def of(cls, ground: Floats) -> Coverage | None:
        """Of places and looks `(g, 3)`, as `LocalMap.ground` has them; None without any: the sensor
        does not say where it looks."""
        if not len(ground):
            return None
        points, weight = ground[:, :2], ground[:, 2]
        origin = np.floor(points.min(axis=0))
        column, row = np.floor(points - origin).astype(np.int64).T
        shape = (int(column.max()) + 1, int(row.max()) + 1)
        looks = np.bincount(column * shape[1] + row, weight, minlength=shape[0] * shape[1])
        return cls(origin, looks.astype(np.float64).reshape(shape))

    @property
    def middle_m(self) -> Floats:
        """Its middle `(2,)`."""
        return np.asarray(self.origin_m + 0.5 * np.array(self.looks.shape))

    @property
    def radius_m(self) -> float:
        """From the middle to the farthest square."""
        return float(0.5 * np.hypot(*self.looks.shape))

    def looks_at(self, points_m: Floats) -> Floats:
        """How often points `(n, 2)` were looked at, `(n,)`."""
        place = np.floor(points_m - self.origin_m).astype(np.int64)
        inside = ((place >= 0) & (place < self.looks.shape)).all(axis=1)
        place[~inside] = 0
        return np.where(inside, self.looks[place[:, 0], place[:, 1]], 0.0)
