"""Keeps the scans of the last metres, for the local map of their poles."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.detections import Detections, VisibleRegion
from polemap.drivelog.landmark_kind import LandmarkKind
from polemap.localize.place.coverage import seen_ground
from polemap.localize.place.local_map import DRIFT_SD, LocalMap, Look, joined
from polemap.vehicle.pose import rotate_covariance, transform_points

Floats = NDArray[np.float64]
Whole = NDArray[np.int64]

WINDOW_M = 150.0
"""Way after which scans are forgotten."""
_STEP_M = 0.8  # between scans that are kept: their errors are hardly new before
_FLOOR_M = 0.05  # of every sighting: what detectors do not state, trunks that are no lines
_SAME_GATE = 9.0  # squared Mahalanobis distance of sightings of one pole
_SAME_M = 1.5


@dataclass(frozen=True, slots=True)
class _Scan:
    scan: Detections
    odometry_pose: Floats
    travelled_m: float


class LocalMapBuilder:
    """Keeps the scans of the last metres; which of their poles are the same is found when asked."""

    def __init__(self, window_m: float = WINDOW_M) -> None:
        self._window_m = window_m
        # a car that knows where it is asks for no place: of its scans no pole is compared
        self._scans: deque[_Scan] = deque()
        self._looks: deque[Look] = deque()  # of the first of these
        self._last_m = np.empty((0, 2))
        self._last_covariance = np.empty((0, 2, 2))
        self._last_look_m = np.empty(0)
        self._numbers = np.empty(0, dtype=np.int64)
        self._next = 0
        self._drift = np.zeros(3)
        self._view: VisibleRegion | None = None
        self._seen = np.empty((0, 3))

    @property
    def odometry_pose(self) -> Floats:
        """The dead-reckoned pose `(3,)` of the newest scan that was kept."""
        return self._scans[-1].odometry_pose.copy() if self._scans else np.zeros(3)

    def add_scan(self, scan: Detections, odometry_pose: Floats, travelled_m: float) -> bool:
        """Take in a scan from a dead-reckoned pose `(3,)`; False if the car has hardly moved."""
        if self._scans and abs(travelled_m - self._scans[-1].travelled_m) < _STEP_M:
            return False
        self._scans.append(_Scan(scan, np.array(odometry_pose), travelled_m))
        while self._scans[0].travelled_m < travelled_m - self._window_m:
            self._scans.popleft()
            if self._looks:
                self._looks.popleft()
        return True

    def _look(self, kept: _Scan) -> Look:
        scan, odometry_pose = kept.scan.of_kinds(LandmarkKind.POLE), kept.odometry_pose
        points = scan.points_vehicle_m.reshape(-1, 2)
        covariance = scan.covariance_m2.reshape(-1, 2, 2) + _FLOOR_M**2 * np.eye(2)
        pole = self._same(
            transform_points(odometry_pose, points),
            rotate_covariance(covariance, odometry_pose[2]),
            kept.travelled_m,
        )
        return Look(
            scan.stamp_s, odometry_pose, self._ground(scan.view), points, covariance,
            scan.width_m, pole,
        )  # fmt: skip

    def _ground(self, view: VisibleRegion | None) -> Floats:
        if view is None:
            return np.empty((0, 3))
        if view is not self._view:
            self._view, self._seen = view, seen_ground(view)
        return self._seen

    def _same(self, points: Floats, covariance: Floats, travelled_m: float) -> Whole:
        """Numbers `(z,)` of the poles that points `(z, 2)` in the dead-reckoning frame are of."""
        recent = self._last_look_m > travelled_m - self._window_m
        self._last_m, self._last_covariance = self._last_m[recent], self._last_covariance[recent]
        self._last_look_m, self._numbers = self._last_look_m[recent], self._numbers[recent]
        offset = points[:, np.newaxis] - self._last_m
        spread = covariance[:, np.newaxis] + self._last_covariance
        # the way since the last sighting may be wrong by some hundredths
        gone = 0.03 * np.abs(travelled_m - self._last_look_m)
        spread = spread + (gone**2)[:, np.newaxis, np.newaxis] * np.eye(2)
        squared = np.einsum(
            "zni,zni->zn", offset, np.linalg.solve(spread, offset[..., None])[..., 0]
        )
        distance = np.hypot(offset[..., 0], offset[..., 1])
        squared = np.where(distance < _SAME_M, squared, np.inf)
        number = np.full(len(points), -1, dtype=np.int64)
        row = np.full(len(points), -1, dtype=np.int64)
        while squared.size and squared.min() < _SAME_GATE:
            seen, known = np.unravel_index(int(squared.argmin()), squared.shape)
            number[seen], row[seen] = self._numbers[known], known
            squared[seen], squared[:, known] = np.inf, np.inf
        old = row >= 0
        self._last_m[row[old]], self._last_covariance[row[old]] = points[old], covariance[old]
        self._last_look_m[row[old]] = travelled_m
        new = np.flatnonzero(~old)
        number[new] = self._next + np.arange(len(new))
        self._next += len(new)
        self._last_m = np.concatenate([self._last_m, points[new]])
        self._last_covariance = np.concatenate([self._last_covariance, covariance[new]])
        self._last_look_m = np.append(self._last_look_m, np.full(len(new), travelled_m))
        self._numbers = np.append(self._numbers, number[new])
        return number

    def local_map(self) -> LocalMap | None:
        """What the scans of the window say together; None before the first pole."""
        for kept in islice(self._scans, len(self._looks), None):
            self._looks.append(self._look(kept))
        looks = list(self._looks)
        if not looks or not sum(len(look.pole) for look in looks):
            return None
        made, drift = joined(looks, self._drift)
        # what the scans so far have taught of the odometry is taken out of the next map
        self._drift = np.clip(drift, -4.0 * DRIFT_SD, 4.0 * DRIFT_SD)
        return made
