"""Where one frame could have shown a pole: field of view, range, and what stands before it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from polemap.detect.config import DetectionConfig
from polemap.detect.ground import Ground
from polemap.drivelog.detections import VisibleRegion
from polemap.stereo.depth_edges import UprightMaps
from polemap.stereo.rig import StereoRig

Floats = NDArray[np.float64]

_BINS = 64
_COLUMNS = 4  # a bin
_HEIGHTS_M = np.arange(0.7, 2.6, 0.15)  # the part of a pole by which it is found
_AT_RANGE_M = 12.0
_FREE_SHARE = 0.4  # a pole of which so much is visible can be found
_MARGIN_M = 0.7
_MARGIN_PX = 0.3
_BORDER_PX = 6.0


def visible_region(
    maps: UprightMaps, ground: Ground, rig: StereoRig, config: DetectionConfig
) -> VisibleRegion:
    """The sector of the left view that both cameras see, with the free range of each bearing.

    In every bearing the disparities of a band of rows about the horizon are taken; the range at
    which the nearest 60 % of them end is where a pole behind would be hidden. Pixels without
    disparity hide nothing: they say nothing.
    """
    height, width = maps.left.shape
    mount = rig.vehicle_from_camera
    bearing = _bearings(rig, width)
    centres = bearing[0] + (np.arange(_BINS * _COLUMNS) + 0.5) / (_BINS * _COLUMNS) * (
        bearing[1] - bearing[0]
    )
    columns = rig.cx_px - rig.focal_px * np.tan(centres - mount.yaw_rad)
    at = rig.focal_px * rig.baseline_m / _AT_RANGE_M
    rows = ground.row_px(columns, np.full(len(columns), at))[:, None] - _HEIGHTS_M * (
        at / rig.baseline_m
    )
    v = np.rint(rows / maps.row_step_px).astype(np.int64)
    u = np.clip(np.rint(columns).astype(np.int64), 0, width - 1)[:, None]
    seen = maps.left[np.clip(v, 0, height - 1), u]
    seen = np.where((v >= 0) & (v < height), seen, 0.0)
    ordered = np.sort(seen.reshape(_BINS, -1), axis=1)
    blocking = ordered[:, int(_FREE_SHARE * ordered.shape[1])]
    forward = rig.focal_px * rig.baseline_m / np.maximum(blocking, 1e-3)
    middle = centres.reshape(_BINS, _COLUMNS).mean(axis=1) - mount.yaw_rad
    margin = _MARGIN_M + _MARGIN_PX * forward**2 / (rig.focal_px * rig.baseline_m)
    free = np.minimum(forward / np.cos(middle) + margin, config.range_max_m)
    return _region(rig, bearing, free, config)


def camera_sector(rig: StereoRig, config: DetectionConfig) -> VisibleRegion:
    """The sector in which the left view shows poles while nothing stands before them."""
    bearing = _bearings(rig, rig.width_px)
    return _region(rig, bearing, np.array([config.range_max_m]), config)


def _bearings(rig: StereoRig, width_px: int) -> Floats:
    """Right and left edge of the view, `(2,)`; right is negative."""
    edge_px = np.array([width_px - 1 - _BORDER_PX, _BORDER_PX])
    return np.asarray(
        rig.vehicle_from_camera.yaw_rad - np.arctan((edge_px - rig.cx_px) / rig.focal_px)
    )


def _region(
    rig: StereoRig, bearing: Floats, free_m: Floats, config: DetectionConfig
) -> VisibleRegion:
    mount = rig.vehicle_from_camera
    return VisibleRegion(
        origin_vehicle_m=np.array([mount.x_m, mount.y_m]),
        bearing_min_rad=float(bearing[0]),
        bearing_max_rad=float(bearing[1]),
        range_min_m=config.range_min_m,
        free_range_m=free_m,
    )
