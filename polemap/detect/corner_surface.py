"""What stands on both sides of an upright edge: the wall that ends there, and what lies beside it.

Disparities are sampled on a grid of rows along the edge and of metric offsets on the wall's side
(inward) and on the free side (outward). A vertical plane is affine in the image: d = a + k u + m v,
with m of a wall near zero; it is fitted to the inward samples, so that the wall's disparity at the
edge comes from all of the wall and not from the pixels at the edge, where matchers lean towards the
background.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polemap.detect.corner_edges import UprightEdges
from polemap.detect.ground import Ground
from polemap.extras import kernel
from polemap.stereo.depth_edges import UprightMaps
from polemap.stereo.rig import StereoRig

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]

INWARD_M = np.array([0.08, 0.2, 0.35, 0.5, 0.7, 0.95, 1.25, 1.6])
OUTWARD_M = np.array([0.1, 0.25, 0.5, 0.9])
ROWS = 14
CLEAR_PX = 2.5  # matchers blur an edge by about so much
_HIGHEST_M = 3.6  # above the ground: roofs stand over walls
_ABOVE_M = np.array([0.2, 0.4])  # rows over the top
_NEAR = slice(1, 5)
_SWEEPS = 2
_SLOPE_PRIOR = 0.02  # samples' worth of a pull towards an upright wall, of their spread
_FREE_M = 0.5  # depth difference that counts as free
_SHARED = 6.0
_SETTINGS: dict[str, Any] = {
    "rows": ROWS, "clear_px": CLEAR_PX, "highest_m": _HIGHEST_M, "free_m": _FREE_M,
    "slope_prior": _SLOPE_PRIOR, "shared": _SHARED, "inward_m": INWARD_M.tolist(),
    "outward_m": OUTWARD_M.tolist(), "above_m": _ABOVE_M.tolist(),
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class Walls:
    """The wall at each edge, and what its surroundings showed.

    Attributes:
        disparity_px: `(n,)` of the wall at the edge.
        along: `(n,)` change of disparity a column, image rightwards.
        down: `(n,)` change of disparity a row: zero of an upright wall.
        rms_px: `(n,)` of the samples on the wall about it.
        disparity_sd_px: `(n,)` of `disparity_px`, from their scatter.
        on: `(n, h, i)` inward samples that lie on the wall.
        nearer: `(n, h, i)` that lie before it.
        seen: `(n, h, i)` that were measured.
        inside: `(n, h)` rows within the image.
        free, beside: `(n, h, o)` outward samples that lie farther than the wall, and no farther.
        blank: `(n, h, o)` outward samples without disparity.
        over_on: `(n,)` share of the samples over the top that show the wall.
    """

    disparity_px: Floats
    along: Floats
    down: Floats
    rms_px: Floats
    disparity_sd_px: Floats
    on: Flags
    nearer: Flags
    seen: Flags
    inside: Flags
    free: Flags
    beside: Flags
    blank: Flags
    over_on: Floats


def sample_walls(
    edges: UprightEdges, column_px: Floats, maps: UprightMaps, ground: Ground, rig: StereoRig
) -> Walls:
    """Fit the wall at every edge, and tell what each sample about it shows.

    The C++ kernel does the work where it was built.

    Args:
        column_px: `(n,)` of the edge in its row `row_px`, sharpened.
    """
    native = kernel("polemap.detect.native.corners_kernel")
    if native is None:
        return plain_walls(edges, column_px, maps, ground, rig)
    d = edges.disparity_px
    table = np.stack([
        column_px, edges.row_px, edges.slope, edges.top_px, edges.bottom_px, d, edges.free,
        d / rig.baseline_m, ground.row_px(column_px, d),
    ], axis=1)  # fmt: skip
    settings = _SETTINGS | {
        "row_step_px": maps.row_step_px, "height_px": maps.height_px,
        "focal_baseline": rig.focal_px * rig.baseline_m,
    }  # fmt: skip
    values, on, nearer, seen, inside, free, beside, blank = native.walls(
        table, maps.left, maps.right, settings
    )
    a, k, m, rms, sd, over = values
    return Walls(a, k, m, rms, sd, on, nearer, seen, inside, free, beside, blank, over)


def plain_walls(
    edges: UprightEdges, column_px: Floats, maps: UprightMaps, ground: Ground, rig: StereoRig
) -> Walls:
    """`sample_walls` in plain numpy, the tests' oracle."""
    d = edges.disparity_px
    per_m = d / rig.baseline_m
    rows, inward, values = _sampled(edges, column_px, per_m, maps, ground)
    offset = inward[:, None, :] * -edges.free[:, None, None]  # columns from the edge
    fit_rows = rows[:, :ROWS, None]
    own, outward = values[:, :ROWS, : len(INWARD_M)], values[:, :ROWS, len(INWARD_M) :]
    tolerance = 0.7 + 0.03 * d
    down_px = fit_rows - 0.5 * (edges.top_px + edges.bottom_px)[:, None, None]
    plane, on, normal = _planes(own, offset, down_px, d, tolerance)
    a, k, m = plane.T
    expected = a[:, None, None] + k[:, None, None] * offset + m[:, None, None] * down_px
    seen = own > 0
    residual = own - expected
    count = np.maximum(on.sum(axis=(1, 2)), 1)
    rms = np.sqrt((np.where(on, residual, 0.0) ** 2).sum(axis=(1, 2)) / count)
    # rows and columns that lie close share their errors: so many samples count as one
    spread = np.sqrt(np.maximum(np.linalg.inv(normal)[:, 0, 0], 0.0) * _SHARED) * (rms + 0.1)
    edge = (a[:, None] + m[:, None] * down_px[:, :, 0])[:, :, None]
    step = np.maximum(_FREE_M * edge**2 / (rig.focal_px * rig.baseline_m), 0.8)
    measured = outward > 0
    over = values[:, ROWS:, : len(INWARD_M)]
    over_px = (
        a[:, None, None]
        + k[:, None, None] * offset
        + (
            m[:, None, None]
            * (rows[:, ROWS:, None] - 0.5 * (edges.top_px + edges.bottom_px)[:, None, None])
        )
    )
    return Walls(
        disparity_px=a,
        along=k,
        down=m,
        rms_px=rms,
        disparity_sd_px=spread,
        on=on,
        nearer=seen & (residual > tolerance[:, None, None]),
        seen=seen,
        inside=(rows[:, :ROWS] >= 0) & (rows[:, :ROWS] < maps.height_px),
        free=measured & (outward < edge - step),
        beside=measured & (outward >= edge - step),
        blank=~measured,
        over_on=((np.abs(over - over_px) <= tolerance[:, None, None]) & (over > 0)).mean(
            axis=(1, 2)
        ),
    )


def _sampled(
    edges: UprightEdges, column_px: Floats, per_m: Floats, maps: UprightMaps, ground: Ground
) -> tuple[Floats, Floats, Floats]:
    """Image rows `(n, h)`, inward offsets `(n, i)` in columns, and disparities `(n, h, i + o)`."""
    foot = ground.row_px(column_px, edges.disparity_px)
    top = np.maximum(edges.top_px, foot - _HIGHEST_M * per_m)
    bottom = np.maximum(np.minimum(edges.bottom_px, foot - 0.15 * per_m), top)
    share = (np.arange(ROWS) + 0.5) / ROWS
    rows = np.concatenate(
        [
            top[:, None] + (bottom - top)[:, None] * share,
            edges.top_px[:, None] - _ABOVE_M * per_m[:, None],
        ],
        axis=1,
    )
    line = column_px[:, None] + edges.slope[:, None] * (rows - edges.row_px[:, None])
    free = edges.free[:, None, None]
    inward = CLEAR_PX + INWARD_M * per_m[:, None]
    outward = CLEAR_PX + OUTWARD_M * per_m[:, None]
    inside = line[:, :, None] - free * inward[:, None, :]
    beyond = line[:, :, None] + free * outward[:, None, :]
    # beside a left flank the right map sees the background up to the edge
    beyond -= np.where(free < 0, edges.disparity_px[:, None, None], 0.0)
    height, width = maps.left.shape
    u = np.rint(np.concatenate([inside, beyond], axis=2)).astype(np.int64)
    v = np.rint(rows / maps.row_step_px).astype(np.int64)[:, :, None]
    within = (u >= 0) & (u < width) & (v >= 0) & (v < height)
    at = np.where(within, v * width + u, 0)
    values = maps.left.ravel().take(at)
    outer = at[:, :, len(INWARD_M) :]
    other = maps.right.ravel().take(outer)
    values[:, :, len(INWARD_M) :] = np.where(free < 0, other, values[:, :, len(INWARD_M) :])
    return rows, inward, np.where(within, values, 0.0).astype(np.float64)


def _planes(
    own: Floats, offset: Floats, down: Floats, d: Floats, tolerance: Floats
) -> tuple[Floats, Flags, Floats]:
    """Planes `(n, 3)` through the samples, which of these lie on them, and the normal matrix."""
    # a wall may end soon, so its first slope is that of the near offsets
    near = own[:, :, _NEAR]
    ordered = np.sort(np.where(near > 0, near, np.inf), axis=1)
    count = (near > 0).sum(axis=1)
    row = np.arange(len(own))[:, None]
    middle = ordered[row, np.maximum(count - 1, 0) // 2, np.arange(near.shape[2])]
    slopes = (middle - d[:, None]) / offset[:, 0, _NEAR]
    usable = (count >= 3) & np.isfinite(middle)
    slopes = np.where(usable, slopes, np.inf)
    good = usable.sum(axis=1)
    slope = np.sort(slopes, axis=1)[np.arange(len(own)), np.maximum(good - 1, 0) // 2]
    plane = np.stack([d, np.where(good > 0, slope, 0.0), np.zeros(len(d))], axis=1)
    design = np.stack(np.broadcast_arrays(np.ones_like(own), offset, down), axis=1)
    n = len(own)
    samples = own.shape[1] * own.shape[2]
    design = design.reshape(n, 3, samples)
    flat = own.reshape(n, samples)
    for sweep in range(_SWEEPS + 1):
        residual = flat - (plane[:, None] @ design)[:, 0]
        wide = 1.6 if sweep == 0 else 1.0
        on = (np.abs(residual) <= wide * tolerance[:, None]) & (flat > 0)
        weighted = design * on[:, None]
        normal = weighted @ np.swapaxes(design, 1, 2)
        trace = normal[:, 0, 0] + 1.0
        # few samples say nothing of a slope: the wall is upright, and the edge's disparity holds
        normal = normal + np.zeros((n, 3, 3))
        normal[:, 0, 0] += 0.5
        normal[:, 1, 1] += 1e-3 * trace
        normal[:, 2, 2] += _SLOPE_PRIOR * trace * 100.0
        if sweep == _SWEEPS:
            break
        right = (weighted @ flat[:, :, None])[:, :, 0]
        right[:, 0] += 0.5 * d
        plane = np.linalg.solve(normal, right[:, :, None])[:, :, 0]
    return plane, on.reshape(own.shape), normal
