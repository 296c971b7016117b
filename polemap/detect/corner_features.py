"""What a corner looks like, in metric units, so that one classifier serves many cameras."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from polemap.detect.corner_edges import UprightEdges
from polemap.detect.corner_surface import INWARD_M, Walls
from polemap.detect.ground import Ground
from polemap.stereo.rig import StereoRig

Floats = NDArray[np.float64]

_SINGLE = (
    "log_height",  # of the rows that show the edge
    "base_m",
    "top_m",
    "top_square",
    "fill",  # share of the rows between top and bottom with the edge
    "occluding",
    "wobble",  # scatter of the edge's columns about the line, m
    "lean",
    "on_share",  # of the inward samples, those on the wall
    "on_near",  # the same within 0.5 m of the edge
    "on_far",  # the same beyond
    "log_extent",  # how far the wall goes on without a break
    "nearer",  # inward samples before the wall
    "flatness",  # scatter about the wall, in depth
    "upright",  # how far the wall leans in depth
    "oblique",  # sine of the angle between wall and line of sight
    "free_share",  # of the outward samples
    "free_near",
    "beside",  # of the outward samples, those no farther than the wall
    "blank",
    "log_step",  # of the depth
    "edge_grey",  # image gradient along the edge
    "range",
    "log_pixels",  # of the wall's extent
    "over_on",  # samples over the top that still show the wall
    "border",
)
_LOW = "low_"
_BY_LOW = ("on_share", "on_far", "free_share", "log_extent", "flatness", "upright", "over_on")
NAMES = (
    *_SINGLE,
    "low",  # 1 with a top as low as a parked car's, 0 for what is taller
    "on_free",
    "on_square",
    "flatness_range",
    *(f"{_LOW}{name}" for name in _BY_LOW),
)
_CAR_M = (1.5, 2.1)


def corner_features(
    edges: UprightEdges,
    walls: Walls,
    column_px: Floats,
    edge_grey: Floats,
    ground: Ground,
    rig: StereoRig,
    width_px: int,
) -> tuple[Floats, Floats, Floats]:
    """Features `(n, len(NAMES))`; top over the ground and extent of the wall in metres, `(n,)`."""
    d = walls.disparity_px
    per_m = d / rig.baseline_m
    focal_baseline = rig.focal_px * rig.baseline_m
    foot = ground.row_px(column_px, d)
    top_m, base_m = (foot - edges.top_px) / per_m, (foot - edges.bottom_px) / per_m
    rows = np.maximum(walls.inside.sum(axis=1), 1).astype(np.float64)
    on = (walls.on & walls.inside[:, :, None]).sum(axis=1) / rows[:, None]
    along = on >= 0.5
    extent_at = np.minimum.accumulate(along, axis=1).sum(axis=1)
    extent_m = np.where(extent_at > 0, INWARD_M[np.maximum(extent_at - 1, 0)], 0.0)
    inside = walls.inside[:, :, None]
    free, beside, blank = (
        (flags & inside).sum(axis=1) / rows[:, None]
        for flags in (walls.free, walls.beside, walls.blank)
    )
    depth = focal_baseline / d
    behind = focal_baseline / np.maximum(edges.far_px, 1.0) - depth
    # angle between the wall and the line of sight: the wall's change of depth along the image
    slant = walls.along * rig.focal_px / d
    single = {
        "log_height": np.log(0.1 + np.maximum(top_m - base_m, 0.0) * edges.fill),
        "base_m": np.clip(base_m, -0.5, 3.0),
        "top_m": np.clip(top_m, 0.0, 5.0),
        "top_square": np.clip(top_m, 0.0, 5.0) ** 2,
        "fill": edges.fill,
        "occluding": edges.occluding,
        "wobble": np.minimum(edges.column_sd_px / (0.5 + 0.02 * per_m), 3.0),
        "lean": np.abs(edges.slope),
        "on_share": on.mean(axis=1),
        "on_near": on[:, :4].mean(axis=1),
        "on_far": on[:, 4:].mean(axis=1),
        "log_extent": np.log(0.1 + extent_m),
        "nearer": (walls.nearer & inside).mean(axis=(1, 2)),
        "flatness": np.minimum(walls.rms_px / (0.3 + 0.01 * d), 3.0),
        "upright": np.minimum(np.abs(walls.down) * rig.focal_px / d, 2.0),
        "oblique": 1.0 / np.sqrt(1.0 + slant**2),
        "free_share": free.mean(axis=1),
        "free_near": free[:, 0],
        "beside": beside.mean(axis=1),
        "blank": blank.mean(axis=1),
        "log_step": np.log1p(np.clip(behind, 0.05, 30.0)),
        "edge_grey": edge_grey,
        "range": depth / 10.0,
        "log_pixels": np.log(extent_m * per_m + 3.0),
        "over_on": walls.over_on,
        "border": ((column_px < 4.0 + d) | (column_px > width_px - 5.0)).astype(np.float64),
    }
    low = np.clip((_CAR_M[1] - top_m) / (_CAR_M[1] - _CAR_M[0]), 0.0, 1.0)
    values = [
        *(single[name] for name in _SINGLE),
        low,
        single["on_share"] * single["free_share"],
        single["on_share"] ** 2,
        single["flatness"] * single["range"],
        *(low * single[name] for name in _BY_LOW),
    ]
    return np.stack(values, axis=1), top_m, extent_m
