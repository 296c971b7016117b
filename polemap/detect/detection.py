"""One frame's poles: disparity pair -> depth edges -> hypotheses -> classified, located."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from polemap.detect.classifier import PoleClassifier
from polemap.detect.config import DetectionConfig
from polemap.detect.constants import (
    ACROSS_SD_M,
    ACROSS_SD_SHARE,
    AXIS_SD_SHARE,
    AXIS_SHARE,
    COLUMN_SD_PX,
    DISPARITY_SD_PX,
    EXTENSION_SD_M,
    MATCHER_SD_PX,
    REFINE_PROBABILITY,
    STEP_MIN_M,
    STEP_MIN_PX,
)
from polemap.detect.corners import StereoCorners, find_corners
from polemap.detect.features import Profiles, measure_features
from polemap.detect.ground import Ground, fit_ground
from polemap.detect.hypotheses import Hypotheses, find_hypotheses
from polemap.detect.lines.find import find_lines
from polemap.detect.refine import refine_disparity
from polemap.detect.sight import first_of_each, sight_covariance
from polemap.detect.slices import find_slices
from polemap.detect.visibility import visible_region
from polemap.drivelog.detections import Detections, VisibleRegion
from polemap.drivelog.landmark_kind import LINE_KINDS, LandmarkKind
from polemap.drivelog.line_detections import LineDetections
from polemap.drivelog.samples import StereoFrame
from polemap.stereo.depth_edges import DepthEdges, depth_edges, upright_maps
from polemap.stereo.matching import DisparityPair
from polemap.stereo.rig import StereoRig

Floats = NDArray[np.float64]

_SHORTEST_M = 0.2
_FARTHEST = 3.0  # lengths


@dataclass(frozen=True, slots=True, kw_only=True)
class StereoDetections(Detections):
    """Hypotheses of one stereo frame, best first: detections, and what the images showed of them.

    Attributes:
        left_px, right_px, top_px, bottom_px: box in the left image (flanks at mid height).
        slope: columns a row of the axis, for pictures.
        disparity_px: of the front surface.
        border: touches the image border, so a flank is assumed.
        features: `(n, k)`.
    """

    left_px: Floats
    right_px: Floats
    top_px: Floats
    bottom_px: Floats
    slope: Floats
    disparity_px: Floats
    border: NDArray[np.bool_]
    features: Floats


@dataclass(frozen=True, slots=True)
class FrameView:
    """All that one frame showed.

    `edges` are left and right flanks; `lines` is None where none were looked for or no road was
    seen, `corners` where none were looked for.
    """

    detections: StereoDetections
    ground: Ground
    edges: tuple[DepthEdges, DepthEdges]
    region: VisibleRegion
    lines: LineDetections | None = None
    corners: StereoCorners | None = None

    @property
    def landmarks(self) -> Detections:
        """Poles, and after them corners, in one table."""
        if self.corners is None:
            return self.detections
        return Detections.concatenate([self.detections, self.corners])

    def located(self, landmarks: Detections) -> FrameView:
        """The same with places and shifts of `landmarks`, the rows of `self.landmarks`."""
        first = len(self.detections)

        def columns(rows: slice) -> dict[str, Floats]:
            return {
                "points_vehicle_m": landmarks.points_vehicle_m[rows],
                "shift_per_px_m": landmarks.shift_per_px_m[rows],
            }

        poles = self.detections.with_columns(**columns(slice(first)))
        corners = self.corners
        if corners is not None:
            corners = corners.with_columns(**columns(slice(first, None)))
        return replace(self, detections=poles, corners=corners)


def detect(
    frame: StereoFrame,
    disparity: DisparityPair,
    rig: StereoRig,
    classifier: PoleClassifier | None,
    config: DetectionConfig,
    corner_classifier: PoleClassifier | None = None,
) -> FrameView:
    """Find the poles of one frame, and corners and lines if the settings name them.

    Args:
        frame: the rectified pair.
        disparity: both checked maps of it.
        rig: its camera.
        classifier: says how likely a hypothesis is a pole; without one, as for training, all
            hypotheses are kept with probability 0.5.
        config: settings.
        corner_classifier: the same for corners, where `config.kinds` names them.
    """
    focal_baseline = rig.focal_px * rig.baseline_m
    maps = upright_maps(disparity, config.row_step_px)
    ground = fit_ground(maps, rig)
    edges = depth_edges(maps, STEP_MIN_PX, STEP_MIN_M / focal_baseline)
    hypotheses = find_hypotheses(find_slices(*edges, rig, config), ground, rig, config)
    profiles = measure_features(hypotheses, maps, frame.left, ground, rig)
    probability = np.full(len(hypotheses), 0.5)
    if classifier is not None:
        probability = classifier.probability(profiles.features)
    view = visible_region(maps, ground, rig, config)
    fitted = _fit_disparity(frame, hypotheses, profiles, probability)
    found = _locate(frame, view, hypotheses, profiles, fitted, probability, rig)
    distance = np.hypot(*(found.points_vehicle_m - view.origin_vehicle_m).T)
    found = found.take((distance >= config.range_min_m) & (distance <= config.range_max_m))
    found = _suppress(found) if classifier is not None else found
    corners = None
    if LandmarkKind.CORNER in config.landmark_kinds:
        corners = find_corners(frame, maps, edges, ground, view, rig, corner_classifier, config)
    kinds = config.landmark_kinds & LINE_KINDS
    lines = find_lines(frame.left, maps, ground, rig, kinds) if kinds else None
    return FrameView(found, ground, edges, view, lines, corners)


def _fit_disparity(
    frame: StereoFrame,
    hypotheses: Hypotheses,
    profiles: Profiles,
    probability: Floats,
) -> tuple[Floats, Floats]:
    """Disparity and standard deviation `(n,)`: of the likely ones fitted to the images."""
    likely = probability >= REFINE_PROBABILITY
    refined, refined_sd = profiles.disparity_px.copy(), profiles.disparity_sd_px.copy()
    fit = refine_disparity(
        frame.left,
        frame.right,
        profiles.left_px[likely],
        profiles.right_px[likely],
        hypotheses.top_px[likely],
        hypotheses.bottom_px[likely],
        hypotheses.slope[likely],
        refined[likely],
    )
    refined[likely] = fit.disparity_px
    # the matcher's own value, where the fit failed, is worth less than it claims
    refined_sd = np.hypot(refined_sd, MATCHER_SD_PX)
    refined_sd[likely] = np.where(fit.trusted, fit.sd_px, refined_sd[likely])
    return refined, refined_sd


def _locate(
    frame: StereoFrame,
    view: VisibleRegion,
    hypotheses: Hypotheses,
    profiles: Profiles,
    fitted: tuple[Floats, Floats],
    probability: Floats,
    rig: StereoRig,
) -> StereoDetections:
    """Axis at ground level in the vehicle frame, best hypothesis first."""
    disparity, _ = fitted
    focal_baseline = rig.focal_px * rig.baseline_m
    width_m = (profiles.right_px - profiles.left_px) * rig.baseline_m / disparity
    # what is matched is the front of a cylinder: on average 0.8 radii before its axis
    axis_m = AXIS_SHARE * width_m
    surface = focal_baseline / disparity
    shifted = focal_baseline / (surface + axis_m)
    camera = rig.camera_points(profiles.foot_column_px, profiles.foot_row_px, shifted)
    # the foot's row belongs to the surface's depth; the axis stands at the same height
    camera[:, 1] *= surface / (surface + axis_m)
    points = rig.vehicle_points(camera)[:, :2]
    n = len(points)
    order = np.argsort(-probability, kind="stable")
    return StereoDetections(
        stamp_s=frame.stamp_s,
        arrival_s=frame.arrival_s,
        view=view,
        kind=np.full(n, LandmarkKind.POLE, dtype=np.int8),
        points_vehicle_m=points,
        covariance_m2=_covariance(points, width_m, hypotheses, profiles, fitted, rig),
        width_m=width_m,
        height_m=profiles.top_m,
        probability=probability,
        track_id=np.full(n, -1, dtype=np.int64),
        shift_per_px_m=np.zeros((n, 2)),
        facing_rad=np.full(n, np.nan),
        parts=np.ones(n, dtype=np.int64),
        left_px=profiles.left_px,
        right_px=profiles.right_px,
        top_px=hypotheses.top_px,
        bottom_px=hypotheses.bottom_px,
        slope=hypotheses.slope,
        disparity_px=disparity,
        border=profiles.border,
        features=profiles.features,
    ).take(order)


def _covariance(
    points: Floats,
    width_m: Floats,
    hypotheses: Hypotheses,
    profiles: Profiles,
    fitted: tuple[Floats, Floats],
    rig: StereoRig,
) -> Floats:
    """Covariance `(n, 2, 2)` of the axis: a part along the line of sight, and one across it."""
    disparity, disparity_sd = fitted
    focal_baseline = rig.focal_px * rig.baseline_m
    surface = focal_baseline / disparity
    sd_disparity = np.hypot(DISPARITY_SD_PX, disparity_sd)
    sd_range = np.hypot(surface**2 / focal_baseline * sd_disparity, AXIS_SD_SHARE * width_m)
    sd_column = np.hypot(COLUMN_SD_PX, profiles.flank_sd_px / np.sqrt(2.0))
    sd_across = np.hypot(surface / rig.focal_px * sd_column, ACROSS_SD_M)
    # the axis is extended down to the ground: the farther for its length, the worse
    length_px = np.maximum(
        hypotheses.bottom_px - hypotheses.top_px, _SHORTEST_M * disparity / rig.baseline_m
    )
    extended = profiles.foot_row_px - 0.5 * (hypotheses.bottom_px + hypotheses.top_px)
    share = np.clip(extended / length_px, 0.0, _FARTHEST)
    sd_across = np.hypot(sd_across, EXTENSION_SD_M * share)
    # what is wide may be two things that stand side by side
    sd_across = np.hypot(sd_across, ACROSS_SD_SHARE * width_m)
    sd_across = np.where(profiles.border, np.hypot(sd_across, 0.25 * width_m + 0.05), sd_across)
    return sight_covariance(points, sd_range, sd_across, rig)


def _suppress(found: StereoDetections) -> StereoDetections:
    """Drop what a better hypothesis already explains: the same columns at a similar depth."""
    if len(found) < 2:
        return found
    overlap = np.minimum(found.right_px[:, None], found.right_px) - np.maximum(
        found.left_px[:, None], found.left_px
    )
    width = found.right_px - found.left_px
    inside = overlap > 0.3 * np.minimum(width[:, None], width)
    ratio = found.disparity_px[:, None] / found.disparity_px
    same = inside & (np.abs(np.log(ratio)) < 0.1)
    return found.take(first_of_each(same))
