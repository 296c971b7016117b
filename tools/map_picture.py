"""Pictures of a map: poles by existence, and how well they would locate a car along the routes."""

from __future__ import annotations

import json
import textwrap
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.atomic import atomic_file
from polemap.drivelog.drive import Drive
from polemap.drivelog.errors import InputError
from polemap.drivelog.frames import EarthFrame, geographic_from_grid
from polemap.drivelog.landmark_kind import LandmarkKind, LineStyle, kind_name
from polemap.drivelog.results.signature import CREATOR
from polemap.evaluation.localizability import Localizability, drive_sensor, localizability
from polemap.extras import check_installed
from polemap.map.line_map import LineMap
from polemap.map.pole_map import PoleMap
from polemap.settings import Settings
from polemap.tools.background import Background, draw_background

Floats = NDArray[np.float64]

_STEP_M = 2.0
_WORST_M = 1.0
_CELL_M = 50.0
# slim bars below the map
_BAR: dict[str, Any] = {"shrink": 0.9, "aspect": 50, "pad": 0.01}
_LINE_COLOURS = {
    LandmarkKind.LANE_MARKING: "0.45",
    LandmarkKind.KERB: "sienna",
    LandmarkKind.FACADE: "slateblue",
}
_LETTERS_PT, _WIDTH_IN, _MARGIN, _TITLE_LETTERS = 15, 9.0, 0.05, 52


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
        holders = _holders(part)
        for row in range(len(points)):
            values = {
                "lateral_sd_m": part.lateral_sd_m[row],
                "longitudinal_sd_m": part.longitudinal_sd_m[row],
                "yaw_sd_rad": part.yaw_sd_rad[row],
                "poles_in_view": part.poles_in_view[row],
                **{
                    f"{kind.name.lower()}s_in_view": one.expected[row]
                    for kind, one in part.by_kind.items()
                    if kind != LandmarkKind.POLE
                },
                "east_m": points[row, 0],
                "north_m": points[row, 1],
            }
            features.append(
                {
                    "type": "Feature",
                    "geometry": {"type": "Point", "coordinates": np.round(place[row], 9).tolist()},
                    "properties": {
                        **{k: _finite(float(v)) for k, v in values.items()},
                        **{name: held[row] for name, held in holders.items()},
                    },
                }
            )
    document: dict[str, Any] = {
        "type": "FeatureCollection",
        "polemap": {"format_version": 1, "frame": frame.to_dict()},
        "features": features,
    }
    with atomic_file(path) as target:
        target.write_text(json.dumps(document, allow_nan=False), encoding="utf-8")


def _holders(part: Localizability) -> dict[str, list[str]]:
    """Names of the kinds that alone hold each pose, aside and along the street."""
    held = {kind.name.lower(): part.holding(kind) for kind in part.by_kind}
    return {
        f"{name}_held_by": [
            " ".join(kind for kind, both in held.items() if both[axis][row])
            for row in range(len(part.poses))
        ]
        for axis, name in enumerate(("lateral", "longitudinal"))
    }


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


def draw_map(
    pole_map: PoleMap,
    parts: list[Localizability],
    path: Path,
    background: Background | None = None,
) -> None:
    """Landmarks coloured by existence, poles sized by width; their density, or what lies under
    them; routes by the lateral bound."""
    import matplotlib as mpl
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    places = pole_map.points_m
    if pole_map.lines is not None:
        places = np.concatenate([places, pole_map.lines.vertices_m])
    centre = places.mean(axis=0).round() if pole_map.frame.is_utm else np.zeros(2)
    shown = [places, *(part.poses[:, :2] for part in parts)]
    low, high = _extent(np.concatenate(shown) - centre)
    # the letters are to be read on a phone, where the picture is some seven centimetres wide
    with mpl.rc_context({"font.size": _LETTERS_PT}):
        figure = Figure(figsize=_size_in(low, high), dpi=110, layout="constrained")
        FigureCanvasAgg(figure)
        axes = figure.add_subplot()
        if background is not None:
            draw_background(axes, background, centre)
        _draw(axes, figure, pole_map, parts, centre, shaded=background is None)
        axes.set_aspect("equal")
        axes.set_xlim(low[0], high[0])
        axes.set_ylim(low[1], high[1])
        with atomic_file(path) as target:
            kind = path.suffix[1:].lower()
            figure.savefig(target, format=kind, metadata={"Creator": CREATOR})


def _extent(points_m: Floats) -> tuple[Floats, Floats]:
    """Corners around what is drawn, with a margin; no side is less than a third of the other."""
    low, high = points_m.min(axis=0), points_m.max(axis=0)
    span = np.maximum(high - low, 1.0)
    span = np.maximum(span * (1.0 + 2.0 * _MARGIN), span.max() / 3.0)
    middle = 0.5 * (low + high)
    return middle - 0.5 * span, middle + 0.5 * span


def _size_in(low: Floats, high: Floats) -> tuple[float, float]:
    """A figure in which the map fills its place, with the bars below it."""
    east, north = high - low
    return _WIDTH_IN, float(np.clip(_WIDTH_IN * north / east, 4.0, 14.0)) + 2.6


def _draw(
    axes: Any, figure: Any, pole_map: PoleMap, parts: list[Localizability], centre: Floats,
    *, shaded: bool,
) -> None:  # fmt: skip
    points = pole_map.points_m - centre
    if pole_map.lines is not None and len(pole_map.lines):
        _draw_lines(axes, pole_map.lines, centre)
    for part in parts:
        route_m = part.poses[:, :2] - centre
        bound = np.minimum(part.lateral_sd_m, _WORST_M)
        route = axes.scatter(
            route_m[:, 0], route_m[:, 1], c=bound, cmap="RdYlGn_r", vmin=0.0, vmax=0.5, s=14, lw=0
        )
    bars = [(_draw_points(axes, pole_map, points), "existence")]
    poles = points[pole_map.kind == LandmarkKind.POLE]
    shaded = shaded and len(poles) > 0
    bars += [(_density(axes, poles), "poles a hectare")] if shaded else []
    bars += [(route, "lateral bound, 1 sd (m)")] if parts else []
    for drawn, label in bars:
        figure.colorbar(drawn, ax=axes, location="bottom", label=label, **_BAR)
    axes.grid(alpha=0.3)
    shift = f" - {centre[0]:.0f}" if centre.any() else ""
    axes.set_xlabel(f"east{shift} (m)")
    axes.set_ylabel(f"north - {centre[1]:.0f} (m)" if centre.any() else "north (m)")
    axes.set_title(textwrap.fill(f"{pole_map.described}, {pole_map.frame}", _TITLE_LETTERS))
    if axes.get_legend_handles_labels()[1]:
        axes.legend(loc="best", fontsize="small")


def _draw_points(axes: Any, pole_map: PoleMap, points: Floats) -> Any:
    """Poles as circles as wide as they are, what is none of them as triangles that are named."""
    width = np.where(np.isfinite(pole_map.width_m), pole_map.width_m, 0.2)
    dots = None
    for kind in np.unique([LandmarkKind.POLE, *pole_map.kind]).tolist():
        chosen = pole_map.kind == kind
        pole = kind == LandmarkKind.POLE
        drawn = axes.scatter(
            points[chosen, 0], points[chosen, 1], c=pole_map.existence[chosen], cmap="viridis",
            vmin=0.5, vmax=1.0, s=24 + 80 * width[chosen], marker="o" if pole else "^",
            edgecolors="black", linewidths=0.5, label=None if pole else kind_name(kind),
        )  # fmt: skip
        dots = dots or drawn
    return dots


def _draw_lines(axes: Any, lines: LineMap, centre: Floats) -> None:
    """Markings dashed where the road's are, kerbs and facades whole."""
    for row in range(len(lines)):
        colour = _LINE_COLOURS[LandmarkKind(int(lines.kind[row]))]
        style = "--" if lines.style[row] == LineStyle.DASHED else "-"
        east, north = (lines.polyline_m(row) - centre).T
        axes.plot(east, north, style, color=colour, linewidth=1.2, zorder=0.5)
    for kind in np.unique(lines.kind).tolist():
        colour = _LINE_COLOURS[LandmarkKind(kind)]
        axes.plot([], [], color=colour, linewidth=1.2, label=kind_name(kind))
