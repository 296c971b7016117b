"""Maps and scans of plain poles: all alike, surely there, where a test wants them."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from polemap.drivelog.detections import Detections, pole_detections
from polemap.drivelog.frames import EarthFrame
from polemap.map.pole_map import PoleMap


def plain_map(
    points_m: ArrayLike,
    *,
    name: str = "test",
    variance_m2: float = 0.01,
    width_m: float = 0.3,
    height_m: float = np.nan,
) -> PoleMap:
    """Poles at `(n, 2)` in a local frame, each seen once by one drive."""
    points = np.asarray(points_m, dtype=np.float64)
    n = len(points)
    once = np.ones(n, dtype=np.int64)
    return PoleMap(
        frame=EarthFrame("local", name=name),
        ids=np.arange(n),
        points_m=points,
        covariance_m2=np.tile(np.eye(2) * variance_m2, (n, 1, 1)),
        width_m=np.full(n, width_m),
        height_m=np.full(n, height_m),
        observations=once,
        drives=once.copy(),
        existence=np.ones(n),
    )


def plain_scan(
    stamp_s: float, points_vehicle_m: ArrayLike, *, variance_m2: float = 0.01, width_m: float = 0.3
) -> Detections:
    """Poles seen at `(n, 2)` in the vehicle frame, not tracked, and here at once."""
    points = np.asarray(points_vehicle_m, dtype=np.float64)
    n = len(points)
    return pole_detections(
        stamp_s,
        stamp_s,
        points,
        np.tile(np.eye(2) * variance_m2, (n, 1, 1)),
        width_m=np.full(n, width_m),
    )
