"""Pictures of a map: poles by existence, and how well they would locate a car along the routes."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.atomic import atomic_file
from polemap.drivelog.drive import Drive
from polemap.drivelog.errors import InputError
from polemap.drivelog.frames import EarthFrame, geographic_from_grid
from polemap.evaluation.localizability import Localizability, drive_sensor, localizability
from polemap.extras import check_installed
from polemap.map.pole_map import PoleMap
from polemap.settings import Settings

Floats = NDArray[np.float64]

_STEP_M = 2.0
_WORST_M = 1.0
_CELL_M = 50.0
# a slim bar beside the map
_BAR: dict[str, Any] = {"shrink": 0.5, "aspect": 30, "pad": 0.01}


def check_picture(path: Path | None) -> None:
    """Refuse an ending that is no picture's before the work begins.

    Raises:
        InputError: neither .png nor .svg nor .pdf.
        MissingExtraError: matplotlib is not installed.
    """
    if path is not None and path.suffix.lower() not in (".png", ".svg", ".pdf"):
        raise InputError(f"{path}: a picture ends in .png, .svg or .pdf")
    if path is not None:
        check_installed("matplotlib")


def route_localizability(pole_map: PoleMap, drive: Drive, settings: Settings) -> Localizability:
    """Bounds every two metres along a drive's reference.

    Raises:
        InputError: the drive has no reference, or does not say what its sensor sees.
    """
    if drive.reference is None or not len(drive.reference):
        raise InputError(f"drive {drive.name}: it has no reference, so its route is not known")
    sensor = drive_sensor(drive, settings.polemap.detection, settings.localize.p_detection)
    if sensor is None:
        raise InputError(
            f"drive {drive.name}: what its detector sees is not known; add pole_detector to "
            "drive.yaml"
        )
    return localizability(pole_map, drive.reference.poses, sensor, step_m=_STEP_M)


def write_localizability(parts: list[Localizability], frame: EarthFrame, path: Path) -> None:
    """The bounds along the routes as GeoJSON points; null where the poles do not tell.

    Raises:
        InputError: another ending than .geojson, or a place that cannot be written to.
    """
    if path.suffix.lower() != ".geojson":
        raise InputError(f"{path}: the localizability layer is written as .geojson")
    features = []
    for part in parts:
        points = part.poses[:, :2]
        place = geographic_from_grid(frame, points)[:, ::-1] if frame.is_utm else points
        for row in range(len(points)):
            values = {
                "lateral_sd_m": part.lateral_sd_m[row],
                "longitudinal_sd_m": part.longitudinal_sd_m[row],
                "yaw_sd_rad": part.yaw_sd_rad[row],
                "poles_in_view": part.poles_in_view[row],
                "east_m": points[row, 0],
                "north_m": points[row, 1],
            }
            features.append(
                {
                    "type": "Feature",
                    "geometry": {"type": "Point", "coordinates": np.round(place[row], 9).tolist()},
                    "properties": {k: _finite(float(v)) for k, v in values.items()},
                }
            )
    document: dict[str, Any] = {
        "type": "FeatureCollection",
        "polemap": {"format_version": 1, "frame": frame.to_dict()},
        "features": features,
    }
    with atomic_file(path) as target:
        target.write_text(json.dumps(document, allow_nan=False), encoding="utf-8")


def _finite(value: float) -> float | None:
    return round(value, 6) if np.isfinite(value) else None


def _density(axes: Any, points: Floats) -> Any:
    """Shade cells of a quarter of a hectare by how many poles stand there, as poles a hectare."""
    low, high = points.min(axis=0) - _CELL_M, points.max(axis=0) + _CELL_M
    edges = [np.arange(low[axis], high[axis] + _CELL_M, _CELL_M) for axis in (0, 1)]
    count, east, north = np.histogram2d(points[:, 0], points[:, 1], bins=edges)
    hectare = count.T * (1e4 / _CELL_M**2)
    shown = np.ma.masked_equal(hectare, 0.0)
    return axes.pcolormesh(east, north, shown, cmap="Greys", vmin=0.0, alpha=0.35, zorder=0)


def draw_map(pole_map: PoleMap, parts: list[Localizability], path: Path) -> None:
    """Poles coloured by existence, sized by width; their density; routes by the lateral bound."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 8.5), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    centre = pole_map.points_m.mean(axis=0).round() if pole_map.frame.is_utm else np.zeros(2)
    shade = _density(axes, pole_map.points_m - centre)
    figure.colorbar(shade, ax=axes, shrink=0.6, label="poles a hectare")
    for part in parts:
        points = part.poses[:, :2] - centre
        bound = np.minimum(part.lateral_sd_m, _WORST_M)
        route = axes.scatter(
            points[:, 0], points[:, 1], c=bound, cmap="RdYlGn_r", vmin=0.0, vmax=0.5, s=9, lw=0
        )
    if parts:
        figure.colorbar(route, ax=axes, **_BAR, label="lateral bound of one look, 1 sd (m)")
    points = pole_map.points_m - centre
    width = np.where(np.isfinite(pole_map.width_m), pole_map.width_m, 0.2)
    dots = axes.scatter(
        points[:, 0], points[:, 1], c=pole_map.existence, cmap="viridis", vmin=0.5, vmax=1.0,
        s=12 + 60 * width, edgecolors="black", linewidths=0.4,
    )  # fmt: skip
    figure.colorbar(dots, ax=axes, **_BAR, label="existence of the pole")
    axes.set_aspect("equal")
    axes.grid(alpha=0.3)
    shift = f" - {centre[0]:.0f}" if centre.any() else ""
    axes.set_xlabel(f"east{shift} (m)")
    axes.set_ylabel(f"north - {centre[1]:.0f} (m)" if centre.any() else "north (m)")
    axes.set_title(f"{len(pole_map)} poles, {pole_map.frame}")
    with atomic_file(path) as target:
        figure.savefig(target, format=path.suffix[1:].lower())
