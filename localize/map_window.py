"""The part of a map that the localizer works with: what lies around the car, loaded ahead.

A map in memory is its own window. Of a city's map the poles of a square around the car are kept.
When the car comes near the square's edge the next one is read: in a replay at once, at the scan
that asks for it, so that the same samples give the same poses; in a car by a thread, and the next
scan after it has ended takes what it has read.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from threading import Thread
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.detections import Detections
from polemap.drivelog.landmark_kind import LandmarkKind
from polemap.map.city.city_map import CityMap
from polemap.map.city.tiles import Area, box_around, inside
from polemap.map.pole_map import PoleMap
from polemap.vehicle.pose import transform_points

Floats = NDArray[np.float64]

# around the car the map must be known as far as sensors see (60 m) and as the search near a fix
# asks: 40 m or three deviations around it, 45 m of poles behind the car, pairs of 30 m and the
# search's own 60 m ahead; with 300 m deviations up to 40 m are served
NEEDED_M = 300.0
# so much is read: at 50 km/h, one read in twenty seconds, which takes a hundredth of one
LOADED_M = 600.0
# particles begin only where this share of it is known: as far as sensors see, and a fix may be off
_START_SHARE = 0.5
# the square is laid ahead of the car by the way of some seconds; a car that turns round keeps 450 m
_AHEAD_S, _AHEAD_MAX_M = 5.0, 150.0
# a pole seen so near the unknown may stand in it
_DOUBT_M = 3.0


class MapUser(Protocol):
    """Holds scans against the poles around the car."""

    def use_map(self, pole_map: PoleMap, /) -> None:
        """Go on with other poles, of the same frame."""


def of_kinds(pole_map: PoleMap, chosen: frozenset[LandmarkKind]) -> PoleMap:
    """The landmarks of some kinds; the map itself where it holds no others."""
    rows = np.isin(pole_map.kind, list(chosen))
    if not rows.all():
        pole_map = pole_map.rows(rows)
    lines = pole_map.lines
    if lines is not None and not (mine := np.isin(lines.kind, list(chosen))).all():
        pole_map = replace(pole_map, lines=lines.take(mine))
    return pole_map


class MapWindow:
    """Poles around the car, of a map in memory or of a city's.

    Args:
        pole_map: the whole map.
        counts: `map_windows` (squares read), `map_tiles_damaged` and `poles_beyond_window` (seen
            where the map is not read yet, or cannot be) are counted here.
        background: read by a thread; a scan never waits for the disk.
        chosen: landmarks that count; the others of the map are left out.

    Attributes:
        poles: what to work with.
        kinds: every `LandmarkKind` of the whole map.
        users: are told of other poles.
    """

    def __init__(
        self, pole_map: PoleMap | CityMap, counts: Counter[str], *, background: bool,
        chosen: frozenset[LandmarkKind] = frozenset(LandmarkKind),
    ) -> None:  # fmt: skip
        self._chosen = chosen
        self._counts, self._background = counts, background
        self.users: list[MapUser] = []
        self.poles = PoleMap.empty(pole_map.frame)
        self._area: Area | None = None
        self._loading: _Load | None = None
        self._take(pole_map)

    @property
    def whole(self) -> bool:
        """Whether all poles of a map are here."""
        return self._area is None and self._city is None

    @property
    def waiting(self) -> bool:
        """Whether the first poles are being read."""
        return self._loading is not None and self._area is None and not len(self.poles)

    def exchange(self, pole_map: PoleMap | CityMap) -> None:
        """Go on with another map; the poles of the old one serve until those around are read."""
        self._take(pole_map)
        if self._city is None:
            self._tell()

    def follow(self, places_m: Sequence[Floats], velocity_mps: Floats) -> None:
        """Have the poles around places `(2,)` where the car may be, and tell the users of others.

        Args:
            places_m: the likeliest first.
            velocity_mps: `(2,)` east, north: that of the first place.
        """
        city = self._city
        if city is None:
            return
        if self._loading is not None and not self._loading.is_alive():
            load, self._loading = self._loading, None
            self._show(load, city)
        if self._loading is not None or not places_m:
            return
        if self._fresh and self._area is not None:
            boxes = self._area.boxes
            if all(_reaches_around(boxes, place) for place in places_m):
                return
        load = _Load(city, _boxes_for(places_m, velocity_mps))
        if self._background:
            self._loading = load
            load.start()
        else:
            load.run()
            self._show(load, city)

    def opened_at(self, poses: Floats) -> bool:
        """Whether the poles around where a start's poses `(n, 3)` lie are here; else they are read.

        Poses around a fix find the window that the fix has opened; those of a claimed place in a
        city may lie anywhere.
        """
        if self._city is None:
            return True
        middle = np.median(poses[:, :2], axis=0)
        self.follow([middle], np.zeros(2))
        opened = self._area is not None and _reaches_around(self._area.boxes, middle, _START_SHARE)
        if not opened:
            self._counts["scans_before_map"] += 1
        return opened

    def mapped(self, scan: Detections, pose: Floats) -> Detections:
        """What of a scan can be held against the map from a pose `(3,)`.

        Where the map is not read, nothing is expected, so nothing seen there is strange either.
        """
        if self._area is None or not len(scan):
            return scan
        points = transform_points(pose, scan.points_vehicle_m)
        wider = self._area.unread + np.array([-_DOUBT_M, -_DOUBT_M, _DOUBT_M, _DOUBT_M])
        known = inside(self._area.boxes, points) & ~inside(wider, points)
        if known.all():
            return scan
        self._counts["poles_beyond_window"] += int(np.count_nonzero(~known))
        return scan.take(known)

    def _take(self, pole_map: PoleMap | CityMap) -> None:
        self._loading = None
        self._fresh = False  # whether `_area` is of this map
        if isinstance(pole_map, CityMap):
            self._city: CityMap | None = pole_map
            kinds = pole_map.kinds
        else:
            self._city, self._area = None, None
            self.poles = of_kinds(pole_map, self._chosen)
            kinds = tuple(np.unique(self.poles.kind).tolist())
        self.kinds = tuple(kind for kind in kinds if kind in self._chosen)

    def _show(self, load: _Load, city: CityMap) -> None:
        if load.error is not None:
            raise load.error
        assert load.area is not None
        self._area, self._fresh = load.area, True
        self.poles = of_kinds(load.area.poles, self._chosen)
        self._counts["map_windows"] += 1
        if city.damaged:
            self._counts["map_tiles_damaged"] = len(city.damaged)
        self._tell()

    def _tell(self) -> None:
        for user in self.users:
            user.use_map(self.poles)


class _Load(Thread):
    """Reads boxes of a city, and builds the index of their poles."""

    def __init__(self, city: CityMap, boxes: Floats) -> None:
        super().__init__(name="polemap-window", daemon=True)
        self._city, self._boxes = city, boxes
        self.area: Area | None = None
        self.error: Exception | None = None

    def run(self) -> None:
        """See `Thread`; what goes wrong is raised where the poles are taken."""
        try:
            area = self._city.area(self._boxes)
            _ = area.poles.tree
            self.area = area
        except Exception as error:
            self.error = error


def _boxes_for(places_m: Sequence[Floats], velocity_mps: Floats) -> Floats:
    """Squares `(k, 4)` to read: ahead of the first place, and around others that it leaves out."""
    speed = float(np.hypot(*velocity_mps))
    ahead = velocity_mps * min(_AHEAD_S, _AHEAD_MAX_M / max(speed, 1e-9))
    boxes = box_around(places_m[0] + ahead, LOADED_M)[np.newaxis]
    for place in places_m[1:]:
        if not _reaches_around(boxes, place):
            boxes = np.vstack([boxes, box_around(place, LOADED_M)])
    return boxes


def _reaches_around(boxes: Floats, place: Floats, share: float = 1.0) -> bool:
    """Whether one of the boxes `(k, 4)` reaches as far around a place as must be known, or so
    large a share of it."""
    reach_m = share * NEEDED_M
    low, high = boxes[:, :2] + reach_m, boxes[:, 2:] - reach_m
    return bool(((place >= low) & (place <= high)).all(axis=1).any())
