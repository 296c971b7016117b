"""Positions and headings of logs, in the frame of the drive."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.errors import InputError
from polemap.drivelog.frames import (
    EarthFrame,
    geographic_from_grid,
    grid_from_geographic,
    grid_yaw,
    utm_frame,
)
from polemap.drivelog.logs.mapping import StreamPart
from polemap.drivelog.logs.rows import Rows
from polemap.vehicle.pose import rotate, wrap_angle

Floats = NDArray[np.float64]


def place_reference(part: StreamPart, rows: Rows, frame: EarthFrame) -> None:
    """Turn a reference's positions and headings into poses of the rear axle in the frame.

    Raises:
        InputError: degrees or geographic headings where the frame is local.
    """
    if "latitude_deg" in rows.columns:
        _require_utm(part, frame, "latitudes and longitudes")
        points = grid_from_geographic(
            frame, rows.numbers("latitude_deg"), rows.numbers("longitude_deg")
        )
        del rows.columns["latitude_deg"], rows.columns["longitude_deg"]
    else:
        points = np.stack([rows.numbers("east_m"), rows.numbers("north_m")], axis=1)
    yaw = headings(part, "yaw_rad", rows.numbers("yaw_rad"), frame, points)
    if part.measured_at is not None:
        lever = np.array([part.measured_at.x_m, part.measured_at.y_m])
        points = points - rotate(np.broadcast_to(lever, points.shape), yaw)
    rows.columns |= {"east_m": points[:, 0], "north_m": points[:, 1], "yaw_rad": yaw}


def headings(
    part: StreamPart,
    name: str,
    angles_rad: Floats,
    frame: EarthFrame | None,
    points_m: Floats | None,
) -> Floats:
    """Yaws counter-clockwise from grid east of headings `(n,)` as the mapping says they count.

    Raises:
        InputError: geographic north where the frame is local.
    """
    value = part.values.get(name)
    if value is None or value.zero is None:
        return np.asarray(wrap_angle(angles_rad))
    sign = -1.0 if value.turn == "clockwise" else 1.0
    yaw = sign * angles_rad + (np.pi / 2.0 if value.zero.endswith("north") else 0.0)
    if value.zero.startswith("true") and frame is not None and points_m is not None:
        _require_utm(part, frame, "headings from geographic north or east")
        yaw = grid_yaw(frame, yaw, points_m)
    return np.asarray(wrap_angle(yaw))


def _require_utm(part: StreamPart, frame: EarthFrame, what: str) -> None:
    if not frame.is_utm:
        raise InputError(
            f"{part.name}: {what} need a UTM frame, and this is {frame}; give `frame: {{kind: utm, "
            "epsg: ...}` in `drive`, or grid_north and metres"
        )


def utm_zone(rows: Mapping[str, Rows], path: Path) -> dict[str, Any]:
    """The UTM zone of the first fix, where the mapping names no frame.

    Raises:
        InputError: no degrees to take it from.
    """
    for key in ("gnss", "reference"):
        if (
            key in rows
            and "latitude_deg" in rows[key].columns
            and len(rows[key].columns["stamp_s"])
        ):
            latitude, longitude = (
                float(rows[key].numbers(name)[0]) for name in ("latitude_deg", "longitude_deg")
            )
            return utm_frame(latitude, longitude).to_dict()
    raise InputError(
        f"{path}: no latitudes tell the frame; add `drive: {{frame: {{kind: local, name: here}}}}` "
        "to the mapping, or `{kind: utm, epsg: 32632}` where east and north are of that zone"
    )


def place_stream(part: StreamPart, rows: Rows, frame: EarthFrame) -> None:
    """Turn the rows of `gnss` or `reference` into what the drive's frame asks for.

    Raises:
        InputError: degrees where the frame is local.
    """
    if part.name == "reference":
        place_reference(part, rows, frame)
        return
    if "latitude_deg" in rows.columns:
        _require_utm(part, frame, "latitudes and longitudes")
        latitude, longitude = rows.numbers("latitude_deg"), rows.numbers("longitude_deg")
        on_earth = (np.abs(latitude) <= 90.0) & (np.abs(longitude) <= 180.0)
        rows.keep(on_earth, "no latitude and longitude")
    elif frame.is_utm:
        points = np.stack([rows.numbers("east_m"), rows.numbers("north_m")], axis=1)
        place = geographic_from_grid(frame, points)
        del rows.columns["east_m"], rows.columns["north_m"]
        rows.columns |= {"latitude_deg": place[:, 0], "longitude_deg": place[:, 1]}
