"""All plausibility checks of a drive and of the map it is used with."""

from __future__ import annotations

from polemap.calibration.height_check import height_findings
from polemap.drivelog.drive import Drive
from polemap.drivelog.findings import Finding, worst_first
from polemap.drivelog.plausibility.check import check_drive
from polemap.drivelog.plausibility.pictures import check_pictures
from polemap.map.city.city_map import CityMap
from polemap.map.plausibility import check_map, check_map_of_drive
from polemap.map.pole_map import PoleMap


def find(drive: Drive, pole_map: PoleMap | CityMap | None = None) -> list[Finding]:
    """All that cannot be right in a drive, and in the map it is to be used with; errors first."""
    found = check_drive(drive) + check_pictures(drive)
    if not any(f.stream == "camera" or f.severity == "error" for f in found):
        # a wrong scale or pitch, or pairs that are none, would show as another height
        found += height_findings(drive)
    if pole_map is not None:
        found += check_map(pole_map) + check_map_of_drive(pole_map, drive)
    return worst_first(found)
