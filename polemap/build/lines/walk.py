"""From samples on ridges to polylines: walk along each ridge until nothing goes on."""

from __future__ import annotations

import numpy as np
import scipy
from numpy.typing import NDArray

from polemap.build.lines.ridges import ACROSS_M, DIRECTION_RAD, Samples
from polemap.drivelog.landmark_kind import LandmarkKind

Floats = NDArray[np.float64]
Whole = NDArray[np.int64]

_STRIDE_M = 2.0
_REACH_M = 1.5
# gaps that a line may have and still be one: those between dashes, a driveway's lowered kerb
_GAP_M = {LandmarkKind.LANE_MARKING: 14.0}
_GAP_OTHERS_M = 4.0


def walk(samples: Samples, kind: int) -> list[Floats]:
    """Polylines `(k, 2)`, k at least 2; the order of the samples does not matter."""
    if not len(samples.piece):
        return []
    walker = _Walker(samples, _GAP_M.get(LandmarkKind(kind), _GAP_OTHERS_M))
    found = []
    # heaviest ridges first, ties by their place
    heft = walker.heft
    for seed in np.lexsort((*samples.points_m.T, -heft)):
        if walker.free[seed]:
            line = walker.line_from(int(seed))
            if len(line) >= 2:
                found.append(line)
    return found


class _Walker:
    """Samples not yet walked over, `free`, and the weight around each, `heft`."""

    def __init__(self, samples: Samples, gap_m: float) -> None:
        self._points, self._weight = samples.points_m, samples.weight
        self._unit = np.column_stack([np.cos(samples.direction_rad), np.sin(samples.direction_rad)])
        self._gap_m = gap_m
        self._tree = scipy.spatial.KDTree(self._points)
        self.free = np.ones(len(self._points), dtype=bool)
        near = self._tree.query_ball_point(self._points, 0.5 * _REACH_M)
        self.heft = np.array([self._weight[rows].sum() for rows in near])

    def line_from(self, seed: int) -> Floats:
        """The line through a sample, walked both ways."""
        start, ahead = self._points[seed], self._unit[seed]
        self._leave(start, ahead)
        forward = self._way(start, ahead)
        backward = self._way(start, -ahead)
        return np.array([*backward[::-1], start, *forward])

    def _way(self, place: Floats, ahead: Floats) -> list[Floats]:
        way: list[Floats] = []
        reached, gap = place, 0.0
        while gap <= self._gap_m:
            target = place + _STRIDE_M * ahead
            rows, unit = self._beside(target, ahead)
            if not len(rows):
                place, gap = target, gap + _STRIDE_M
                continue
            weight = self._weight[rows]
            offset = self._points[rows] - target
            normal = np.array([-ahead[1], ahead[0]])
            across = float(weight @ (offset @ normal) / weight.sum())
            mean = weight @ unit
            place = target + across * normal
            step = place - reached
            ahead = mean / np.hypot(*mean)
            # the way itself says more of the direction than a single look
            if not gap:
                ahead = ahead + step / np.hypot(*step)
                ahead = ahead / np.hypot(*ahead)
            self._leave(place, ahead)
            way.append(place)
            reached, gap = place, 0.0
        return way

    def _beside(self, target: Floats, ahead: Floats) -> tuple[Whole, Floats]:
        """Free samples near the target that go on its way, and their directions along it."""
        rows = np.array(self._tree.query_ball_point(target, _REACH_M, return_sorted=True), np.int64)
        rows = rows[self.free[rows]]
        unit = self._unit[rows]
        unit = unit * np.where(unit @ ahead < 0.0, -1.0, 1.0)[:, None]
        normal = np.array([-ahead[1], ahead[0]])
        good = np.abs((self._points[rows] - target) @ normal) < ACROSS_M
        good &= unit @ ahead > np.cos(DIRECTION_RAD)
        return rows[good], unit[good]

    def _leave(self, place: Floats, ahead: Floats) -> None:
        """Nothing beside a place that was walked over begins a line of its own, or turns back."""
        rows = np.array(self._tree.query_ball_point(place, _REACH_M), np.int64)
        if not len(rows):
            return
        offset = self._points[rows] - place
        normal = np.array([-ahead[1], ahead[0]])
        walked = (np.abs(offset @ normal) < ACROSS_M) & (np.abs(offset @ ahead) <= 0.5 * _STRIDE_M)
        self.free[rows[walked]] = False
