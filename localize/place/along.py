"""The search along a recorded drive: how far it must be driven until the place is known."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from polemap.drivelog.detections import Detections
from polemap.drivelog.landmark_kind import LandmarkKind
from polemap.drivelog.streams import OdometryStream
from polemap.localize.odometry_history import OdometryHistory
from polemap.localize.place.finder import WRONG_MOST, PlaceFinder, Search
from polemap.map.pattern_index.index import PatternIndex

SEARCH_EVERY_M = 5.0


@dataclass(frozen=True, slots=True)
class Searched:
    """One search on the way.

    Attributes:
        search: None where too few poles were seen.
        stamp_s: of its newest scan.
        after_m, after_s: way and time since the begin.
    """

    search: Search | None
    stamp_s: float
    after_m: float
    after_s: float


@dataclass(frozen=True, slots=True)
class Found:
    """How a search along a drive ended.

    Attributes:
        search: the last one with a place; None where too few poles were ever seen.
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


def searches_along(
    scans: Sequence[Detections],
    odometry: OdometryStream,
    index: PatternIndex,
    *,
    since_s: float = -np.inf,
    slip_rad_per_mps2: float = 0.0,
    advance: Callable[[int], None] = lambda _scans: None,
) -> Iterator[Searched]:
    """Search every few metres, to the end of the drive.

    Args:
        scans: by stamp; rows that are no poles are left out.
        odometry: of the same drive.
        index: of the map.
        since_s: nothing before it is used.
        slip_rad_per_mps2: see `OdometryHistory`.
        advance: is called with the scans that are done.
    """
    history = OdometryHistory(slip_rad_per_mps2)
    finder = PlaceFinder(index)
    row = int(np.searchsorted(odometry.stamp_s, since_s))
    begin_s = begin_m = searched_m = np.nan
    for scan in scans:
        advance(1)
        if scan.stamp_s < since_s:
            continue
        while row < len(odometry) and odometry.stamp_s[row] <= scan.stamp_s:
            history.append(odometry.sample(row))
            row += 1
        if not len(history):
            continue
        way_m = history.travelled_m(scan.stamp_s)
        if np.isnan(begin_s):
            begin_s, begin_m, searched_m = scan.stamp_s, way_m, way_m
        poles = scan.of_kinds(LandmarkKind.POLE)
        taken = finder.add_scan(poles, history.odometry_pose(scan.stamp_s), way_m)
        if taken and way_m - searched_m >= SEARCH_EVERY_M:
            searched_m = way_m
            yield Searched(finder.search(), scan.stamp_s, way_m - begin_m, scan.stamp_s - begin_s)


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
    """Drive on from a stamp until the place is known, or the drive ends; see `searches_along`.

    Args:
        wrong_most: bound on the probability of a wrong claim that is accepted.
    """
    found = Found(None, False, np.nan, 0.0, 0.0, 0)
    made = searches_along(
        scans, odometry, index, since_s=since_s, slip_rad_per_mps2=slip_rad_per_mps2,
        advance=advance,
    )  # fmt: skip
    for number, one in enumerate(made, start=1):
        search = one.search if one.search is not None else found.search
        claimed = one.search is not None and one.search.wrong_at_most <= wrong_most
        found = Found(search, claimed, one.stamp_s, one.after_m, one.after_s, number)
        if claimed:
            break
    return found
