"""What is to be known of a map without reading its poles: stored in the file of a city map."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from math import nan
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from polemap.map.city.packing import TILE_POLES, packed_order
from polemap.map.pole_map import PoleMap

Floats = NDArray[np.float64]
Three = tuple[float, float, float]

# the trunk of an old tree is two metres wide; a mast or a pier hardly more
WIDTH_MAX_M = 3.0
DOUBLED_M = 0.1
# of a larger map the next neighbours are looked for in so many tiles only, spread over it
_ALL_NEIGHBOURS, _TILES = 100_000, 64
_UNKNOWN: Three = (nan, nan, nan)


@dataclass(frozen=True, slots=True)
class MapStatistics:
    """Figures over all poles of a map.

    Attributes:
        poles: how many they are.
        extent_m: west, south, east, north; empty without poles.
        kinds: every `LandmarkKind` that stands in it, sorted.
        position_sd_m, width_m, height_m: percentiles 5, 50, 95; NaN where none is known.
        widths, heights: how many are known.
        width_max_m: the largest, NaN where none is known.
        wide, negative: widths over `WIDTH_MAX_M`, and below zero.
        observations: the sum.
        drives: the most of a pole.
        existence: the least and the largest.
        neighbours: poles whose next neighbour was looked for.
        spacing_m: median distance to it, NaN for a single pole.
        doubled: how many stand within `DOUBLED_M` of it.
        further: names of the columns that only this file has.
    """

    poles: int
    extent_m: tuple[float, ...]
    kinds: tuple[int, ...]
    position_sd_m: Three = _UNKNOWN
    width_m: Three = _UNKNOWN
    height_m: Three = _UNKNOWN
    widths: int = 0
    heights: int = 0
    width_max_m: float = nan
    wide: int = 0
    negative: int = 0
    observations: int = 0
    drives: int = 0
    existence: tuple[float, float] = (nan, nan)
    neighbours: int = 0
    spacing_m: float = nan
    doubled: int = 0
    further: tuple[str, ...] = ()

    @classmethod
    def of(cls, pole_map: PoleMap) -> MapStatistics:
        """Count and measure all poles of a map."""
        further = tuple(pole_map.extra)
        if not len(pole_map):
            return cls(0, (), (), further=further)
        low, high = pole_map.points_m.min(axis=0), pole_map.points_m.max(axis=0)
        widths = pole_map.width_m[np.isfinite(pole_map.width_m)]
        heights = pole_map.height_m[np.isfinite(pole_map.height_m)]
        sd = np.sqrt(np.trace(pole_map.covariance_m2, axis1=1, axis2=2) / 2.0)
        nearest = _to_the_next(pole_map)
        return cls(
            poles=len(pole_map),
            extent_m=(*low.tolist(), *high.tolist()),
            kinds=tuple(int(kind) for kind in np.unique(pole_map.kind)),
            position_sd_m=_percentiles(sd),
            width_m=_percentiles(widths),
            height_m=_percentiles(heights),
            widths=len(widths),
            heights=len(heights),
            width_max_m=float(widths.max()) if len(widths) else nan,
            wide=int(np.count_nonzero(widths > WIDTH_MAX_M)),
            negative=int(np.count_nonzero(widths < 0.0)),
            observations=int(pole_map.observations.sum()),
            drives=int(pole_map.drives.max()),
            existence=(float(pole_map.existence.min()), float(pole_map.existence.max())),
            neighbours=len(nearest),
            spacing_m=float(np.median(nearest)) if len(nearest) else nan,
            doubled=int(np.count_nonzero(nearest < DOUBLED_M)),
            further=further,
        )

    def to_dict(self) -> dict[str, Any]:
        """For JSON; what is not known is null."""
        return {name: _plain(value) for name, value in asdict(self).items()}

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> MapStatistics:
        """The inverse of `to_dict`.

        Raises:
            KeyError, TypeError, ValueError: a value that is missing or of another kind.
        """
        least, largest = values["existence"]
        return cls(
            poles=int(values["poles"]),
            extent_m=tuple(float(value) for value in values["extent_m"]),
            kinds=tuple(int(kind) for kind in values["kinds"]),
            position_sd_m=_three(values["position_sd_m"]),
            width_m=_three(values["width_m"]),
            height_m=_three(values["height_m"]),
            widths=int(values["widths"]),
            heights=int(values["heights"]),
            width_max_m=_known(values["width_max_m"]),
            wide=int(values["wide"]),
            negative=int(values["negative"]),
            observations=int(values["observations"]),
            drives=int(values["drives"]),
            existence=(_known(least), _known(largest)),
            neighbours=int(values["neighbours"]),
            spacing_m=_known(values["spacing_m"]),
            doubled=int(values["doubled"]),
            further=tuple(str(name) for name in values["further"]),
        )


def together(parts: Sequence[MapStatistics]) -> MapStatistics:
    """Of maps that are used as one; percentiles and spacing are means, weighted by the poles."""
    full = [part for part in parts if part.poles]
    if not full:
        return parts[0] if parts else MapStatistics(0, (), ())
    extents = np.array([part.extent_m for part in full])
    further = tuple(dict.fromkeys(name for part in full for name in part.further))
    lows = [part.existence[0] for part in full]
    highs = [part.existence[1] for part in full]
    return MapStatistics(
        poles=sum(part.poles for part in full),
        extent_m=(*extents[:, :2].min(axis=0).tolist(), *extents[:, 2:].max(axis=0).tolist()),
        kinds=tuple(sorted({kind for part in full for kind in part.kinds})),
        position_sd_m=_mean_of([(part.position_sd_m, part.poles) for part in full]),
        width_m=_mean_of([(part.width_m, part.widths) for part in full]),
        height_m=_mean_of([(part.height_m, part.heights) for part in full]),
        widths=sum(part.widths for part in full),
        heights=sum(part.heights for part in full),
        width_max_m=max((p.width_max_m for p in full if p.widths), default=nan),
        wide=sum(part.wide for part in full),
        negative=sum(part.negative for part in full),
        observations=sum(part.observations for part in full),
        drives=max(part.drives for part in full),
        existence=(min(lows), max(highs)),
        neighbours=sum(part.neighbours for part in full),
        spacing_m=_mean_of([((part.spacing_m,) * 3, part.neighbours) for part in full])[0],
        doubled=sum(part.doubled for part in full),
        further=further,
    )


def _mean_of(values: Sequence[tuple[Three, int]]) -> Three:
    known = [(three, weight) for three, weight in values if weight]
    if not known:
        return _UNKNOWN
    low, middle, high = np.average(
        [three for three, _ in known], axis=0, weights=[weight for _, weight in known]
    )
    return float(low), float(middle), float(high)


def _to_the_next(pole_map: PoleMap) -> Floats:
    """Distances to the next pole: of all, or of those in some tiles of a large map."""
    n = len(pole_map)
    if n < 2:
        return np.empty(0)
    if n <= _ALL_NEIGHBOURS:
        assert pole_map.tree is not None
        return np.asarray(pole_map.tree.query(pole_map.points_m, k=2)[0])[:, 1]
    order = packed_order(pole_map.points_m, TILE_POLES)
    tiles = -(-n // TILE_POLES)
    chosen = np.unique(np.linspace(0, tiles - 1, _TILES).astype(np.int64))
    found = []
    for tile in chosen:
        points = pole_map.points_m[order[tile * TILE_POLES : (tile + 1) * TILE_POLES]]
        if len(points) > 1:
            found.append(np.asarray(scipy.spatial.KDTree(points).query(points, k=2)[0])[:, 1])
    return np.concatenate(found)


def _percentiles(values: Floats) -> Three:
    if not len(values):
        return _UNKNOWN
    low, middle, high = np.percentile(values, [5, 50, 95])
    return float(low), float(middle), float(high)


def _three(values: Any) -> Three:
    low, middle, high = values
    return _known(low), _known(middle), _known(high)


def _known(value: Any) -> float:
    return nan if value is None else float(value)


def _plain(value: Any) -> Any:
    if isinstance(value, tuple):
        return [_plain(one) for one in value]
    return None if isinstance(value, float) and value != value else value
