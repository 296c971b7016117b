"""Places for the particle filter where no fix narrows the search: the poles of the way tell."""

from __future__ import annotations

import logging
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.detections import Detections
from polemap.drivelog.errors import InputError
from polemap.drivelog.frames import EarthFrame, transform_points
from polemap.localize.place.along import SEARCH_EVERY_M
from polemap.localize.place.finder import WRONG_MOST, PlaceFinder
from polemap.localize.place.local_map_builder import WINDOW_M, LocalMapBuilder
from polemap.localize.place.patterns import MapPatterns
from polemap.map.city.city_map import CityMap
from polemap.map.pole_map import PoleMap
from polemap.vehicle.pose import compose, pose_rotation, relative, rotate, wrap_angle

Floats = NDArray[np.float64]

_LOG = logging.getLogger("polemap")

PATTERNS_FROM = 1500
"""Poles of a map in memory from which on its patterns are searched; of smaller ones all pairs."""
# a car that was moved unknown to its odometry has poles of two places in the long window
_SHORT_M = 50.0
_AHEAD_M = 10.0  # two points tell the direction of north in another grid
# before an index is built, the first fix is awaited for so long a way
_AWAITED_M = 20.0
# a claim is carried by the odometry for so far
_HOLDS_M = 10.0


@dataclass(frozen=True, slots=True)
class Claim:
    """A place that is taken for the car's.

    Attributes:
        pose: `(3,)` of the rear axle.
        covariance: `(3, 3)`.
        matched: poles of the way that stand on poles of the map.
    """

    pose: Floats
    covariance: Floats
    matched: int


def patterns_of(pole_map: PoleMap | CityMap, *, background: bool) -> MapPatterns | None:
    """What gives the index of a map when it is first needed; None for a small map.

    Args:
        background: see `MapPatterns`.
    """
    if isinstance(pole_map, PoleMap) and len(pole_map) < PATTERNS_FROM:
        return None
    return MapPatterns(pole_map, background=background)


class PlaceClaims:
    """Follows the poles of the way and claims a place when it is asked for.

    Args:
        patterns: give the map's index.
        frame: of the claims; the index may be in another.
    """

    def __init__(self, patterns: MapPatterns, frame: EarthFrame) -> None:
        self._patterns, self._frame = patterns, frame
        self._builders = LocalMapBuilder(WINDOW_M), LocalMapBuilder(_SHORT_M)
        self._finders: tuple[PlaceFinder, ...] | None = None
        self._index_frame = frame
        self._begin_m: float | None = None
        self._way_m = 0.0
        self._searched_m = -np.inf
        self._searches = 0
        self._claim: Claim | None = None
        self._claimed_at = np.zeros(3)
        self._claimed_m = -np.inf

    def use_patterns(self, patterns: MapPatterns) -> None:
        """Go on with another map of the same frame."""
        self._patterns, self._finders, self._claim = patterns, None, None

    def forget(self) -> None:
        """The poles so far stand in no known relation to what comes."""
        self._builders = LocalMapBuilder(WINDOW_M), LocalMapBuilder(_SHORT_M)
        self._finders, self._claim = None, None

    def add_scan(self, scan: Detections, odometry_pose: Floats, travelled_m: float) -> None:
        """Take in a scan and the dead-reckoned pose `(3,)` of its moment."""
        self._way_m = travelled_m
        self._begin_m = travelled_m if self._begin_m is None else self._begin_m
        for builder in self._builders:
            builder.add_scan(scan, odometry_pose, travelled_m)

    def claim(self, odometry_pose: Floats, *, needed: bool) -> Claim | None:
        """The car's place at a dead-reckoned pose `(3,)`; None while it may be elsewhere.

        A search is made every few metres, in the long and in the short window in turn.

        Args:
            needed: nothing else tells the place, see `MapPatterns.index`.
        """
        if self._way_m - self._searched_m >= SEARCH_EVERY_M:
            self._search(needed=needed)
        if self._claim is None or self._way_m - self._claimed_m > _HOLDS_M:
            return None
        moved = relative(self._claimed_at, odometry_pose)
        return Claim(compose(self._claim.pose, moved), self._claim.covariance, self._claim.matched)

    def _search(self, *, needed: bool) -> None:
        if self._finders is None:
            awaited = self._begin_m is None or self._way_m - self._begin_m < _AWAITED_M
            index = self._patterns.index(needed=needed and not awaited)
            if index is None:
                return
            self._finders = tuple(PlaceFinder(index, builder) for builder in self._builders)
            self._index_frame = index.frame
        self._searched_m = self._way_m
        self._searches += 1
        finder = self._finders[self._searches % 2]
        try:
            search = finder.search()
        except InputError as error:
            # the filter goes on without: what is damaged is no reason to stop a car
            _LOG.warning("%s", error)
            self._patterns.give_up()
            self._finders = self._claim = None
            return
        if search is None or search.wrong_at_most > WRONG_MOST:
            return
        pose, covariance = search.poses[0], search.covariance[0]
        if self._index_frame != self._frame:
            pose, covariance = _in_frame(pose, covariance, self._index_frame, self._frame)
        self._claim = Claim(pose, covariance, int(search.matched[0]))
        self._claimed_at, self._claimed_m = finder.odometry_pose, self._way_m


def _in_frame(
    pose: Floats, covariance: Floats, source: EarthFrame, target: EarthFrame
) -> tuple[Floats, Floats]:
    """A pose `(3,)` and its covariance `(3, 3)` of one grid in another."""
    ahead = pose[:2] + rotate(np.array([_AHEAD_M, 0.0]), pose[2])
    there, before = transform_points(np.stack([pose[:2], ahead]), source, target)
    yaw = float(np.arctan2(*(before - there)[::-1]))
    turn = pose_rotation(wrap_angle(yaw - pose[2]))
    return np.array([*there, yaw]), turn @ covariance @ turn.T
