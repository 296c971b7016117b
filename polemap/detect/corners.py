"""One frame's corners: depth edges -> upright edges with a wall on one side -> classified, located.

Vertical edges of houses, walls and gates: the wall is a plane up to the edge, and beyond it lies
something farther. A trunk or a post has no wall, the outline of a round thing no plane.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from polemap.detect.classifier import PoleClassifier
from polemap.detect.config import DetectionConfig
from polemap.detect.corner_constants import (
    CORNER_ACROSS_SD_M,
    CORNER_COLUMN_SD_PX,
    CORNER_DISPARITY_SD_PX,
    EXTENT_MIN_M,
)
from polemap.detect.corner_edges import UprightEdges, find_upright_edges
from polemap.detect.corner_features import corner_features
from polemap.detect.corner_surface import Walls, sample_walls
from polemap.detect.ground import Ground
from polemap.detect.sight import first_of_each, sight_covariance
from polemap.drivelog.detections import Detections, VisibleRegion
from polemap.drivelog.landmark_kind import LandmarkKind
from polemap.drivelog.samples import Image, StereoFrame
from polemap.stereo.depth_edges import DepthEdges, UprightMaps
from polemap.stereo.rig import StereoRig

Floats = NDArray[np.float64]

_ROWS = 20  # along the edge, for the mean gradient
_REACH_PX = 3
_OFFSETS = np.arange(-_REACH_PX - 1, _REACH_PX + 2)
_NEARNESS = np.exp(-0.5 * (np.arange(-_REACH_PX, _REACH_PX + 1) / 1.8) ** 2)


@dataclass(frozen=True, slots=True, kw_only=True)
class StereoCorners(Detections):
    """Corners of one stereo frame, best first, and what the images showed of them.

    Attributes:
        column_px, row_px, slope: the edge in the left view, `column + slope * (row - row_px)`.
        top_px, bottom_px: its first and last row.
        free: 1 where the free side lies right of it in the image, -1 left of it.
        disparity_px: of the wall at the edge.
        features: `(n, k)`.
    """

    column_px: Floats
    row_px: Floats
    slope: Floats
    top_px: Floats
    bottom_px: Floats
    free: Floats
    disparity_px: Floats
    features: Floats

    def edge_px(self, row_px: Floats) -> Floats:
        """Columns `(n,)` of the edges in an image row each."""
        return np.asarray(self.column_px + self.slope * (row_px - self.row_px))


def find_corners(
    frame: StereoFrame,
    maps: UprightMaps,
    edges: tuple[DepthEdges, DepthEdges],
    ground: Ground,
    view: VisibleRegion,
    rig: StereoRig,
    classifier: PoleClassifier | None,
    config: DetectionConfig,
) -> StereoCorners:
    """The corners of one frame.

    Args:
        frame: the rectified pair.
        maps, edges, ground, view: of this frame, as the poles are found with.
        rig: its camera.
        classifier: says how likely a candidate is a corner; without one, as for training, all
            are kept with probability 0.5.
        config: settings.
    """
    found = find_upright_edges(edges, ground, rig, config)
    column, sharp, grey = _sharpened(found, frame.left)
    walls = sample_walls(found, column, maps, ground, rig)
    features, top_m, extent_m = corner_features(
        found, walls, column, grey, ground, rig, maps.left.shape[1]
    )
    probability = np.full(len(found), 0.5)
    if classifier is not None:
        probability = classifier.probability(features)
    corners = _located(
        frame, view, found, walls, column, sharp, rig, ground, top_m, features, probability
    )
    distance = np.hypot(*(corners.points_vehicle_m - view.origin_vehicle_m).T)
    good = (distance >= config.range_min_m) & (distance <= config.range_max_m)
    good &= extent_m >= EXTENT_MIN_M
    order = np.argsort(-probability, kind="stable")
    corners = corners.take(order[good[order]])
    return _suppress(corners) if classifier is not None else corners


def _sharpened(edges: UprightEdges, image: Image) -> tuple[Floats, NDArray[np.bool_], Floats]:
    """Columns on the strongest mean gradient along the edge; whether there is one; its strength."""
    n = len(edges)
    height, width = image.shape
    share = (np.arange(_ROWS) + 0.5) / _ROWS
    rows = edges.top_px[:, None] + (edges.bottom_px - edges.top_px)[:, None] * share
    line = edges.column_px[:, None] + edges.slope[:, None] * (rows - edges.row_px[:, None])
    v = np.clip(np.rint(rows).astype(np.int64), 0, height - 1)
    contrast = float(cv2.meanStdDev(image[::8, ::8])[1].item()) + 1e-6
    base = np.rint(line)
    u = np.clip(base.astype(np.int64)[..., None] + _OFFSETS, 0, width - 1)
    value = image.ravel().take(u + v[:, :, None] * width).astype(np.float64)
    gradient = 0.5 * (value[..., 2:] - value[..., :-2]) / contrast
    strength = np.abs(gradient.mean(axis=1)) + 0.35 * np.abs(gradient).mean(axis=1)
    strength = strength * _NEARNESS
    at = np.clip(strength.argmax(axis=1), 1, 2 * _REACH_PX - 1)
    row = np.arange(n)
    before, peak, after = strength[row, at - 1], strength[row, at], strength[row, at + 1]
    bend = before - 2.0 * peak + after
    fraction = np.where(bend < -1e-9, 0.5 * (before - after) / np.minimum(bend, -1e-9), 0.0)
    moved = at - _REACH_PX + np.clip(fraction, -0.5, 0.5) + (base - line).mean(axis=1)
    sharp = (peak >= 1.6 * (np.sort(strength, axis=1)[:, _REACH_PX] + 0.02)) & (peak >= 0.05)
    return edges.column_px + np.where(sharp, moved, 0.0), sharp, np.minimum(peak, 1.5)


def _located(
    frame: StereoFrame,
    view: VisibleRegion,
    edges: UprightEdges,
    walls: Walls,
    column_px: Floats,
    sharp: NDArray[np.bool_],
    rig: StereoRig,
    ground: Ground,
    top_m: Floats,
    features: Floats,
    probability: Floats,
) -> StereoCorners:
    """Edges at ground level in the vehicle frame."""
    d = np.maximum(walls.disparity_px, 0.5)
    foot_row = ground.row_px(column_px, d)
    foot_column = column_px + edges.slope * (foot_row - edges.row_px)
    points = rig.vehicle_points(rig.camera_points(foot_column, foot_row, d))[:, :2]
    n = len(points)
    return StereoCorners(
        stamp_s=frame.stamp_s,
        arrival_s=frame.arrival_s,
        view=view,
        kind=np.full(n, LandmarkKind.CORNER, dtype=np.int8),
        points_vehicle_m=points,
        covariance_m2=_covariance(points, d, walls.disparity_sd_px, sharp, rig),
        width_m=np.full(n, np.nan),
        height_m=top_m,
        probability=probability,
        track_id=np.full(n, -1, dtype=np.int64),
        shift_per_px_m=np.zeros((n, 2)),
        facing_rad=_facing(walls, column_px, edges.free, rig),
        parts=np.ones(n, dtype=np.int64),
        column_px=column_px,
        row_px=edges.row_px,
        slope=edges.slope,
        top_px=edges.top_px,
        bottom_px=edges.bottom_px,
        free=edges.free,
        disparity_px=d,
        features=features,
    )


def _facing(walls: Walls, column_px: Floats, free: Floats, rig: StereoRig) -> Floats:
    """Directions `(n,)` in which the wall would go on: out of the wall over its edge.

    On the plane d = a + k (u - u_edge) is f b = (a - k (u_edge - c_x)) Z + k f X, so the wall runs
    along (X, Z) = (a - k (u_edge - c_x), -k f).
    """
    k, f = walls.along, rig.focal_px
    across = walls.disparity_px - k * (column_px - rig.cx_px)
    x, z = across * free, -k * f * free  # the image's right is +X wherever `across` is positive
    turned = rig.vehicle_from_camera.rotation() @ np.stack([x, np.zeros_like(x), z])
    return np.asarray(np.arctan2(turned[1], turned[0]))


def _covariance(
    points: Floats, d: Floats, disparity_sd: Floats, sharp: NDArray[np.bool_], rig: StereoRig
) -> Floats:
    """Covariance `(n, 2, 2)`: a part along the line of sight, and one across it."""
    focal_baseline = rig.focal_px * rig.baseline_m
    depth = focal_baseline / d
    sd_range = depth**2 / focal_baseline * np.hypot(CORNER_DISPARITY_SD_PX, disparity_sd)
    sd_column = np.where(sharp, CORNER_COLUMN_SD_PX, 2.0 * CORNER_COLUMN_SD_PX)
    sd_across = np.hypot(depth / rig.focal_px * sd_column, CORNER_ACROSS_SD_M)
    return sight_covariance(points, sd_range, sd_across, rig)


def _suppress(found: StereoCorners) -> StereoCorners:
    """Drop what a better candidate already explains: the same place."""
    gap = np.hypot(*np.moveaxis(found.points_vehicle_m[:, None] - found.points_vehicle_m, 2, 0))
    same = gap < 0.4 + 0.02 * np.hypot(*found.points_vehicle_m.T)
    return found.take(first_of_each(same))
