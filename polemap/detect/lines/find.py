"""Lines of one frame: road from above -> points of stripes and steps -> pieces -> table.

Facades come from the disparities of whole columns (`facades.py`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from polemap.detect.constants import DISPARITY_SD_PX
from polemap.detect.ground import Ground
from polemap.detect.lines.facades import facade_lines
from polemap.detect.lines.kerbs import HEIGHT_SD_PX, kerb_points
from polemap.detect.lines.markings import MarkingPoints, marking_points
from polemap.detect.lines.pieces import CLEAR_M, SHORT, Piece, straight_pieces
from polemap.detect.lines.road_frame import RoadFrame, RoadView, view_road
from polemap.detect.lines.styles import line_styles
from polemap.drivelog.landmark_kind import LandmarkKind, LineStyle
from polemap.drivelog.line_detections import LineDetections
from polemap.drivelog.samples import Image
from polemap.stereo.depth_edges import UprightMaps
from polemap.stereo.rig import StereoRig

Floats = NDArray[np.float64]

OFFSET_SD_MAX_M = 0.2  # what is known worse helps nobody
PROBABILITY_MIN = 0.4
_ROAD_KINDS = frozenset({LandmarkKind.LANE_MARKING, LandmarkKind.KERB})
_OFFSET_SD_M = {LandmarkKind.LANE_MARKING: 0.025, LandmarkKind.KERB: 0.03}
_DIRECTION_SD_RAD = {LandmarkKind.LANE_MARKING: 0.005, LandmarkKind.KERB: 0.008}
_STRIPE_SD_M = 0.02  # of a row's middle: few rows may agree by chance
_ROWS_ALIKE = 3.0  # neighbouring rows err alike
_LEAST_ACROSS_M = 0.8  # a car's half width: no kerb passes under it
_BRIDGED_M = 0.3
_BESIDE_KERB_M = 0.5  # a bright stripe so near to a kerb is its stone


@dataclass(frozen=True, slots=True)
class _Found:
    """Pieces of one kind with their styles, probabilities, and noise of an end's offset (m)."""

    kind: LandmarkKind
    pieces: list[Piece]
    styles: list[LineStyle]
    probability: list[float]
    noise_m: list[float]


def find_lines(
    image: Image,
    maps: UprightMaps,
    ground: Ground,
    rig: StereoRig,
    kinds: frozenset[LandmarkKind],
) -> LineDetections | None:
    """Markings, kerbs and facades of one frame; None where the road's plane is not seen.

    Args:
        image: the left image `(height, width)`.
        maps: its disparities.
        ground: the road as a plane.
        rig: the camera.
        kinds: what is looked for, of `LINE_KINDS`.
    """
    if not ground.fitted:
        return None
    parts = []
    if kinds & _ROAD_KINDS:
        parts.append(_road_lines(view_road(image, maps, ground, rig), maps, kinds))
    if LandmarkKind.FACADE in kinds:
        parts.append(_well_known(facade_lines(maps, ground, rig)))
    return LineDetections.concatenate(parts)


def _road_lines(
    view: RoadView, maps: UprightMaps, kinds: frozenset[LandmarkKind]
) -> LineDetections:
    """Markings and kerbs."""
    found = []
    kerbs: list[Piece] = []
    steps: list[float] = []
    if LandmarkKind.KERB in kinds:
        points = kerb_points(view, maps)
        for side in (-1.0, 1.0):
            mine = points.side == side
            pieces = straight_pieces(points.points_m[mine], points.row[mine])
            beside = [p for p in pieces if _across_m(p) >= _LEAST_ACROSS_M]
            kerbs += beside
            steps += [float(np.median(points.step_m[mine][p.members])) for p in beside]
        unknown = [LineStyle.UNKNOWN] * len(kerbs)
        likely = [_likely(kerb) for kerb in kerbs]
        noise = [_kerb_noise_m(k, step, view.frame) for k, step in zip(kerbs, steps, strict=True)]
        found.append(_Found(LandmarkKind.KERB, kerbs, unknown, likely, noise))
    if LandmarkKind.LANE_MARKING in kinds:
        stripes = marking_points(view)
        pieces = _marking_pieces(stripes)
        pieces = [p for p in pieces if not any(_beside(p, kerb) for kerb in kerbs)]
        pieces, styles = line_styles(pieces)
        likely = [_likely(p) for p in pieces]
        noise = [
            float(max(p.rms_m, _STRIPE_SD_M) / np.sqrt(max(p.rows / _ROWS_ALIKE, 1.0)))
            for p in pieces
        ]
        found.append(_Found(LandmarkKind.LANE_MARKING, pieces, styles, likely, noise))
    return _table(found, view.frame)


def _marking_pieces(stripes: MarkingPoints) -> list[Piece]:
    """Pieces of markings, and short ones of what those leave."""
    pieces = straight_pieces(stripes.points_m, stripes.row)
    x, y = stripes.points_m.T
    left = np.ones(len(x), dtype=bool)
    for piece in pieces:
        along = (x >= piece.start_m - 0.5) & (x <= piece.end_m + 0.5)
        away = np.abs(y - piece.offset_m - piece.slope * (x - piece.middle_m))
        left &= ~(along & (away < CLEAR_M))
    return pieces + straight_pieces(stripes.points_m[left], stripes.row[left], SHORT)


def _likely(piece: Piece) -> float:
    """Probability of a piece being what its points are taken for."""
    score = 1.0 + 0.6 * (piece.length_m - 3.0) + 8.0 * (piece.share - 0.85)
    return float(1.0 / (1.0 + np.exp(-(score - 40.0 * (piece.rms_m - 0.03)))))


def _across_m(piece: Piece) -> float:
    """Distance of its line from the camera's foot."""
    return float(abs(piece.at(0.0)) / np.hypot(1.0, piece.slope))


def _kerb_noise_m(kerb: Piece, step_m: float, frame: RoadFrame) -> float:
    """How far noise of the heights shifts the place where a rise passes half the step.

    The matcher bridges the step over `_BRIDGED_M`; its errors lie along the image's columns, so
    that a piece of some metres has about one.
    """
    rig = frame.rig
    disparity = rig.focal_px * rig.baseline_m / kerb.middle_m
    height = HEIGHT_SD_PX * frame.height_m / disparity
    return float(np.hypot(height / step_m * _BRIDGED_M, kerb.rms_m / np.sqrt(2.0)))


def _beside(piece: Piece, other: Piece) -> bool:
    """Whether a piece runs along another one."""
    middle = np.clip(piece.middle_m, other.start_m - 1.0, other.end_m + 1.0)
    inside = other.start_m - 1.0 <= piece.middle_m <= other.end_m + 1.0
    return bool(inside and abs(piece.at(middle) - other.at(middle)) < _BESIDE_KERB_M)


def _table(found: list[_Found], frame: RoadFrame) -> LineDetections:
    """The table, without what is known too badly to help."""
    kind = [int(f.kind) for f in found for _ in f.pieces]
    if not kind:
        return LineDetections.none()
    pieces = [p for f in found for p in f.pieces]
    ends = [[[x, p.at(x)] for p in pieces for x in (p.start_m, p.end_m)]]
    start, end = frame.vehicle_points(np.reshape(ends, (-1, 2, 2))).transpose(1, 0, 2)
    offset_sd, direction_sd = np.array([
        _deviations(p, f.kind, noise, frame)
        for f in found for p, noise in zip(f.pieces, f.noise_m, strict=True)
    ]).T  # fmt: skip
    lines = LineDetections(
        kind=np.array(kind, dtype=np.int8),
        style=np.array([s for f in found for s in f.styles], dtype=np.int8),
        start_vehicle_m=np.ascontiguousarray(start),
        end_vehicle_m=np.ascontiguousarray(end),
        offset_sd_m=offset_sd,
        direction_sd_rad=direction_sd,
        probability=np.array([p for f in found for p in f.probability]),
    )
    return _well_known(lines)


def _well_known(lines: LineDetections) -> LineDetections:
    return lines.take(
        (lines.offset_sd_m <= OFFSET_SD_MAX_M) & (lines.probability >= PROBABILITY_MIN)
    )


def _deviations(
    piece: Piece, kind: LandmarkKind, noise_m: float, frame: RoadFrame
) -> tuple[float, float]:
    """Standard deviations of offset (m) and direction (rad).

    Beside the points' scatter: an error of the disparities that all of the piece shares shifts it
    along the rays, so across by its share of the line's distance from the camera's foot, and turns
    it, because far points are shifted by more.
    """
    rig = frame.rig
    across = _across_m(piece)
    per_m = DISPARITY_SD_PX / (rig.focal_px * rig.baseline_m)
    offset = np.hypot(_OFFSET_SD_M[kind], noise_m)
    direction = np.hypot(_DIRECTION_SD_RAD[kind], noise_m * np.sqrt(12.0) / piece.length_m)
    return (
        float(np.hypot(offset, across * per_m * piece.middle_m)),
        float(np.hypot(direction, across * per_m)),
    )
