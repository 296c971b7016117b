"""What a hypothesis looks like, in metric units, so that one classifier serves many cameras.

What stands at and around it (see `surroundings`), its own shape and its place in the image make the
single features; `feature_products` adds what they tell together.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from polemap.detect import feature_products
from polemap.detect.flanks import refine_flanks
from polemap.detect.ground import Ground
from polemap.detect.hypotheses import Hypotheses
from polemap.detect.surroundings import HEIGHTS_M, Place, Surroundings, sample_surroundings
from polemap.stereo.depth_edges import UprightMaps
from polemap.stereo.rig import StereoRig

Floats = NDArray[np.float64]

_SINGLE = (
    "log_height",  # upright extent with both flanks
    "log_run",  # longest unbroken part of it
    "on_share",  # of the visible heights that show the candidate's surface
    "on_low",  # the same below 1 m
    "free_both",  # share of those with free space on both sides
    "free_left_near",
    "free_right_near",
    "free_left_wide",
    "free_right_wide",
    "hidden_share",  # heights hidden by something nearer
    "near_beside",  # something nearer beside the candidate
    "base_m",  # height of the lowest slice
    "top_m",
    "width_m",
    "width_square",
    "thinness",  # log of height over width
    "lean",
    "wobble",  # scatter of the centre line over the width
    "width_scatter",
    "depth_scatter",
    "fill",  # share of the rows between top and bottom with a slice
    "occluding_left",
    "occluding_right",
    "step_left",  # log of the depth jump
    "step_right",
    "edge_left",  # mean image gradient along the flank
    "edge_right",
    "smooth",  # vertical against horizontal texture inside
    "range_m",
    "pixels",  # log of the width in pixels
    "neighbours",  # other hypotheses of like depth within 1.5 m
    "border",
    "same_beside",  # the candidate's own depth beside it: part of something wide
    "blank_beside",  # nothing measured beside it
    "above_free",  # of the heights right above the top, those with free space
    "above_same",  # those with the candidate's own depth
)
NAMES = (*_SINGLE, *feature_products.names(_SINGLE))
_LOW_M = 1.0


@dataclass(frozen=True, slots=True)
class Profiles:
    """Measured hypotheses: features and refined geometry, one a row.

    Attributes:
        features: `(n, len(NAMES))`.
        left_px, right_px: flanks at the candidate's centre row, sharpened on the image gradient.
        foot_column_px, foot_row_px: where the axis meets the ground.
        disparity_px: of the candidate's surface.
        disparity_sd_px: standard deviation of it, from the scatter of the samples.
        flank_sd_px: standard deviation of a flank's column.
        top_m: height of the top above the ground.
        border: whether it touches the left or right image border.
    """

    features: Floats
    left_px: Floats
    right_px: Floats
    foot_column_px: Floats
    foot_row_px: Floats
    disparity_px: Floats
    disparity_sd_px: Floats
    flank_sd_px: Floats
    top_m: Floats
    border: NDArray[np.bool_]


def measure_features(
    hypotheses: Hypotheses,
    maps: UprightMaps,
    image: NDArray[np.uint8] | NDArray[np.uint16],
    ground: Ground,
    rig: StereoRig,
) -> Profiles:
    """Features and refined geometry of every hypothesis."""
    left_px, right_px, flank_sd, edge_left, edge_right, smooth = refine_flanks(hypotheses, image)
    ground_row = ground.row_px(hypotheses.column_px, hypotheses.disparity_px)
    place = Place.of(hypotheses, left_px, right_px, ground_row, rig)
    around = sample_surroundings(hypotheses, place, maps)
    refined, scatter, count = _robust(around.own_px, hypotheses.disparity_px)
    border = (left_px < 3.0 + hypotheses.disparity_px) | (right_px > maps.left.shape[1] - 4.0)
    single = {
        **_evidence(around),
        **_shape(hypotheses, place, maps.row_step_px),
        **_situation(hypotheses, rig),
        "depth_scatter": np.minimum(scatter / place.tolerance_px, 2.0),
        "edge_left": edge_left,
        "edge_right": edge_right,
        "smooth": smooth,
        "border": border.astype(np.float64),
    }
    foot_row = ground.row_px(hypotheses.column_px, refined)
    return Profiles(
        features=_in_order(single),
        left_px=left_px,
        right_px=right_px,
        foot_column_px=place.axis_px + hypotheses.slope * (foot_row - hypotheses.row_px),
        foot_row_px=foot_row,
        disparity_px=refined,
        disparity_sd_px=scatter / np.sqrt(np.maximum(count / 3.0, 1.0)),
        flank_sd_px=flank_sd,
        top_m=(ground_row - hypotheses.top_px) / place.per_m,
        border=border,
    )


def _evidence(around: Surroundings) -> dict[str, Floats]:
    """Features of what the heights show, mostly as the share of those that could show it."""
    on, visible, both = around.on, around.visible, around.free_both
    clear, low = visible & ~around.hidden, HEIGHTS_M <= _LOW_M
    near, wide = 0, 3  # offsets beside the candidate
    share_of = {  # heights that show it, and heights of which they are a share
        "on_share": (on & clear, clear),
        "on_low": (on & clear & low, clear & low),
        "free_both": (both, on),
        "free_left_near": (on & around.free_left[..., near], on),
        "free_right_near": (on & around.free_right[..., near], on),
        "free_left_wide": (on & around.free_left[..., wide], on),
        "free_right_wide": (on & around.free_right[..., wide], on),
        "hidden_share": (around.hidden, visible),
        "near_beside": (on & around.near_beside, on),
        "same_beside": (on & around.same_beside, on),
        "blank_beside": (on & around.blank_beside, on),
    }
    # all at once: counting each for itself would take several times as long
    parts, wholes = zip(*share_of.values(), strict=True)
    stacked = np.concatenate([*parts, *wholes]).reshape(2, len(share_of), *on.shape)
    count, whole = stacked.sum(axis=3)
    return {
        **dict(zip(share_of, count / np.maximum(whole, 1), strict=True)),
        "log_height": np.log(0.1 + 0.15 * both.sum(axis=1)),
        "log_run": np.log(0.1 + 0.15 * _longest_run(both)),
        "above_free": around.above_free,
        "above_same": around.above_same,
    }


def _shape(hypotheses: Hypotheses, place: Place, row_step_px: int) -> dict[str, Floats]:
    """Features of size, straightness and completeness."""
    base_m = (place.ground_row_px - hypotheses.bottom_px) / place.per_m
    top_m = (place.ground_row_px - hypotheses.top_px) / place.per_m
    width_m = place.width_px / place.per_m
    slices_full = np.maximum((hypotheses.bottom_px - hypotheses.top_px) / row_step_px + 1.0, 1.0)
    return {
        "base_m": np.clip(base_m, -0.5, 3.0),
        "top_m": np.clip(top_m, 0.0, 4.0),
        "width_m": width_m,
        "width_square": width_m**2,
        "thinness": np.log(np.maximum(top_m - base_m, 0.05) / np.maximum(width_m, 0.03)),
        "lean": np.abs(hypotheses.slope),
        "wobble": hypotheses.centre_sd_px / (0.5 + 0.2 * place.width_px),
        "width_scatter": hypotheses.width_sd_px / (0.5 + 0.2 * place.width_px),
        "fill": np.minimum(hypotheses.slices / slices_full, 1.0),
        "pixels": np.log(place.width_px),
    }


def _situation(hypotheses: Hypotheses, rig: StereoRig) -> dict[str, Floats]:
    """Features of how far it stands, before what, and beside how many others."""
    range_m = rig.focal_px * rig.baseline_m / hypotheses.disparity_px
    far = np.maximum(np.stack([hypotheses.far_left_px, hypotheses.far_right_px]), 1.0)
    behind_m = rig.focal_px * rig.baseline_m / far - range_m
    step_left, step_right = np.log1p(np.minimum(np.maximum(behind_m, 0.05), 30.0))
    lateral_m = (hypotheses.column_px - rig.cx_px) / rig.focal_px * range_m
    aside = np.abs(lateral_m[:, None] - lateral_m) < 1.5
    close = aside & (np.abs(range_m[:, None] - range_m) < 2.0)
    return {
        "occluding_left": hypotheses.occluding_left,
        "occluding_right": hypotheses.occluding_right,
        "step_left": step_left,
        "step_right": step_right,
        "range_m": range_m / 10.0,
        "neighbours": np.log(close.sum(axis=1)),
    }


def _in_order(single: dict[str, Floats]) -> Floats:
    """All features `(n, len(NAMES))`, from the single ones by name."""
    ordered = {name: single[name] for name in _SINGLE}
    every = [*ordered.values(), *feature_products.products(ordered).values()]
    return np.concatenate(every).reshape(len(NAMES), -1).T.copy()


def _robust(samples: Floats, fallback: Floats) -> tuple[Floats, Floats, Floats]:
    """Median, scaled median deviation and count of every row of samples, NaN left out."""
    count = np.isfinite(samples).sum(axis=1).astype(np.float64)
    ordered = np.sort(samples, axis=1)  # NaN last
    middle = _nth(ordered, count)
    median = np.where(count > 0, middle, fallback)
    deviation = np.sort(np.abs(samples - median[:, None]), axis=1)
    scatter = np.where(count > 2, 1.4826 * _nth(deviation, count), 1.0)
    return median, np.maximum(scatter, 0.05), count


def _nth(ordered: Floats, count: Floats) -> Floats:
    """The median of the first `count` entries of sorted rows."""
    if ordered.size == 0:
        return np.zeros(len(ordered))
    low = np.maximum((count.astype(np.int64) - 1) // 2, 0)
    high = np.minimum(count.astype(np.int64) // 2, ordered.shape[1] - 1)
    row = np.arange(len(ordered))
    return np.asarray(0.5 * (ordered[row, low] + ordered[row, high]))


def _longest_run(flags: NDArray[np.bool_]) -> Floats:
    """Longest run of true along each row."""
    so_far = flags.cumsum(axis=1)
    before = np.maximum.accumulate(np.where(flags, 0, so_far), axis=1)
    return np.asarray((so_far - before).max(axis=1), dtype=np.float64)
