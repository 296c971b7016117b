"""What a hypothesis looks like, in metric units, so that one classifier serves many cameras.

Around every hypothesis the disparity is sampled on a grid of metres: heights above the local
ground, and offsets inside and beside the stem. Every sample says whether the stem's own surface,
something nearer, something farther or nothing was measured there. Left of the stem the right map
is asked, right of it the left map: each sees past its own flank (see `stereo.depth_edges`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from polemap import feature_products
from polemap.flanks import INSIDE, sharpen
from polemap.ground import Ground
from polemap.hypotheses import Stems
from stereo.depth_edges import UprightMaps
from stereo.rig import StereoRig

Floats = NDArray[np.float64]

HEIGHTS_M = np.arange(0.2, 3.3, 0.15)
BESIDE_M = np.array([0.12, 0.25, 0.45, 0.75])  # beyond the flank
_PARTS = (len(INSIDE), len(INSIDE) + len(BESIDE_M))  # samples inside, right, left
_ABOVE_M = np.array([0.15, 0.3, 0.45, 0.6])  # beyond the top
_CLEAR_PX = 2.5  # matchers blur a flank by about so much
_FAR_M = 0.5  # depth difference that counts as free

_SINGLE = (
    "log_height",  # upright extent with both flanks
    "log_run",  # longest unbroken part of it
    "on_share",  # of the visible heights that show the stem's surface
    "on_low",  # the same below 1 m
    "free_both",  # share of those with free space on both sides
    "free_left_near",
    "free_right_near",
    "free_left_wide",
    "free_right_wide",
    "hidden_share",  # heights hidden by something nearer
    "near_beside",  # something nearer beside the stem
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
    "same_beside",  # the stem's own depth beside it: part of something wide
    "blank_beside",  # nothing measured beside it
    "above_free",  # of the heights right above the top, those with free space
    "above_same",  # those with the stem's own depth
)
NAMES = (*_SINGLE, *feature_products.names(_SINGLE))
_CLEAR, _CLEAR_LOW, _ON, _VISIBLE = 11, 12, 13, 14  # rows of the counts
_SHARE_OF = [_CLEAR, _CLEAR_LOW, _ON, _ON, _ON, _ON, _ON, _VISIBLE, _ON, _ON, _ON]


@dataclass(frozen=True, slots=True)
class Profiles:
    """Measured hypotheses: features and refined geometry, one a row.

    Attributes:
        features: `(n, len(NAMES))`.
        left_px, right_px: flanks at the stem's centre row, sharpened on the image gradient.
        foot_column_px, foot_row_px: where the axis meets the ground.
        disparity_px: of the stem's surface.
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


def measure(
    stems: Stems,
    maps: UprightMaps,
    image: NDArray[np.uint8] | NDArray[np.uint16],
    ground: Ground,
    rig: StereoRig,
) -> Profiles:
    """Features and refined geometry of every hypothesis."""
    n = len(stems)
    per_m = stems.disparity_px / rig.baseline_m  # pixels a metre at the stem
    left_px, right_px, flank_sd, edge_left, edge_right, smooth = sharpen(stems, image)
    width_px = np.maximum(right_px - left_px, 0.5)
    shift = 0.5 * (left_px + right_px) - stems.column_px
    ground_row = ground.row_px(stems.column_px, stems.disparity_px)

    # the heights of the stem, and some right above its top
    rows = np.concatenate(
        [
            ground_row[:, None] - HEIGHTS_M * per_m[:, None],
            stems.top_px[:, None] - _ABOVE_M * per_m[:, None],
        ],
        axis=1,
    )
    centre = (stems.column_px + shift)[:, None] + stems.slope[:, None] * (
        rows - stems.row_px[:, None]
    )
    tolerance = 0.8 + 0.3 * stems.disparity_px**2 / (rig.focal_px * rig.baseline_m)
    free_px = np.maximum(_FAR_M * stems.disparity_px**2 / (rig.focal_px * rig.baseline_m), 0.8)
    d = stems.disparity_px[:, None, None]
    out = (width_px[:, None] / 2 + _CLEAR_PX + BESIDE_M * per_m[:, None])[:, None, :]
    middle = centre[:, :, None]
    inside_at = middle + INSIDE * width_px[:, None, None]
    at = np.concatenate([inside_at, middle + out, middle - d - out], axis=2)
    samples = _sample(maps, rows / maps.row_step_px, at)
    above = samples[:, len(HEIGHTS_M) :, 1]  # on the centre line
    seen_above = np.maximum((rows[:, len(HEIGHTS_M) :] >= 0).sum(axis=1), 1)
    rows, samples = rows[:, : len(HEIGHTS_M)], samples[:, : len(HEIGHTS_M)]
    inside, right, left = np.split(samples, _PARTS, axis=2)
    tol, free = tolerance[:, None, None], free_px[:, None, None]
    height, width = maps.height_px, maps.left.shape[1]
    visible = (rows >= 0) & (rows <= height - 1)
    with np.errstate(invalid="ignore"):
        match = np.abs(inside - d) <= tol
        on = (match.sum(axis=2) >= 2) & visible
        hidden = ((inside > d + tol).sum(axis=2) >= 2) & visible
        free_left, free_right = left < d - free, right < d - free
        near_beside = ((left > d + tol) | (right > d + tol)).any(axis=2)
        one, two = left[..., :3], right[..., :3]
        same_beside = ((np.abs(one - d) <= tol) | (np.abs(two - d) <= tol)).any(axis=2)
        blank_beside = np.isnan(one).all(axis=2) | np.isnan(two).all(axis=2)
        above_free = (above < (d - free)[..., 0]).sum(axis=1) / seen_above
        above_same = (np.abs(above - d[..., 0]) <= tol[..., 0]).sum(axis=1) / seen_above
    both = on & free_left[..., :3].any(axis=2) & free_right[..., :3].any(axis=2)
    clear, low = visible & ~hidden, HEIGHTS_M <= 1.0
    # heights that have something, then those of which they are a share
    lines = [on & clear, on & clear & low, both]
    lines += [on & f[..., k] for k in (0, 3) for f in (free_left, free_right)]
    lines += [hidden, on & near_beside, on & same_beside, on & blank_beside]
    lines += [clear, clear & low, on, visible]
    counts = np.concatenate(lines).reshape(len(lines), n, len(HEIGHTS_M)).sum(axis=2)
    shares = counts[:11] / np.maximum(counts[_SHARE_OF], 1)

    samples = np.where(match & on[..., None], inside, np.nan)
    samples = samples.reshape(n, len(HEIGHTS_M) * len(INSIDE))
    refined, scatter, count = _robust(samples, stems.disparity_px)
    base_m = (ground_row - stems.bottom_px) / per_m
    top_m = (ground_row - stems.top_px) / per_m
    extent_m = np.maximum(top_m - base_m, 0.05)
    width_m = width_px / per_m
    range_m = rig.focal_px * rig.baseline_m / stems.disparity_px
    slices_full = np.maximum((stems.bottom_px - stems.top_px) / maps.row_step_px + 1.0, 1.0)
    lateral = (stems.column_px - rig.cx_px) / rig.focal_px * range_m
    close = (np.abs(lateral[:, None] - lateral) < 1.5) & (np.abs(range_m[:, None] - range_m) < 2.0)
    border = (left_px < 3.0 + stems.disparity_px) | (right_px > width - 4.0)
    far = np.maximum(np.stack([stems.far_left_px, stems.far_right_px]), 1.0)
    behind_m = rig.focal_px * rig.baseline_m / far - range_m
    columns = (
        np.log(0.1 + 0.15 * counts[2]),
        np.log(0.1 + 0.15 * _longest_run(both)),
        *shares[:9],
        np.clip(base_m, -0.5, 3.0),
        np.clip(top_m, 0.0, 4.0),
        width_m,
        width_m**2,
        np.log(extent_m / np.maximum(width_m, 0.03)),
        np.abs(stems.slope),
        stems.centre_sd_px / (0.5 + 0.2 * width_px),
        stems.width_sd_px / (0.5 + 0.2 * width_px),
        np.minimum(scatter / tolerance, 2.0),
        np.minimum(stems.slices / slices_full, 1.0),
        stems.occluding_left,
        stems.occluding_right,
        *np.log1p(np.minimum(np.maximum(behind_m, 0.05), 30.0)),
        edge_left,
        edge_right,
        smooth,
        range_m / 10.0,
        np.log(width_px),
        np.log(close.sum(axis=1)),
        border.astype(np.float64),
        *shares[9:],
        above_free,
        above_same,
    )
    products = feature_products.products(dict(zip(_SINGLE, columns, strict=True)))
    foot_row = ground.row_px(stems.column_px, refined)
    foot_column = stems.column_px + shift + stems.slope * (foot_row - stems.row_px)
    return Profiles(
        features=np.concatenate([*columns, *products.values()]).reshape(len(NAMES), n).T.copy(),
        left_px=left_px,
        right_px=right_px,
        foot_column_px=foot_column,
        foot_row_px=foot_row,
        disparity_px=refined,
        disparity_sd_px=scatter / np.sqrt(np.maximum(count / 3.0, 1.0)),
        flank_sd_px=flank_sd,
        top_m=top_m,
        border=border,
    )


def _sample(maps: UprightMaps, rows: Floats, columns: Floats) -> Floats:
    """Nearest disparity at `rows` `(n, h)` and `columns` `(n, h, k)`; NaN where there is none.

    The columns left of the stem are those of the right map, the others of the left one.
    """
    height, width = maps.left.shape
    v = np.rint(rows).astype(np.int64)[:, :, None]
    u = np.rint(columns).astype(np.int64)
    within = (v >= 0) & (v < height) & (u >= 0) & (u < width)
    at = np.where(within, v * width + u, 0)
    left = maps.left.ravel().take(at[:, :, : _PARTS[1]])
    right = maps.right.ravel().take(at[:, :, _PARTS[1] :])
    value = np.concatenate([left, right], axis=2)
    return np.where(within & (value > 0), value, np.nan).astype(np.float64)


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
