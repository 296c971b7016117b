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
from polemap.ground import Ground
from polemap.hypotheses import Stems
from stereo.depth_edges import UprightMaps
from stereo.rig import StereoRig

Floats = NDArray[np.float64]

HEIGHTS_M = np.arange(0.2, 3.3, 0.15)
INSIDE = np.array([-0.25, 0.0, 0.25])  # of the width
BESIDE_M = np.array([0.12, 0.25, 0.45, 0.75])  # beyond the flank
_ABOVE_M = np.array([0.15, 0.3, 0.45, 0.6])  # beyond the top
_CLEAR_PX = 2.5  # matchers blur a flank by about so much
_FAR_M = 0.5  # depth difference that counts as free
_ROWS = 24  # image rows along the stem for the gradient profile
_REACH_PX = 5

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
NAMES = (*_SINGLE, *feature_products.NAMES)


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
    left_px, right_px, flank_sd, edge_left, edge_right, smooth = _sharpen(stems, image)
    width_px = np.maximum(right_px - left_px, 0.5)
    shift = 0.5 * (left_px + right_px) - stems.column_px
    ground_row = ground.row_px(stems.column_px, stems.disparity_px)

    rows = ground_row[:, None] - HEIGHTS_M * per_m[:, None]
    centre = (stems.column_px + shift)[:, None] + stems.slope[:, None] * (
        rows - stems.row_px[:, None]
    )
    at_rows = rows / maps.row_step_px
    tolerance = 0.8 + 0.3 * stems.disparity_px**2 / (rig.focal_px * rig.baseline_m)
    free_px = np.maximum(_FAR_M * stems.disparity_px**2 / (rig.focal_px * rig.baseline_m), 0.8)
    inside_at = centre[:, :, None] + INSIDE * width_px[:, None, None]
    inside = _sample(maps.left, at_rows, inside_at)
    out = width_px[:, None] / 2 + _CLEAR_PX + BESIDE_M * per_m[:, None]
    right = _sample(maps.left, at_rows, centre[:, :, None] + out[:, None, :])
    left = _sample(
        maps.right,
        at_rows,
        centre[:, :, None] - stems.disparity_px[:, None, None] - out[:, None, :],
    )
    d = stems.disparity_px[:, None, None]
    tol, free = tolerance[:, None, None], free_px[:, None, None]
    height, width = maps.height_px, maps.left.shape[1]
    visible = (rows >= 0) & (rows <= height - 1)
    with np.errstate(invalid="ignore"):
        match = np.abs(inside - d) <= tol
        on = (match.sum(axis=2) >= 2) & visible
        hidden = ((inside > d + tol).sum(axis=2) >= 2) & visible
        free_left, free_right = left < d - free, right < d - free
        near_beside = (left > d + tol).any(axis=2) | (right > d + tol).any(axis=2)
        same_beside = (np.abs(left[..., :3] - d) <= tol).any(axis=2) | (
            np.abs(right[..., :3] - d) <= tol
        ).any(axis=2)
        blank_beside = np.isnan(left[..., :3]).all(axis=2) | np.isnan(right[..., :3]).all(axis=2)
        top_rows = stems.top_px[:, None] - _ABOVE_M * per_m[:, None]
        top_centre = (stems.column_px + shift)[:, None] + stems.slope[:, None] * (
            top_rows - stems.row_px[:, None]
        )
        above = _sample(maps.left, top_rows / maps.row_step_px, top_centre[:, :, None])[..., 0]
        seen_above = np.maximum((top_rows >= 0).sum(axis=1), 1)
        above_free = (above < (d - free)[..., 0]).sum(axis=1) / seen_above
        above_same = (np.abs(above - d[..., 0]) <= tol[..., 0]).sum(axis=1) / seen_above
    open_ = visible & ~hidden
    both = on & free_left[..., :3].any(axis=2) & free_right[..., :3].any(axis=2)
    low = HEIGHTS_M <= 1.0

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
    far = [np.maximum(f, 1.0) for f in (stems.far_left_px, stems.far_right_px)]
    steps = [np.log1p(np.clip(rig.focal_px * rig.baseline_m / f - range_m, 0.05, 30)) for f in far]
    columns = (
        np.log(0.1 + 0.15 * both.sum(axis=1)),
        np.log(0.1 + 0.15 * _longest_run(both)),
        _share(on, open_),
        _share(on & low, open_ & low),
        _share(both, on),
        _share(on & free_left[..., 0], on),
        _share(on & free_right[..., 0], on),
        _share(on & free_left[..., 3], on),
        _share(on & free_right[..., 3], on),
        _share(hidden, visible),
        _share(near_beside & on, on),
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
        *steps,
        edge_left,
        edge_right,
        smooth,
        range_m / 10.0,
        np.log(width_px),
        np.log(close.sum(axis=1)) if n else np.empty(0),
        border.astype(np.float64),
        _share(on & same_beside, on),
        _share(on & blank_beside, on),
        above_free,
        above_same,
    )
    single = dict(zip(_SINGLE, columns, strict=True))
    products = feature_products.products(single)
    foot_row = ground.row_px(stems.column_px, refined)
    foot_column = stems.column_px + shift + stems.slope * (foot_row - stems.row_px)
    return Profiles(
        features=np.stack([*single.values(), *products.values()], axis=1),
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


def _sample(disparity: NDArray[np.float32], rows: Floats, columns: Floats) -> Floats:
    """Nearest disparity at `rows` `(n, h)` and `columns` `(n, h, k)`; NaN where there is none."""
    height, width = disparity.shape
    v = np.rint(rows).astype(np.int64)[:, :, None]
    u = np.rint(columns).astype(np.int64)
    inside = (v >= 0) & (v < height) & (u >= 0) & (u < width)
    value = disparity[np.clip(v, 0, height - 1), np.clip(u, 0, width - 1)]
    return np.where(inside & (value > 0), value, np.nan).astype(np.float64)


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


def _share(part: NDArray[np.bool_], whole: NDArray[np.bool_]) -> Floats:
    total = whole.sum(axis=1)
    return np.asarray((part & whole).sum(axis=1) / np.maximum(total, 1))


def _longest_run(flags: NDArray[np.bool_]) -> Floats:
    """Longest run of true along each row."""
    run = np.zeros(len(flags))
    best = np.zeros(len(flags))
    for column in flags.T:
        run = np.where(column, run + 1.0, 0.0)
        best = np.maximum(best, run)
    return best


def _sharpen(
    stems: Stems, image: NDArray[np.uint8] | NDArray[np.uint16]
) -> tuple[Floats, Floats, Floats, Floats, Floats, Floats]:
    """Flanks on the strongest mean image gradient along them, to a fraction of a pixel.

    Returns left and right column at the centre row, their standard deviation, the normalised
    gradients and the smoothness of the texture along the stem.
    """
    n = len(stems)
    height, width = image.shape
    share = (np.arange(_ROWS) + 0.5) / _ROWS
    rows = stems.top_px[:, None] + (stems.bottom_px - stems.top_px)[:, None] * share
    centre = stems.column_px[:, None] + stems.slope[:, None] * (rows - stems.row_px[:, None])
    v = np.clip(np.rint(rows).astype(np.int64), 0, height - 1)
    offsets = np.arange(-_REACH_PX - 1, _REACH_PX + 2)
    contrast = float(image[::8, ::8].std()) + 1e-6
    edges, peaks = [], []
    for side in (-0.5, 0.5):
        # integer columns along the flank, the fraction is put back at the end
        flank = centre + side * stems.width_px[:, None]
        base = np.rint(flank)
        u = np.clip(base.astype(np.int64)[:, :, None] + offsets, 0, width - 1)
        grey = image[v[:, :, None], u].astype(np.float64)
        gradient = 0.5 * (grey[:, :, 2:] - grey[:, :, :-2]) / contrast
        mean = np.abs(gradient.mean(axis=1)) + 0.35 * np.abs(gradient).mean(axis=1)
        mean = mean * np.exp(-0.5 * (np.arange(-_REACH_PX, _REACH_PX + 1) / 2.5) ** 2)
        at = np.clip(mean.argmax(axis=1), 1, 2 * _REACH_PX - 1) if n else np.empty(0, np.int64)
        row = np.arange(n)
        before, peak, after = mean[row, at - 1], mean[row, at], mean[row, at + 1]
        bend = before - 2.0 * peak + after
        fraction = np.where(bend < -1e-9, 0.5 * (before - after) / np.minimum(bend, -1e-9), 0.0)
        moved = at - _REACH_PX + np.clip(fraction, -0.5, 0.5) + (base - flank).mean(axis=1)
        strength = peak / (np.median(mean, axis=1) + 0.02) if n else np.empty(0)
        trusted = (strength >= 1.8) & (peak >= 0.05)
        edges.append((side, np.where(trusted, moved, 0.0), trusted))
        peaks.append(np.minimum(peak, 1.5))
    columns = [stems.column_px + side * stems.width_px + moved for side, moved, _ in edges]
    crossed = columns[1] - columns[0] < 0.5
    columns = [
        np.where(crossed, stems.column_px + side * stems.width_px, column)
        for (side, _, _), column in zip(edges, columns, strict=True)
    ]
    blurred = np.stack([~(trusted & ~crossed) for _, _, trusted in edges])
    flank_sd = np.sqrt(np.where(blurred, 1.5**2, 0.4**2).mean(axis=0))
    smooth = _smoothness(stems, image, centre, v, contrast)
    return columns[0], columns[1], flank_sd, peaks[0], peaks[1], smooth


def _smoothness(
    stems: Stems,
    image: NDArray[np.uint8] | NDArray[np.uint16],
    centre: Floats,
    v: NDArray[np.int64],
    contrast: float,
) -> Floats:
    """Mean step of the grey value from row to row inside the stem, against the contrast."""
    width = image.shape[1]
    u = np.rint(centre[:, :, None] + INSIDE * stems.width_px[:, None, None]).astype(np.int64)
    grey = image[v[:, :, None], np.clip(u, 0, width - 1)].astype(np.float64)
    return np.asarray(np.minimum(np.abs(np.diff(grey, axis=1)).mean(axis=(1, 2)) / contrast, 2.0))
