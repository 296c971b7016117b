"""Maps that are out of date: poles put up or taken away since the street was mapped."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import replace
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from polemap.map.pole_map import PoleMap

Floats = NDArray[np.float64]
Share = Annotated[float, Field(ge=0, le=1)]


class MapFault(BaseModel, ABC):
    """Changes the map of a drive's street, not the drive."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    share: Share = 0.2

    @abstractmethod
    def age(self, pole_map: PoleMap, rng: np.random.Generator) -> PoleMap:
        """The map as it was made when the street looked otherwise."""


class PolesAdded(MapFault):
    """Poles put up since mapping: the map lacks this share of what stands there."""

    kind: Literal["poles_added"] = "poles_added"

    def age(self, pole_map: PoleMap, rng: np.random.Generator) -> PoleMap:
        return without_poles(pole_map, self.share, rng)


class PolesRemoved(MapFault):
    """Poles taken away since mapping: the map has more than stands there, by this share."""

    kind: Literal["poles_removed"] = "poles_removed"

    def age(self, pole_map: PoleMap, rng: np.random.Generator) -> PoleMap:
        return with_extra_poles(pole_map, self.share, rng)


def without_poles(pole_map: PoleMap, share: float, rng: np.random.Generator) -> PoleMap:
    """A map from which a share of the poles is missing: they were put up after mapping."""
    keep = np.flatnonzero(rng.uniform(size=len(pole_map)) >= share)
    return _rows(pole_map, keep, pole_map.points_m[keep])


def with_extra_poles(pole_map: PoleMap, share: float, rng: np.random.Generator) -> PoleMap:
    """A map with poles that are gone by now: copies of others, 3 to 12 m beside them."""
    count = round(share * len(pole_map))
    source = rng.integers(0, max(len(pole_map), 1), count if len(pole_map) else 0)
    turn, away = rng.uniform(0, 2 * np.pi, len(source)), rng.uniform(3, 12, len(source))
    extra = pole_map.points_m[source] + np.stack([away * np.cos(turn), away * np.sin(turn)], 1)
    rows = np.concatenate([np.arange(len(pole_map)), source])
    grown = _rows(pole_map, rows, np.concatenate([pole_map.points_m, extra]))
    first = int(pole_map.ids.max()) + 1 if len(pole_map) else 0
    ids = np.concatenate([pole_map.ids, first + np.arange(len(source))])
    return replace(grown, ids=ids)


def _rows(pole_map: PoleMap, rows: NDArray[np.int64], points_m: Floats) -> PoleMap:
    return replace(
        pole_map,
        ids=pole_map.ids[rows],
        points_m=points_m,
        covariance_m2=pole_map.covariance_m2[rows],
        width_m=pole_map.width_m[rows],
        height_m=pole_map.height_m[rows],
        observations=pole_map.observations[rows],
        drives=pole_map.drives[rows],
        existence=pole_map.existence[rows],
    )
