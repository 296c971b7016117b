"""Frames of the earth: a pinned UTM zone or a named local plane.

Grid north is not geographic north and a grid metre is not a metre: `convergence_rad` is the angle
between the norths, `point_scale` the ratio of the lengths. Headings from a compass or an INS pass
through the one, distances through the other, before they enter a frame.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pyproj import CRS, Proj, Transformer
from pyproj.exceptions import CRSError

from polemap.drivelog.errors import FrameError, InputError

Floats = NDArray[np.float64]
WGS84 = 4326


@dataclass(frozen=True, slots=True)
class EarthFrame:
    """The plane that coordinates belong to: `epsg` of a UTM zone, or the `name` of a local one.

    Raises:
        InputError: a kind that is unknown, an EPSG code that is no UTM zone, an empty name.
    """

    kind: str
    epsg: int | None = None
    name: str | None = None

    def __post_init__(self) -> None:
        if self.kind == "utm":
            if self.epsg is None or not _is_utm(self.epsg):
                raise InputError(
                    f"frame: epsg {self.epsg} is no UTM zone; WGS84 zones are 32601-32660 (north) "
                    "and 32701-32760 (south)"
                )
        elif self.kind == "local":
            if not self.name:
                raise InputError("frame: a local frame needs a name")
        else:
            raise InputError(f"frame: kind is '{self.kind}', known are 'utm' and 'local'")

    def __str__(self) -> str:
        return f"EPSG:{self.epsg}" if self.kind == "utm" else f"local frame '{self.name}'"

    @property
    def is_utm(self) -> bool:
        """Whether the frame is tied to the earth, so that it can be transformed."""
        return self.kind == "utm"

    def to_dict(self) -> dict[str, Any]:
        """As it stands in drive.yaml."""
        if self.is_utm:
            return {"kind": "utm", "epsg": self.epsg}
        return {"kind": "local", "name": self.name}

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> EarthFrame:
        """From the `frame` of a drive.yaml.

        Raises:
            InputError: a key that is unknown or a value that names no frame.
        """
        if not isinstance(values, Mapping):
            raise InputError(f"frame: {str(values)[:40]} is no frame; expected kind, epsg and name")
        unknown = {str(key) for key in values} - {"kind", "epsg", "name"}
        if unknown:
            raise InputError(f"frame: unknown key '{min(unknown)[:40]}'")
        epsg = values.get("epsg")
        if epsg is not None and (isinstance(epsg, bool) or not isinstance(epsg, int)):
            given = str(epsg)[:40]
            raise InputError(f"frame: epsg is '{given}', it must be a whole number such as 32633")
        name = values.get("name")
        return cls(str(values.get("kind")), epsg, None if name is None else str(name))


@lru_cache(maxsize=256)
def _is_utm(epsg: int) -> bool:
    if 32601 <= epsg <= 32660 or 32701 <= epsg <= 32760:
        return True
    try:
        return CRS.from_epsg(epsg).utm_zone is not None
    except CRSError:
        return False


@lru_cache(maxsize=256)
def _transformer(source: int, target: int) -> Transformer:
    return Transformer.from_crs(source, target, always_xy=True)


@lru_cache(maxsize=64)
def _projection(epsg: int) -> Proj:
    return Proj(CRS.from_epsg(epsg))


def utm_frame(latitude_deg: float, longitude_deg: float) -> EarthFrame:
    """The WGS84 UTM zone that a place lies in; Norway's and Svalbard's exceptions included.

    Raises:
        InputError: a place outside the zones (beyond 84 degrees north or 80 south).
    """
    if not -80.0 <= latitude_deg <= 84.0 or not -180.0 <= longitude_deg <= 180.0:
        raise InputError(
            f"latitude {latitude_deg}, longitude {longitude_deg} lies in no UTM zone "
            "(80 south to 84 north)"
        )
    zone = int((longitude_deg + 180.0) // 6.0) % 60 + 1
    if 56.0 <= latitude_deg < 64.0 and 3.0 <= longitude_deg < 12.0:
        zone = 32
    if latitude_deg >= 72.0 and 0.0 <= longitude_deg < 42.0:
        zone = 31 + 2 * int((longitude_deg + 3.0) // 12.0)
    return EarthFrame("utm", (32600 if latitude_deg >= 0.0 else 32700) + zone)


def _utm_epsg(frame: EarthFrame) -> int:
    if frame.epsg is None or not frame.is_utm:
        raise FrameError(
            f"{frame} is not tied to the earth: latitude and longitude need a frame of kind utm"
        )
    return frame.epsg


def grid_from_geographic(
    frame: EarthFrame, latitude_deg: ArrayLike, longitude_deg: ArrayLike
) -> Floats:
    """WGS84 latitudes and longitudes `(n,)` to east, north `(n, 2)` of a UTM frame.

    Raises:
        FrameError: the frame is local.
    """
    east, north = _transformer(WGS84, _utm_epsg(frame)).transform(longitude_deg, latitude_deg)
    return np.stack(np.broadcast_arrays(east, north), axis=-1).astype(np.float64)


def geographic_from_grid(frame: EarthFrame, points_m: ArrayLike) -> Floats:
    """East, north `(n, 2)` of a UTM frame to WGS84 latitude, longitude in degrees `(n, 2)`.

    Raises:
        FrameError: the frame is local.
    """
    points = np.asarray(points_m, dtype=np.float64)
    longitude, latitude = _transformer(_utm_epsg(frame), WGS84).transform(
        points[..., 0], points[..., 1]
    )
    return np.stack(np.broadcast_arrays(latitude, longitude), axis=-1).astype(np.float64)


def convergence_rad(frame: EarthFrame, points_m: ArrayLike) -> Floats:
    """Angle from geographic to grid north at points `(..., 2)`, positive where the latter is east.

    A yaw counter-clockwise from geographic east becomes a grid yaw by adding it: east of the
    central meridian, north of the equator, a car that drives due north has a grid yaw above
    90 degrees.

    Raises:
        FrameError: the frame is local.
    """
    place = geographic_from_grid(frame, points_m)
    factors = _projection(_utm_epsg(frame)).get_factors(place[..., 1], place[..., 0])
    return np.deg2rad(np.asarray(factors.meridian_convergence, dtype=np.float64))


def point_scale(frame: EarthFrame, points_m: ArrayLike) -> Floats:
    """Grid metres per metre on the ellipsoid at points `(..., 2)`; 0.9996 in a zone's middle."""
    place = geographic_from_grid(frame, points_m)
    factors = _projection(_utm_epsg(frame)).get_factors(place[..., 1], place[..., 0])
    return np.asarray(factors.meridional_scale, dtype=np.float64)


def grid_yaw(frame: EarthFrame, yaw_geographic_rad: ArrayLike, points_m: ArrayLike) -> Floats:
    """Yaws from geographic east `(n,)` at points `(n, 2)` to yaws from grid east, in [-pi, pi)."""
    yaw = np.asarray(yaw_geographic_rad) + convergence_rad(frame, points_m)
    return np.asarray((yaw + np.pi) % (2.0 * np.pi) - np.pi)


def transform_points(points_m: ArrayLike, source: EarthFrame, target: EarthFrame) -> Floats:
    """Points `(n, 2)` of one UTM zone in another; unchanged where both frames are the same.

    Raises:
        FrameError: one of them is local and the other is not the same.
    """
    points = np.asarray(points_m, dtype=np.float64)
    if source == target:
        return points
    if not (source.is_utm and target.is_utm):
        raise FrameError(f"no transformation leads from {source} to {target}")
    east, north = _transformer(_utm_epsg(source), _utm_epsg(target)).transform(
        points[..., 0], points[..., 1]
    )
    return np.stack(np.broadcast_arrays(east, north), axis=-1).astype(np.float64)


def require_same_frame(
    first: EarthFrame, second: EarthFrame, first_name: str, second_name: str
) -> None:
    """Refuse to put two things of different frames together.

    Raises:
        FrameError: they differ; the message names both and the way out.
    """
    if first == second:
        return
    remedy = (
        "transform one of them to the other's zone"
        if first.is_utm and second.is_utm
        else "they cannot be compared: use a map built in the drive's own frame"
    )
    raise FrameError(f"{first_name} is in {first} but {second_name} is in {second}; {remedy}")
