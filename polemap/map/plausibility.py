"""A pole map held against what poles are, and against the drive that is to use it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.drive import Drive
from polemap.drivelog.findings import Finding
from polemap.drivelog.frames import EarthFrame, geographic_from_grid, grid_from_geographic
from polemap.map.pole_map import PoleMap

Floats = NDArray[np.float64]

# the trunk of an old tree is two metres wide; a mast or a pier hardly more
_WIDTH_MAX_M = 3.0
_FAR_M = 300.0
_DOUBLED_M = 0.1


def check_map(pole_map: PoleMap) -> list[Finding]:
    """Widths that no pole has, and poles that stand in the same place."""
    found = []
    widths = pole_map.width_m[np.isfinite(pole_map.width_m)]
    wide = int(np.count_nonzero(widths > _WIDTH_MAX_M))
    negative = int(np.count_nonzero(widths < 0.0))
    if wide:
        largest = float(widths.max())
        found.append(
            Finding(
                "map_width", "error" if wide > 0.5 * len(widths) else "warning", "map",
                f"{wide} of {len(widths)} poles are over {_WIDTH_MAX_M:g} m wide, up to "
                f"{largest:.4g} m", f"0 to {_WIDTH_MAX_M:g} m",
                "write width_m in metres, or leave it empty where it is not known",
            )
        )  # fmt: skip
    if negative > 0.1 * len(widths):
        found.append(
            Finding(
                "map_width", "error" if negative > 0.5 * len(widths) else "warning", "map",
                f"{negative} of {len(widths)} widths are negative", "0 or more",
                "leave width_m empty where it is not known",
            )
        )  # fmt: skip
    tree = pole_map.tree
    if tree is not None and len(pole_map) > 3:
        nearest = np.asarray(tree.query(pole_map.points_m, k=2)[0])[:, 1]
        doubled = int(np.count_nonzero(nearest < _DOUBLED_M))
        if doubled > 0.2 * len(pole_map):
            found.append(
                Finding(
                    "map_doubled", "warning", "map",
                    f"{doubled} of {len(pole_map)} poles have another within {_DOUBLED_M:g} m",
                    "one row a pole", "remove the rows that stand twice",
                )
            )  # fmt: skip
    return found


def check_map_of_drive(pole_map: PoleMap, drive: Drive) -> list[Finding]:
    """Whether the drive comes near the map at all, by its fixes or its reference."""
    tree = pole_map.tree
    if tree is None or not len(pole_map) or pole_map.frame != drive.frame:
        return []
    for name, places in _places(drive):
        places = places[np.isfinite(places).all(axis=1)]
        if not len(places):
            continue
        # a few dozen places show it; single fixes may be anywhere
        thinned = places[:: max(1, len(places) // 200)]
        distance = np.asarray(tree.query(thinned)[0])
        near = float(np.percentile(distance, 20))
        if near > _FAR_M:
            zone = _zone_of(pole_map, thinned)
            return [
                Finding(
                    "map_far", "error", "map",
                    f"the nearest pole is {_metres(near)} from {name}"
                    + (f"; they agree if {name} is in EPSG:{zone}" if zone else ""),
                    f"within {_FAR_M:.0f} m",
                    f"write epsg {zone} in drive.yaml" if zone
                    else "use a map of this place, in this drive's frame",
                )
            ]  # fmt: skip
        return []
    return []


def _zone_of(pole_map: PoleMap, places: Floats) -> int | None:
    """The UTM zone in whose coordinates the places lie in the map, None if none does."""
    own = pole_map.frame.epsg
    if own is None or own // 100 not in (326, 327):
        return None
    for zone in (own - 1, own + 1, own - 2, own + 2, own + 100, own - 100):
        if not (1 <= zone % 100 <= 60 and zone // 100 in (326, 327)):
            continue
        geographic = geographic_from_grid(EarthFrame("utm", zone), places)
        moved = grid_from_geographic(pole_map.frame, geographic[:, 0], geographic[:, 1])
        if pole_map.tree is None or not np.isfinite(moved).all():
            continue
        if np.percentile(np.asarray(pole_map.tree.query(moved)[0]), 20) < _FAR_M:
            return zone
    return None


def _places(drive: Drive) -> list[tuple[str, Floats]]:
    places = []
    if drive.gnss is not None and len(drive.gnss):
        fixes = np.stack([drive.gnss.east_m, drive.gnss.north_m], axis=1)
        places.append(("gnss.csv", fixes))
    if drive.reference is not None and len(drive.reference):
        places.append(("reference.csv", drive.reference.poses[:, :2]))
    return places


def _metres(distance: float) -> str:
    return f"{distance:.0f} m" if distance < 1000.0 else f"{distance / 1000.0:.0f} km"
