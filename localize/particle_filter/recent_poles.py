"""The poles of the last metres, joined by the odometry: more than one scan shows."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.detections import Detections
from polemap.vehicle.pose import inverse_transform_points, transform_points

Floats = NDArray[np.float64]

REMEMBERED_M = 45.0
"""Way after which a pole is forgotten: dead reckoning has bent the pattern."""
_REMEMBERED_S = 20.0
_MERGE_M = 0.8
_MOST_POLES = 40
_INTERVAL_S = 0.15  # a tenth of the scans of a camera holds the same poles


class RecentPoles:
    """The poles of the last metres in the dead-reckoning frame: more than one scan shows."""

    def __init__(self) -> None:
        self._points = np.empty((0, 2))
        self._seen = np.empty(0, dtype=np.int64)
        self._last_m = np.empty(0)
        self._last_s = np.empty(0)
        self._added_s = -np.inf

    def add_scan(self, scan: Detections, odometry_pose: Floats, travelled_m: float) -> None:
        """Add a scan taken at the dead-reckoned rear-axle pose `(3,)`."""
        if scan.stamp_s - self._added_s < _INTERVAL_S:
            return
        self._added_s = scan.stamp_s
        keep = (self._last_m > travelled_m - REMEMBERED_M) & (
            self._last_s > scan.stamp_s - _REMEMBERED_S
        )
        self._take(keep)
        for point in transform_points(odometry_pose, scan.points_vehicle_m.reshape(-1, 2)):
            self._merge(point, travelled_m, scan.stamp_s)
        if len(self._points) > _MOST_POLES:
            recent = np.argsort(-self._last_s, kind="stable")[:_MOST_POLES]
            self._take(np.sort(recent))

    def _take(self, rows: NDArray[np.bool_] | NDArray[np.int64]) -> None:
        self._points, self._seen = self._points[rows], self._seen[rows]
        self._last_m, self._last_s = self._last_m[rows], self._last_s[rows]

    def _merge(self, point: Floats, travelled_m: float, stamp_s: float) -> None:
        if len(self._points):
            distance = np.hypot(*(self._points - point).T)
            nearest = int(np.argmin(distance))
            if distance[nearest] < _MERGE_M:
                # the newest sighting counts most: dead reckoning drifts under the old ones
                self._points[nearest] += 0.4 * (point - self._points[nearest])
                self._seen[nearest] += 1
                self._last_m[nearest], self._last_s[nearest] = travelled_m, stamp_s
                return
        self._points = np.vstack([self._points, point])
        self._seen = np.append(self._seen, 1)
        self._last_m = np.append(self._last_m, travelled_m)
        self._last_s = np.append(self._last_s, stamp_s)

    def around(self, odometry_pose: Floats) -> Floats:
        """The remembered poles `(k, 2)` in the vehicle frame of a dead-reckoned pose.

        Poles that were seen once only are left out while enough others remain.
        """
        points = self._points[self._seen >= 2]
        if len(points) < 4:
            points = self._points
        return inverse_transform_points(odometry_pose, points)
