"""Pictures of what the eye saw: the left image with everything on it, and a view from above."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from polemap.detect.corners import StereoCorners
from polemap.drivelog.landmark_kind import LandmarkKind
from polemap.drivelog.line_detections import LineDetections
from polemap.drivelog.samples import Image
from polemap.perception import PerceivedFrame
from polemap.stereo.rig import StereoRig
from polemap.tools.detect_lines import COLOURS, draw_lines

Picture = NDArray[np.uint8]
Floats = NDArray[np.float64]

_POLE, _OTHER, _TRACK, _MAP = (80, 220, 60), (70, 70, 255), (255, 220, 60), (60, 160, 255)
_LEFT_EDGE, _RIGHT_EDGE, _GROUND, _VIEW = (0, 200, 0), (255, 0, 255), (200, 200, 0), (90, 90, 90)
_CORNER, _TICK_PX = (255, 160, 40), 9
_BEV_M, _BEV_SCALE = (30.0, 15.0), 13.0  # ahead and to each side; pixels a metre
_FONT = cv2.FONT_HERSHEY_SIMPLEX


def write_overlay(
    path: Path,
    perceived: PerceivedFrame,
    probability_min: float,
    mapped_vehicle_m: Floats | None = None,
    rig: StereoRig | None = None,
) -> None:
    """`overlay` as a file."""
    cv2.imwrite(str(path), overlay(perceived, probability_min, mapped_vehicle_m, rig))


def overlay(
    perceived: PerceivedFrame,
    probability_min: float,
    mapped_vehicle_m: Floats | None = None,
    rig: StereoRig | None = None,
) -> Picture:
    """Image with edges, hypotheses, ids and ground; below it the disparity; beside it from above.

    Args:
        probability_min: hypotheses from it on are drawn as poles.
        mapped_vehicle_m: `(n, 2)`, the poles of a map in the vehicle frame.
        rig: the camera, with which lines are drawn, too.

    Returns:
        `(height, width, 3)`, blue first, as OpenCV has it.
    """
    picture = _draw_edges(_grey(perceived.frame.left), perceived)
    picture = _draw_hypotheses(picture, perceived, probability_min)
    if perceived.view.corners is not None:
        picture = _draw_corners(picture, perceived, perceived.view.corners, probability_min)
    if rig is not None:
        picture = draw_lines(picture, perceived, rig)
    depth = _colours(perceived.disparity.left)
    stacked = np.vstack([picture, depth])
    above = _from_above(perceived, probability_min, mapped_vehicle_m)
    scale = stacked.shape[0] / above.shape[0]
    beside = cv2.resize(above, (int(above.shape[1] * scale), stacked.shape[0]))
    return np.hstack([stacked, beside]).astype(np.uint8, copy=False)


def _grey(image: Image) -> Picture:
    top = max(float(np.percentile(image[::4, ::4], 99.5)), 1.0)
    if image.dtype == np.uint8:
        return np.asarray(cv2.cvtColor(image, cv2.COLOR_GRAY2BGR), dtype=np.uint8)
    eight = np.clip(image * (255.0 / top), 0, 255).astype(np.uint8)
    return np.asarray(cv2.cvtColor(eight, cv2.COLOR_GRAY2BGR), dtype=np.uint8)


def _colours(disparity: NDArray[np.float32]) -> Picture:
    valid = disparity > 0
    top = float(np.percentile(disparity[valid], 99.0)) if valid.any() else 1.0
    level = np.clip(np.nan_to_num(disparity) * (255.0 / top), 0, 255).astype(np.uint8)
    picture: Any = cv2.applyColorMap(level, cv2.COLORMAP_TURBO)
    return np.where(valid[:, :, None], picture, 0).astype(np.uint8)


def _draw_edges(picture: Picture, perceived: PerceivedFrame) -> Picture:
    for edges, colour in zip(perceived.view.edges, (_LEFT_EDGE, _RIGHT_EDGE), strict=True):
        column = np.clip(np.rint(edges.column_px).astype(int), 0, picture.shape[1] - 1)
        picture[edges.row_px, column] = colour
    return picture


def _draw_hypotheses(
    picture: Picture, perceived: PerceivedFrame, probability_min: float
) -> Picture:
    found, ground = perceived.view.detections, perceived.view.ground
    ids = dict(zip(perceived.tracks.detection.tolist(), perceived.tracks.ids.tolist(), strict=True))
    confirmed = dict(
        zip(perceived.tracks.ids.tolist(), perceived.tracks.confirmed.tolist(), strict=True)
    )
    for row in range(len(found)):
        sure = found.probability[row] >= probability_min
        colour = _POLE if sure else _OTHER
        top, bottom = float(found.top_px[row]), float(found.bottom_px[row])
        middle = 0.5 * (top + bottom)
        for flank in (found.left_px[row], found.right_px[row]):
            line = [
                (round(float(flank + found.slope[row] * (v - middle))), round(v))
                for v in (top, bottom)
            ]
            cv2.line(picture, line[0], line[1], colour, 1, cv2.LINE_AA)
        centre = 0.5 * (found.left_px[row] + found.right_px[row])
        foot = float(ground.row_px(centre, found.disparity_px[row]))
        cv2.line(
            picture,
            (round(float(found.left_px[row])) - 3, round(foot)),
            (round(float(found.right_px[row])) + 3, round(foot)),
            _GROUND,
            1,
        )
        text = f"{found.probability[row]:.2f}"
        if row in ids:
            text += f" #{ids[row]}" + ("" if confirmed[ids[row]] else "?")
        _text(picture, text, (round(float(centre)) - 14, round(top) - 4), colour)
    return picture


def _draw_corners(
    picture: Picture, perceived: PerceivedFrame, corners: StereoCorners, probability_min: float
) -> Picture:
    """Edges with a tick to their free side, and their tracks."""
    tracks, first = perceived.tracks, len(perceived.view.detections)
    row_of = {int(row) - first: at for at, row in enumerate(tracks.detection)}
    ends = [(v, corners.edge_px(v)) for v in (corners.top_px, corners.bottom_px)]
    for row in range(len(corners)):
        colour = _CORNER if corners.probability[row] >= probability_min else _OTHER
        top, bottom = ((round(float(u[row])), round(float(v[row]))) for v, u in ends)
        cv2.line(picture, top, bottom, colour, 1, cv2.LINE_AA)
        middle = ((top[0] + bottom[0]) // 2, (top[1] + bottom[1]) // 2)
        tick = (round(middle[0] + _TICK_PX * float(corners.free[row])), middle[1])
        cv2.line(picture, middle, tick, colour, 1, cv2.LINE_AA)
        text = f"{corners.probability[row]:.2f}"
        if row in row_of:
            at = row_of[row]
            text += f" #{tracks.ids[at]}" + ("" if tracks.confirmed[at] else "?")
        _text(picture, text, (top[0] - 14, bottom[1] + 10), colour)
    return picture


def _from_above(
    perceived: PerceivedFrame, probability_min: float, mapped_vehicle_m: Floats | None
) -> Picture:
    ahead, aside = _BEV_M
    picture: Picture = np.full(
        (int(ahead * _BEV_SCALE), int(2 * aside * _BEV_SCALE), 3), 25, np.uint8
    )

    def pixel(point: Any) -> tuple[int, int]:
        x, y = float(point[0]), float(point[1])
        return round((aside - y) * _BEV_SCALE), round((ahead - x) * _BEV_SCALE)

    region = perceived.view.region
    bins = len(region.free_range_m)
    span = region.bearing_max_rad - region.bearing_min_rad
    bearing = region.bearing_min_rad + (np.arange(bins) + 0.5) / bins * span
    ends = region.origin_vehicle_m + region.free_range_m[:, None] * np.stack(
        [np.cos(bearing), np.sin(bearing)], axis=1
    )
    outline = np.array([pixel(p) for p in [region.origin_vehicle_m, *ends]], dtype=np.int32)
    cv2.polylines(picture, [outline], True, _VIEW, 1)
    for metres in range(5, int(ahead) + 1, 5):
        _text(picture, f"{metres} m", (2, pixel((metres, 0))[1]), _VIEW)
    if mapped_vehicle_m is not None:
        for point in mapped_vehicle_m:
            cv2.circle(picture, pixel(point), 6, _MAP, 1, cv2.LINE_AA)
    lines = perceived.view.lines
    lines = LineDetections.none() if lines is None else lines
    for row in range(len(lines)):
        colour = COLOURS[LandmarkKind(lines.kind[row])]
        cv2.line(picture, pixel(lines.start_vehicle_m[row]), pixel(lines.end_vehicle_m[row]),
                 colour, 1, cv2.LINE_AA)  # fmt: skip
    found = perceived.view.detections
    for row in range(len(found)):
        sure = found.probability[row] >= probability_min
        _ellipse(picture, found.points_vehicle_m[row], found.covariance_m2[row], pixel,
                 _POLE if sure else _OTHER)  # fmt: skip
    corners = perceived.view.corners
    if corners is not None:
        for row in np.flatnonzero(corners.probability >= probability_min).tolist():
            place, facing = corners.points_vehicle_m[row], corners.facing_rad[row]
            _ellipse(picture, place, corners.covariance_m2[row], pixel, _CORNER)
            tip = place + np.array([np.cos(facing), np.sin(facing)])
            cv2.line(picture, pixel(place), pixel(tip), _CORNER, 1, cv2.LINE_AA)
    tracks = perceived.tracks
    for row in np.flatnonzero(tracks.confirmed).tolist():
        place = pixel(tracks.points_vehicle_m[row])
        cv2.drawMarker(picture, place, _TRACK, cv2.MARKER_CROSS, 7, 1)
        _text(picture, f"#{tracks.ids[row]}", (place[0] + 5, place[1] - 3), _TRACK)
    return picture


def _ellipse(
    picture: Picture, point: Floats, covariance: Floats, pixel: Any, colour: tuple[int, int, int]
) -> None:
    """Two standard deviations."""
    values, axes = np.linalg.eigh(covariance)
    turn = np.linspace(0, 2 * np.pi, 24)
    circle = np.stack([np.cos(turn), np.sin(turn)], axis=1) * 2 * np.sqrt(np.maximum(values, 0))
    line = np.array([pixel(p) for p in point + circle @ axes.T], dtype=np.int32)
    cv2.polylines(picture, [line], True, colour, 1, cv2.LINE_AA)


def _text(picture: Picture, text: str, at: tuple[int, int], colour: tuple[int, int, int]) -> None:
    place = (int(np.clip(at[0], 0, picture.shape[1] - 20)), int(max(at[1], 10)))
    cv2.putText(picture, text, place, _FONT, 0.38, (0, 0, 0), 2, cv2.LINE_AA)
    cv2.putText(picture, text, place, _FONT, 0.38, colour, 1, cv2.LINE_AA)
