"""A pole map held against what poles are, and against the drive that is to use it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.drive import Drive
from polemap.drivelog.findings import Finding
from polemap.drivelog.frames import EarthFrame, geographic_from_grid, grid_from_geographic
from polemap.map.city.city_map import CityMap, statistics_of
from polemap.map.city.statistics import DOUBLED_M, WIDTH_MAX_M, MapStatistics
from polemap.map.pole_map import PoleMap

Floats = NDArray[np.float64]

_FAR_M = 300.0
_BEYOND_M = 301.0
# places of a drive that are held against a city, of which every one reads its surroundings
_PLACES_IN_CITY = 40


def check_map(pole_map: PoleMap | CityMap) -> list[Finding]:
    """Widths that no pole has, and poles that stand in the same place."""
    return check_statistics(statistics_of(pole_map))


def check_statistics(known: MapStatistics) -> list[Finding]:
    """The same of a map whose figures are known."""
    found = []
    if known.wide:
        found.append(
            Finding(
                "map_width", "error" if known.wide > 0.5 * known.widths else "warning", "map",
                f"{known.wide} of {known.widths} poles are over {WIDTH_MAX_M:g} m wide, up to "
                f"{known.width_max_m:.4g} m", f"0 to {WIDTH_MAX_M:g} m",
                "write width_m in metres, or leave it empty where it is not known",
            )
        )  # fmt: skip
    if known.negative > 0.1 * known.widths:
        found.append(
            Finding(
                "map_width", "error" if known.negative > 0.5 * known.widths else "warning", "map",
                f"{known.negative} of {known.widths} widths are negative", "0 or more",
                "leave width_m empty where it is not known",
            )
        )  # fmt: skip
    if known.poles > 3 and known.doubled > 0.2 * known.neighbours:
        found.append(
            Finding(
                "map_doubled", "warning", "map",
                f"{known.doubled} of {known.neighbours} poles have another within {DOUBLED_M:g} m",
                "one row a pole", "remove the rows that stand twice",
            )
        )  # fmt: skip
    return found


def check_map_of_drive(pole_map: PoleMap | CityMap, drive: Drive) -> list[Finding]:
    """Whether the drive comes near the map at all, by its fixes or its reference."""
    if not len(pole_map) or pole_map.frame != drive.frame:
        return []
    most = _PLACES_IN_CITY if isinstance(pole_map, CityMap) else 200
    for name, places in _places(drive):
        places = places[np.isfinite(places).all(axis=1)]
        if not len(places):
            continue
        # a few dozen places show it; single fixes may be anywhere
        thinned = places[:: max(1, len(places) // most)]
        near = float(np.percentile(_to_poles_m(pole_map, thinned), 20))
        if near > _FAR_M:
            zone = _zone_of(pole_map, thinned)
            return [
                Finding(
                    "map_far", "error", "map",
                    f"the nearest pole is {_metres(near)} from {name}"
                    + (f"; they agree if {name} is in EPSG:{zone}" if zone else ""),
                    f"within {_FAR_M:.0f} m",
                    f"write epsg {zone} in {drive.names.head}" if zone
                    else "use a map of this place, in this drive's frame",
                )
            ]  # fmt: skip
        return []
    return []


def _to_poles_m(pole_map: PoleMap | CityMap, places: Floats) -> Floats:
    """Distance `(n,)` to the nearest pole; in a city beyond `_FAR_M` at least the one there is to
    all its poles."""
    if not isinstance(pole_map, CityMap):
        return pole_map.nearest(places)[0]
    nearest = pole_map.nearest_m(places, _FAR_M)
    extent = np.array(pole_map.statistics.extent_m)
    outside = np.hypot(*np.maximum(0.0, np.maximum(extent[:2] - places, places - extent[2:])).T)
    return np.where(np.isfinite(nearest), nearest, np.maximum(outside, _BEYOND_M))


def _zone_of(pole_map: PoleMap | CityMap, places: Floats) -> int | None:
    """The UTM zone in whose coordinates the places lie in the map, None if none does."""
    own = pole_map.frame.epsg
    if own is None or own // 100 not in (326, 327):
        return None
    for zone in (own - 1, own + 1, own - 2, own + 2, own + 100, own - 100):
        if not (1 <= zone % 100 <= 60 and zone // 100 in (326, 327)):
            continue
        geographic = geographic_from_grid(EarthFrame("utm", zone), places)
        moved = grid_from_geographic(pole_map.frame, geographic[:, 0], geographic[:, 1])
        if not np.isfinite(moved).all():
            continue
        if np.percentile(_to_poles_m(pole_map, moved), 20) < _FAR_M:
            return zone
    return None


def _places(drive: Drive) -> list[tuple[str, Floats]]:
    places = []
    if drive.gnss is not None and len(drive.gnss):
        fixes = np.stack([drive.gnss.east_m, drive.gnss.north_m], axis=1)
        places.append((drive.names.gnss, fixes))
    if drive.reference is not None and len(drive.reference):
        places.append((drive.names.reference, drive.reference.poses[:, :2]))
    return places


def _metres(distance: float) -> str:
    return f"{distance:.0f} m" if distance < 1000.0 else f"{distance / 1000.0:.0f} km"
