"""Upright depth edges with one flank: where a wall ends and something farther goes on.

Depth edges of one side are counted in cells of column and disparity: an upright edge keeps both
over all of its rows, so its rows fall into one cell. Peaks of the counts gather the edges about
them, and a line is laid through these.

The counting is Hough's voting, here in (column, logarithm of the disparity).
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from polemap.detect.config import DetectionConfig
from polemap.detect.constants import BASE_MAX_M
from polemap.detect.corner_constants import (
    EDGE_FILL_MIN,
    EDGE_HEIGHT_MIN_M,
    EDGE_LEAN_MAX,
    EDGE_ROWS_MIN,
    EDGES_MAX,
)
from polemap.detect.ground import Ground
from polemap.drivelog.columns import Columns
from polemap.extras import kernel
from polemap.stereo.depth_edges import DepthEdges
from polemap.stereo.rig import StereoRig

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

_COLUMN_PX = 2.5  # of a cell
_SHARE = 0.045  # of a cell: of the disparity
_AROUND = np.array([(i, j) for i in (-1, 0, 1) for j in (-1, 0, 1)])
_BOX = (3, 3)
_PEAK = np.ones((3, 7), dtype=np.uint8)  # no second peak within so many cells
_SWEEPS = 2
_UPRIGHT_PX2 = 400.0  # as if the rows spread by so much more


@dataclass(frozen=True, slots=True)
class UprightEdges(Columns):
    """Upright edges of near surfaces, `(n,)` each.

    The edge is `column_px + slope * (row - row_px)` in the left view.

    Attributes:
        free: 1 where the free side lies right of the edge in the image, -1 left of it.
        column_px, row_px, slope: the line.
        column_sd_px: scatter of the rows' edges about it.
        top_px, bottom_px: first and last row.
        disparity_px: of the near surface at the edge, mean over the rows.
        far_px: mean disparity beside it.
        fill: share of the searched rows between top and bottom that show the edge.
        occluding: share of its depth edges with a half-occluded band beside them.
    """

    free: Floats
    column_px: Floats
    row_px: Floats
    slope: Floats
    column_sd_px: Floats
    top_px: Floats
    bottom_px: Floats
    disparity_px: Floats
    far_px: Floats
    fill: Floats
    occluding: Floats


def find_upright_edges(
    edges: tuple[DepthEdges, DepthEdges], ground: Ground, rig: StereoRig, config: DetectionConfig
) -> UprightEdges:
    """The upright ones among left and right flanks: tall, straight, and near the ground."""
    found = _grouped(edges, rig, config)
    per_px = rig.baseline_m / found.disparity_px
    height_m = (found.bottom_px - found.top_px) * per_px
    foot = ground.row_px(found.column_px, found.disparity_px)
    good = (height_m >= EDGE_HEIGHT_MIN_M) & (found.fill >= EDGE_FILL_MIN)
    good &= (foot - found.bottom_px) * per_px <= BASE_MAX_M
    good &= np.abs(found.slope) <= EDGE_LEAN_MAX
    found = found.take(good)
    if len(found) > EDGES_MAX:
        tallest = np.argsort(-(height_m[good] * found.fill))[:EDGES_MAX]
        found = found.take(np.sort(tallest))
    return found


def _grouped(
    sides: tuple[DepthEdges, DepthEdges], rig: StereoRig, config: DetectionConfig
) -> UprightEdges:
    """Lines through the depth edges that gather in a column and a disparity.

    The C++ kernel does the work where it was built.
    """
    cells = _Cells.of(rig, config)
    native = kernel("polemap.detect.native.corners_kernel")
    if native is None:
        return plain_lines(sides, cells)
    columns = [
        (side.row_px, side.column_px, side.near_px, side.far_px, side.occluding) for side in sides
    ]
    free, found = native.upright_lines(*columns, cells.settings())
    row, column, near, far, occluding, slope, sd, top, bottom, fill = found
    return UprightEdges(
        free=free, column_px=column, row_px=row, slope=slope, column_sd_px=sd, top_px=top,
        bottom_px=bottom, disparity_px=np.maximum(near, 0.5), far_px=far, fill=fill,
        occluding=occluding,
    )  # fmt: skip


@dataclass(frozen=True, slots=True)
class _Cells:
    """The grid of votes: disparities from `low` to `high` px, and how tall an edge is there."""

    low: float
    high: float
    depth_cells: int
    column_cells: int
    baseline_m: float
    row_step_px: int

    @classmethod
    def of(cls, rig: StereoRig, config: DetectionConfig) -> _Cells:
        focal_baseline = rig.focal_px * rig.baseline_m
        low = 0.9 * focal_baseline / config.range_max_m
        high = 1.2 * focal_baseline / config.range_min_m
        return cls(
            low, high, int(np.log(high / low) / _SHARE) + 4, int(rig.width_px / _COLUMN_PX) + 4,
            rig.baseline_m, config.row_step_px,
        )  # fmt: skip

    def settings(self) -> dict[str, float]:
        """All that the kernel has to know."""
        return {
            "low": self.low, "high": self.high, "column_px": _COLUMN_PX, "share": _SHARE,
            "height_min_m": EDGE_HEIGHT_MIN_M, "fill_min": EDGE_FILL_MIN,
            "baseline_m": self.baseline_m, "column_cells": self.column_cells,
            "depth_cells": self.depth_cells, "rows_min": EDGE_ROWS_MIN,
            "row_step_px": self.row_step_px, "upright_px2": _UPRIGHT_PX2,
        }  # fmt: skip


def plain_lines(sides: tuple[DepthEdges, DepthEdges], cells: _Cells) -> UprightEdges:
    """What the kernel does, in plain numpy: the tests' oracle."""
    low, depth_cells, column_cells = cells.low, cells.depth_cells, cells.column_cells
    near = np.concatenate([side.near_px for side in sides])
    inside = np.flatnonzero((near >= low) & (near <= cells.high))
    column = np.concatenate([side.column_px for side in sides])
    depth = (np.log(near.take(inside).astype(np.float64) / low) / _SHARE).astype(np.int64) + 1
    # the right flanks' cells lie below those of the left flanks
    depth += depth_cells * (inside >= len(sides[0]))
    across = (column.take(inside) * np.float32(1.0 / _COLUMN_PX)).astype(np.int64) + 1
    place = np.minimum(np.maximum(across, 1), column_cells - 2) + column_cells * depth
    counts = np.bincount(place, minlength=2 * depth_cells * column_cells)
    grid = counts.astype(np.float32).reshape(2 * depth_cells, column_cells)
    # as many rows as the least height has at a disparity, and no fewer than a line needs
    disparity = low * np.exp((np.arange(depth_cells) - 0.5) * _SHARE)
    rows = EDGE_HEIGHT_MIN_M * disparity / (cells.baseline_m * cells.row_step_px)
    peaks = _peaks(grid, np.tile(np.maximum(EDGE_FILL_MIN * rows, EDGE_ROWS_MIN), 2))
    label = np.full(grid.size, -1, dtype=np.int64)
    number = np.arange(len(peaks))
    # from the weakest on: a cell that two peaks claim goes to the stronger one
    label[(peaks[:, None] + _AROUND @ (column_cells, 1)).ravel()] = np.repeat(number, len(_AROUND))
    label[peaks] = number
    group = label.take(place)
    mine = np.flatnonzero(group >= 0)
    at = inside.take(mine)
    table = np.empty((5, len(at)))
    table[1], table[2] = column.take(at), near.take(at)
    for line, name in ((0, "row_px"), (3, "far_px"), (4, "occluding")):
        table[line] = np.concatenate([getattr(side, name) for side in sides]).take(at)
    free = np.where(peaks >= depth_cells * column_cells, 1.0, -1.0)
    return _lines(table, group.take(mine), free, cells.row_step_px)


def _peaks(grid: NDArray[np.float32], least: Floats) -> Ints:
    """Places in the flat grid about which many edges lie, the weakest first.

    Args:
        least: `(len(grid),)` of a row of cells: so many edges at the least.
    """
    summed = cv2.boxFilter(grid, -1, _BOX, normalize=False, borderType=cv2.BORDER_CONSTANT)
    summed[[0, -1]] = 0.0
    summed[:, [0, -1]] = 0.0
    places = np.flatnonzero(summed >= least.astype(np.float32)[:, None])
    high = cv2.dilate(summed, _PEAK).ravel().take(places)
    votes = summed.ravel().take(places)
    top = votes >= high
    places, votes = places[top], votes[top]
    return np.asarray(places[np.argsort(votes, kind="stable")], dtype=np.int64)


def _lines(table: Floats, group: Ints, free: Floats, row_step_px: int) -> UprightEdges:
    """A line through each group of depth edges; what lies aside of it is left out.

    Args:
        table: `(5, n)` row, column, near and far disparity, occluding.
        group: `(n,)`.
        free: `(count,)` of the groups.
    """
    count = len(free)
    row, column = table[:2]
    weight = np.ones(len(group))
    place = (group + count * np.arange(len(table))[:, None]).ravel()

    def totals(values: Floats) -> Floats:
        """Weighted sums of `(k, n)` over every group, `(k, count)`."""
        k = len(values)
        sums = np.bincount(
            place[: k * len(group)], weights=(values * weight).ravel(), minlength=k * count
        )
        return sums.astype(np.float64, copy=False).reshape(k, count)

    for sweep in range(_SWEEPS):
        n = np.maximum(totals(np.ones((1, len(group))))[0], 1.0)
        means = totals(table) / n
        dv = row - means[0].take(group)
        spread, moment = totals(np.stack([dv * dv, dv * column]))
        # a short edge says little about its lean: the upright prior shrinks the slope
        slope = moment / (spread + _UPRIGHT_PX2)
        off = column - means[1].take(group) - slope.take(group) * dv
        sd = np.sqrt(totals((off * off)[None])[0] / n)
        if sweep + 1 < _SWEEPS:
            weight = (np.abs(off) <= 2.0 * sd.take(group) + 0.6).astype(np.float64)
    kept = np.flatnonzero(weight)
    looked = int(row.max(initial=0.0)) // row_step_px + 2
    shown = np.zeros((count, looked), dtype=bool)
    shown[group[kept], (row[kept] / row_step_px).astype(np.int64)] = True
    top = shown.argmax(axis=1)
    bottom = looked - 1 - shown[:, ::-1].argmax(axis=1)
    return UprightEdges(
        free=free,
        column_px=means[1],
        row_px=means[0],
        slope=slope,
        column_sd_px=sd,
        top_px=(top * row_step_px).astype(np.float64),
        bottom_px=(bottom * row_step_px).astype(np.float64),
        disparity_px=np.maximum(means[2], 0.5),
        far_px=means[3],
        fill=np.count_nonzero(shown, axis=1) / (bottom - top + 1.0),
        occluding=means[4],
    )
