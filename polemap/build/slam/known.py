"""A map that is there already: its poles hold the graph, and the localizer says where to begin."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import scipy
from numpy.typing import NDArray

from polemap.build.slam.association import Seen
from polemap.build.slam.config import SlamConfig
from polemap.build.slam.constants import SAME_POLE_SD_M
from polemap.build.slam.initial import FIXES_MIN, lay_on_fixes
from polemap.build.slam.problem import Problem
from polemap.build.slam.route import Route
from polemap.drivelog.errors import InputError
from polemap.map.pole_map import KIND_COLUMN, PoleMap
from polemap.vehicle.pose import transform_points
from polemap.vehicle.trajectory import Trajectory

Floats = NDArray[np.float64]
Whole = NDArray[np.int64]

_GATE_M = 0.8  # of a landmark from a mapped pole that it may be
_FLOOR_M2 = 0.02**2
KNOWN_M = 0.5  # an axis: the localizer's poses that are worse tell no more than a fix
_EVERY_S = 2.0


@dataclass(frozen=True, slots=True)
class KnownPoles:
    """Poles of a map in the graph's frame: `(n, 2)`, `(n, 2, 2)`, `(n,)`."""

    points_m: Floats
    covariance_m2: Floats
    kind: NDArray[np.int8]

    @classmethod
    def of(cls, pole_map: PoleMap, shift_m: Floats) -> KnownPoles:
        """The poles of a map."""
        kind = pole_map.extra.get(KIND_COLUMN, np.zeros(len(pole_map)))
        return cls(
            pole_map.points_m - shift_m,
            pole_map.covariance_m2 + _FLOOR_M2 * np.eye(2),
            np.asarray(kind).astype(np.int8),
        )

    def match(self, points_m: Floats, kind: NDArray[np.int8], cannot_link: Whole) -> Whole:
        """The mapped pole that each landmark is, `(m,)`; -1 for none.

        The nearest within the gate; of landmarks that were seen side by side the nearer one.
        """
        pole = np.full(len(points_m), -1, dtype=np.int64)
        off = np.full(len(points_m), np.inf)
        for one in np.unique(kind):
            mine, theirs = np.flatnonzero(kind == one), np.flatnonzero(self.kind == one)
            if not len(theirs):
                continue
            distance, row = scipy.spatial.KDTree(self.points_m[theirs]).query(points_m[mine])
            near = np.asarray(distance) <= _GATE_M
            pole[mine[near]] = theirs[np.asarray(row)[near]]
            off[mine] = distance
        for first, second in cannot_link.tolist():
            if pole[first] >= 0 and pole[first] == pole[second]:
                pole[first if off[first] > off[second] else second] = -1
        return pole

    def hold(self, problem: Problem, seen: Seen) -> Problem:
        """The problem with links to mapped poles, which stay where the map has them."""
        count = len(seen.landmarks)
        pole = self.match(problem.points_m[:count], seen.landmarks.kind, seen.cannot_link)
        row = np.flatnonzero(pole >= 0)
        used, number = np.unique(pole[row], return_inverse=True)
        first = len(problem.points_m)
        link = np.column_stack([row, first + number]).astype(np.int64)
        return replace(
            problem,
            points_m=np.concatenate([problem.points_m, self.points_m[used]]),
            link=np.concatenate([problem.link, link]),
            link_sd_m=np.concatenate([problem.link_sd_m, np.full(len(link), SAME_POLE_SD_M)]),
            known=first + np.arange(len(used)),
            known_m=self.points_m[used],
            known_covariance_m2=self.covariance_m2[used],
            origin=np.empty(0, dtype=np.int64),
        )


def lay_on_localized(route: Route, found: Trajectory, shift_m: Floats, config: SlamConfig) -> Route:
    """The route on the localizer's poses where these are known, on fixes and odometry elsewhere.

    Raises:
        InputError: there are fewer than three such poses.
    """
    covariance = found.covariance
    if covariance is None:
        raise InputError(f"drive {route.name}: the localizer's poses lack their covariance")
    sd = np.sqrt(np.maximum(np.trace(covariance[:, :2, :2], axis1=1, axis2=2) / 2.0, 0.0))
    good = (sd <= KNOWN_M) & (found.stamp_s >= route.stamp_s[0])
    good &= found.stamp_s <= route.stamp_s[-1]
    rows = np.flatnonzero(good)
    if len(rows):
        tick = np.floor((found.stamp_s[rows] - found.stamp_s[rows[0]]) / _EVERY_S + 1e-6)
        rows = rows[np.concatenate([[True], np.diff(tick) > 0])]
    if len(rows) < FIXES_MIN:
        raise InputError(
            f"drive {route.name}: it was nowhere localized in the map to {KNOWN_M} m for long; "
            "learn from drives that begin in the map, or map it by itself"
        )
    poses = found.poses[rows] - np.array([*shift_m, 0.0])
    place = transform_points(poses, np.broadcast_to(route.antenna_m, (len(rows), 2)))
    # where the car is known, a fix that is metres off says nothing
    gap = np.abs(route.fix_s[:, None] - found.stamp_s[rows]).min(axis=1, initial=np.inf)
    far = gap > _EVERY_S
    stamps = np.concatenate([route.fix_s[far], found.stamp_s[rows]])
    points = np.concatenate([route.fix_m[far], place])
    hdop = np.concatenate([route.hdop[far], np.full(len(rows), KNOWN_M / config.gnss_sd_m)])
    order = np.argsort(stamps, kind="stable")
    marked = replace(route, fix_s=stamps[order], fix_m=points[order], hdop=hdop[order])
    laid = lay_on_fixes(marked, config)
    return replace(laid, fix_s=route.fix_s, fix_m=route.fix_m, hdop=route.hdop)
