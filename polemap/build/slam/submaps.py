"""Local maps of poles along the routes: what is matched as a whole when a place is seen again."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from polemap.build.slam.constants import SUBMAP_M
from polemap.build.slam.route import Route
from polemap.build.slam.tables import Sightings, pose_starts
from polemap.vehicle.pose import inverse_transform_points

Floats = NDArray[np.float64]
Whole = NDArray[np.int64]

_SEEN_MIN = 3  # keyframes of the stretch that saw a landmark


@dataclass(frozen=True, slots=True)
class Submap:
    """The poles of one stretch of a route in the frame of its anchor.

    Attributes:
        route: number of the drive; anchor: keyframe through all routes.
        landmark: `(n,)` numbers; points_m: `(n, 2)` in the anchor's frame.
        width_m: `(n,)`, NaN where unknown; kind: `(n,)`.
        way_m: `(k, 2)` keyframes of the stretch in the anchor's frame.
        reach_m: how far from the way poles were seen.
    """

    route: int
    anchor: int
    landmark: Whole
    points_m: Floats
    width_m: Floats
    kind: NDArray[np.int8]
    way_m: Floats
    reach_m: float

    def __len__(self) -> int:
        return len(self.landmark)


def cut_submaps(
    routes: Sequence[Route],
    sightings: Sightings,
    points_m: Floats,
    width_m: Floats,
    kind: NDArray[np.int8],
) -> list[Submap]:
    """Local maps of every stretch of `submap_m`, at the poses and landmarks solved so far."""
    starts = pose_starts(routes)
    submaps = []
    for number, route in enumerate(routes):
        way = np.interp(route.stamp_s, route.path.stamp_s, route.path.travelled_m)
        count = max(1, round(way[-1] / SUBMAP_M))
        part = np.minimum((way / max(way[-1], 1e-9) * count).astype(np.int64), count - 1)
        for stretch in range(count):
            mine = np.flatnonzero(part == stretch)
            if not len(mine):
                continue
            middle = 0.5 * (way[mine[0]] + way[mine[-1]])
            row = int(mine[np.argmin(np.abs(way[mine] - middle))])
            first, last = starts[number] + mine[0], starts[number] + mine[-1]
            seen = (sightings.pose >= first) & (sightings.pose <= last)
            landmark, times = np.unique(sightings.landmark[seen], return_counts=True)
            landmark = landmark[times >= _SEEN_MIN]
            if not len(landmark):
                continue
            pose = route.poses[row]
            reach = float(np.quantile(np.hypot(*sightings.point_m[seen].T), 0.9))
            submaps.append(
                Submap(
                    route=number,
                    anchor=int(starts[number] + row),
                    landmark=landmark.astype(np.int64),
                    points_m=inverse_transform_points(pose, points_m[landmark]),
                    width_m=width_m[landmark],
                    kind=kind[landmark],
                    way_m=inverse_transform_points(pose, route.poses[mine, :2]),
                    reach_m=reach,
                )
            )
    return submaps
