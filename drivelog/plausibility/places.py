"""Places: zones, exchanged coordinates, and fixes against the reference."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.drive import Drive
from polemap.drivelog.errors import PolemapError
from polemap.drivelog.findings import Finding
from polemap.drivelog.frames import (
    EarthFrame,
    geographic_from_grid,
    grid_from_geographic,
    utm_frame,
)
from polemap.vehicle.pose import rigid_fit, rotate

Floats = NDArray[np.float64]

# cheap fixes are some metres off, in streets some tens; single ones may be anywhere
_FAR_DOUBT_M, _FAR_WRONG_M = 25.0, 100.0
# a drive may cross the border of a zone by this and stay in the zone it began in
_ZONE_MARGIN_DEG = 1.0
_NEAR_M = 50.0
_TURNED_RAD = np.radians(2.0)


def zone_findings(drive: Drive) -> list[Finding]:
    """Whether the fixes lie in the zone of the drive's frame."""
    gnss, frame = drive.gnss, drive.frame
    if gnss is None or not len(gnss) or not frame.is_utm or frame.epsg is None:
        return []
    place = _median_place(drive)
    if place is None:
        return [
            Finding(
                "gnss_place", "error", drive.names.gnss, f"its fixes have no place in {frame}",
                "fixes in the frame's zone",
                f"check latitude and longitude, and the epsg in {drive.names.head}",
            )
        ]  # fmt: skip
    latitude, longitude = place
    if _in_zone(frame, latitude, longitude):
        return []
    value = f"fixes at latitude {latitude:.4f}, longitude {longitude:.4f} degrees"
    for name, (lat, lon) in _guesses(latitude, longitude).items():
        if _in_zone(frame, lat, lon):
            return [
                Finding(
                    "gnss_axes", "error", drive.names.gnss, f"{value} lie outside of {frame}; "
                    f"inside with {name}", f"fixes in {frame}", _remedy(name),
                )
            ]  # fmt: skip
    try:
        own = str(utm_frame(latitude, longitude))
    except PolemapError:
        own = "no zone"
    far = abs(_off_zone_deg(frame, longitude)) > 6.0 + _ZONE_MARGIN_DEG
    return [
        Finding(
            "zone", "error" if far else "warning", drive.names.head,
            f"{value} lie in {own}, the frame is {frame}", "a frame of the fixes' zone",
            f"correct the epsg in {drive.names.head}, or latitude and longitude",
        )
    ]  # fmt: skip


def distance_findings(drive: Drive) -> list[Finding]:
    """Fixes against the reference: their median distance, and what would bring them together."""
    gnss, reference = drive.gnss, drive.reference
    if gnss is None or reference is None or len(gnss) < 2 or len(reference) < 2:
        return []
    fixes = np.stack([gnss.east_m, gnss.north_m], axis=1)
    poses = reference.at(gnss.stamp_s, max_gap_s=5.0)
    both = np.isfinite(poses).all(axis=1) & np.isfinite(fixes).all(axis=1)
    if both.sum() < 2:
        # another clock must not hide another place
        points, places = np.median(fixes, axis=0)[None], np.median(reference.poses, axis=0)[None]
        if np.hypot(*(points - places[:, :2])[0]) < 2000.0 + np.ptp(reference.poses[:, :2]):
            return []
    else:
        points, places = fixes[both], poses[both]
    off = points - places[:, :2]
    distance = _median(off)
    if distance < _FAR_DOUBT_M:
        return _rotation(drive.names.reference, points, places[:, :2])
    east, north = np.median(off, axis=0)
    value = f"fixes are {_metres(distance)} from {drive.names.reference} in the median"
    expected = f"within {_FAR_DOUBT_M:.0f} m"
    if cause := _cause(drive, points, places[:, :2], distance):
        kind, stream, text, remedy = cause
        return [Finding(kind, "error", stream, f"{value}; {text}", expected, remedy)]
    if turned := _rotation(drive.names.reference, points, places[:, :2]):
        return turned
    constant = np.hypot(*(off - (east, north)).T)
    shift = float(np.median(constant)) < 0.3 * distance
    return [
        Finding(
            "gnss_reference",
            "error" if distance > _FAR_WRONG_M else "warning",
            drive.names.reference,
            value + (f", all by east {east:.1f}, north {north:.1f} m" if shift else ""),
            expected,
            f"bring {drive.names.reference} and {drive.names.gnss} into one frame and origin",
        )
    ]


def _rotation(name: str, fixes: Floats, places: Floats) -> list[Finding]:
    """Whether the track of the fixes is turned against that of the reference."""
    if len(fixes) < 10:
        return []
    weight = np.ones(len(fixes))
    turn, spread, extent = 0.0, 1.0, 0.0
    for _ in range(10):
        a = places - np.average(places, axis=0, weights=weight)
        b = fixes - np.average(fixes, axis=0, weights=weight)
        turn = float(rigid_fit(places, fixes, weight)[2])
        rest = np.hypot(*(b - rotate(a, turn)).T)
        spread = float(np.median(rest)) + 1e-3
        weight = 1.0 / (1.0 + (rest / (2.0 * spread)) ** 2)
        extent = float(np.sqrt(np.average((a**2).sum(axis=1), weights=weight)))
    # errors of fixes stay over a minute: a drive holds few that are independent
    if extent < 20.0 or abs(turn) < _TURNED_RAD + 2.0 * spread / extent:
        return []
    return [
        Finding(
            "reference_rotation", "warning", name,
            f"its track is turned by {np.degrees(-turn):.1f} degrees against the fixes",
            f"within {np.degrees(_TURNED_RAD + 2.0 * spread / extent):.1f} degrees",
            "bring the reference into the frame's grid: east is grid east",
        )
    ]  # fmt: skip


def _cause(
    drive: Drive, fixes: Floats, places: Floats, distance: float
) -> tuple[str, str, str, str] | None:
    """Kind, stream, what it is and the remedy, where one known mistake explains the distance."""
    if _near(fixes, places[:, ::-1]) and _median(fixes - places[:, ::-1]) < 0.3 * distance:
        return ("reference_axes", drive.names.reference,
                "they agree with east and north exchanged", "exchange east and north")  # fmt: skip
    frame = drive.frame
    if not frame.is_utm or frame.epsg is None:
        return None
    geographic = geographic_from_grid(frame, fixes)
    if not np.isfinite(geographic).all():
        return None
    for name, (lat, lon) in _guesses(geographic[:, 0], geographic[:, 1]).items():
        if np.abs(lat).max() < 85.0 and _near(grid_from_geographic(frame, lat, lon), places):
            return "gnss_axes", drive.names.gnss, f"they agree with {name}", _remedy(name)
    band = frame.epsg // 100 * 100
    if band in (32600, 32700):
        for zone in range(1, 61):
            for other in (32600 + zone, 32700 + zone):
                guess = EarthFrame("utm", other)
                near_zone = abs(_off_zone_deg(guess, float(np.median(geographic[:, 1])))) < 12.0
                if (
                    other != frame.epsg
                    and near_zone
                    and _near(
                        grid_from_geographic(guess, geographic[:, 0], geographic[:, 1]), places
                    )
                ):
                    return ("zone", drive.names.head,
                            f"they agree in {guess}, the frame is {frame}",
                            f"write epsg {other} in {drive.names.head}")  # fmt: skip
    middle = np.median(places, axis=0)
    if np.hypot(*middle) < 50_000.0:
        return ("reference_place", drive.names.reference,
                "its coordinates are local, the frame is a UTM zone",
                f"write the reference in the frame of {drive.names.head}")  # fmt: skip
    return None


def _near(a: Floats, b: Floats) -> bool:
    return _median(a - b) < _NEAR_M


def _median(off: Floats) -> float:
    return float(np.median(np.hypot(off[:, 0], off[:, 1])))


def _guesses(latitude: Floats | float, longitude: Floats | float) -> dict[str, tuple]:  # type: ignore[type-arg]
    return {
        "latitude and longitude exchanged": (longitude, latitude),
        "the sign of the longitude changed": (latitude, -1.0 * longitude),
        "the sign of the latitude changed": (-1.0 * latitude, longitude),
        "radians taken for degrees": (np.degrees(latitude), np.degrees(longitude)),
    }


def _remedy(name: str) -> str:
    if name.startswith("latitude"):
        return "exchange latitude and longitude"
    if name.startswith("radians"):
        return "write latitude and longitude in degrees"
    return "write east and north positive, west and south negative"


def _median_place(drive: Drive) -> tuple[float, float] | None:
    gnss = drive.gnss
    if gnss is None:
        return None
    points = np.stack([gnss.east_m, gnss.north_m], axis=1)
    points = points[np.isfinite(points).all(axis=1)]
    if not len(points):
        return None
    latitude, longitude = np.median(geographic_from_grid(drive.frame, points), axis=0)
    if not (np.isfinite(latitude) and np.isfinite(longitude)):
        return None
    return float(latitude), float(longitude)


def _off_zone_deg(frame: EarthFrame, longitude: float) -> float:
    """Degrees from the zone's central meridian."""
    middle = (float((frame.epsg or 0) % 100) - 0.5) * 6.0 - 180.0
    return (longitude - middle + 180.0) % 360.0 - 180.0


def _in_zone(frame: EarthFrame, latitude: float, longitude: float) -> bool:
    if not (abs(latitude) <= 84.5 and abs(longitude) <= 180.0) or frame.epsg is None:
        return False
    if frame.epsg // 100 not in (326, 327):
        # a zone of another datum: only its own projection knows its middle
        place = grid_from_geographic(frame, latitude, longitude)
        return bool(np.isfinite(place).all() and 0.0 < place[0] < 1e6)
    north = frame.epsg // 100 == 326
    if (latitude < -1.0 and north) or (latitude > 1.0 and not north):
        return False
    try:
        if utm_frame(latitude, longitude) == frame:
            return True
    except PolemapError:
        return False
    return abs(_off_zone_deg(frame, longitude)) <= 3.0 + _ZONE_MARGIN_DEG


def _metres(distance: float) -> str:
    return f"{distance:.1f} m" if distance < 1000.0 else f"{distance / 1000.0:.1f} km"
