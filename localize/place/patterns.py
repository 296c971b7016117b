"""The index of a localizer's map: beside it, or built when it is first needed."""

from __future__ import annotations

import logging
from threading import Thread

from polemap.drivelog.errors import PolemapError
from polemap.map.city.city_map import CityMap
from polemap.map.pattern_index.build import build_index
from polemap.map.pattern_index.index import PatternIndex
from polemap.map.pole_map import PoleMap

_LOG = logging.getLogger("polemap")


class MapPatterns:
    """Gives the index of a map.

    Of a map in memory it is built at the first question. A city's stands beside its file; where it
    does not, it is built when nothing else can tell where the car is, which is told of.

    Args:
        pole_map: the map.
        background: it is built by a thread; a scan never waits for it.
    """

    def __init__(self, pole_map: PoleMap | CityMap, *, background: bool) -> None:
        self._map, self._background = pole_map, background
        self._index: PatternIndex | None = None
        self._given_up = False
        self._building: Thread | None = None

    def index(self, *, needed: bool) -> PatternIndex | None:
        """The index; None where there is none yet.

        Args:
            needed: build that of a city where it has none.
        """
        if self._index is not None or self._given_up or self._building is not None:
            return self._index
        if isinstance(self._map, CityMap):
            self._index = self._map.patterns
            if self._index is not None or not needed:
                return self._index
        if self._background:
            self._building = Thread(target=self._build, name="polemap-patterns", daemon=True)
            self._building.start()
        else:
            self._build()
        return self._index

    def give_up(self) -> None:
        """It was found to be damaged."""
        self._index, self._given_up = None, True

    def _build(self) -> None:
        try:
            if isinstance(self._map, CityMap):
                self._index = self._map.built_patterns()
            else:
                self._index, _ = build_index(self._map)
        except (PolemapError, OSError) as error:
            # the filter goes on without: what cannot be read is no reason to stop a car
            _LOG.warning("%s", error)
            self._given_up = True
        finally:
            self._building = None
