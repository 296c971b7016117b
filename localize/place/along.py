"""The search along a recorded drive: how far it must be driven until the place is known."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.detections import Detections
from polemap.drivelog.landmark_kind import LandmarkKind
from polemap.drivelog.streams import OdometryStream
from polemap.localize.odometry_history import OdometryHistory
from polemap.localize.place.finder import WRONG_MOST, PlaceFinder, Search
from polemap.map.pattern_index.index import PatternIndex

Floats = NDArray[np.float64]

SEARCH_EVERY_M = 5.0


@dataclass(frozen=True, slots=True)
class Found:
    """How a search along a drive ended.

    Attributes:
        search: the last one; None where too few poles were ever seen.
        claimed: whether its first place is taken for the car's.
        stamp_s: of the scan that it was made at, NaN without one.
        after_m, after_s: way and time since the begin.
        searches: how many were made.
    """

    search: Search | None
    claimed: bool
    stamp_s: float
    after_m: float
    after_s: float
    searches: int


def find_along(
    scans: Sequence[Detections],
    odometry: OdometryStream,
    index: PatternIndex,
    *,
    since_s: float = -np.inf,
    slip_rad_per_mps2: float = 0.0,
    wrong_most: float = WRONG_MOST,
    advance: Callable[[int], None] = lambda _scans: None,
) -> Found:
    """Drive on from a stamp until the place is known, or the drive ends.

    Args:
        scans: by stamp; rows that are no poles are left out.
        odometry: of the same drive.
        index: of the map.
        since_s: nothing before it is used.
        slip_rad_per_mps2: see `OdometryHistory`.
        wrong_most: probability of a wrong claim that is accepted.
        advance: is called with the scans that are done.
    """
    history = OdometryHistory(slip_rad_per_mps2)
    finder = PlaceFinder(index)
    row = int(np.searchsorted(odometry.stamp_s, since_s))
    found: Search | None = None
    begin_s = stamp_s = begin_m = way_m = searched_m = np.nan
    searches = 0
    for scan in scans:
        advance(1)
        if scan.stamp_s < since_s:
            continue
        while row < len(odometry) and odometry.stamp_s[row] <= scan.stamp_s:
            history.append(odometry.sample(row))
            row += 1
        if not len(history):
            continue
        stamp_s, way_m = scan.stamp_s, history.travelled_m(scan.stamp_s)
        if np.isnan(begin_s):
            begin_s, begin_m, searched_m = stamp_s, way_m, way_m
        poles = scan.of_kinds(LandmarkKind.POLE)
        if not finder.add_scan(poles, history.odometry_pose(stamp_s), way_m):
            continue
        if way_m - searched_m < SEARCH_EVERY_M:
            continue
        searched_m = way_m
        searches += 1
        latest = finder.search()
        found = latest if latest is not None else found
        if latest is not None and latest.wrong <= wrong_most:
            return Found(latest, True, stamp_s, way_m - begin_m, stamp_s - begin_s, searches)
    after_m = 0.0 if np.isnan(begin_s) else way_m - begin_m
    after_s = 0.0 if np.isnan(begin_s) else stamp_s - begin_s
    return Found(found, False, stamp_s, after_m, after_s, searches)
