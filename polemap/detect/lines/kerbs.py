"""Kerbs of one frame: the height step of the ground, found row by row of the road grid.

A kerb that faces the camera rises away from it by 0.05 to 0.25 m, with flat ground on both sides: a
wall, a hedge or a car goes on rising, an embankment rises slowly, a shadow does not rise.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from polemap.detect.lines.road_frame import (
    ASIDE_M,
    LEAST_MATCHED,
    STEP_ASIDE_M,
    RoadView,
    ahead_m,
    left_m,
    mean_height,
)
from polemap.extras import kernel
from polemap.stereo.depth_edges import UprightMaps

Floats = NDArray[np.float64]
Floats32 = NDArray[np.float32]

STEP_MIN_M, STEP_MAX_M = 0.05, 0.25
_REACH = round(0.4 / STEP_ASIDE_M)  # columns from the step to the middle of its sides
HEIGHT_SD_PX = 0.25  # of a side's mean height, as a disparity: the matcher's streaks along columns
NOISE_SDS = 5.0
_FINE_BOX = (3, 3)
_FLAT_M, _FLAT_SHARE = 0.03, 0.35  # of the step; how much the sides themselves may rise
UPRIGHT_AT_M = (0.35, 0.55)  # over the edge
UPRIGHT_SHARE = 0.9  # of its disparity: nothing but what stands there has as much
_BLUNT_M = 0.45  # between a quarter and three quarters of the step, beside what the face covers
_LOW_M = 0.12  # the lower side is road: it lies near the plane


@dataclass(frozen=True, slots=True)
class KerbPoints:
    """Points `(n, 2)` of upper edges, road frame, with the step's height `(n,)`.

    `side` is +1 where the ground rises to the left, -1 to the right; `row` `(n,)` is the row of the
    disparity map that showed it.
    """

    points_m: Floats
    step_m: Floats
    side: Floats
    row: NDArray[np.int64]


def kerb_points(view: RoadView, maps: UprightMaps) -> KerbPoints:
    """Where rows of the grid step up, away from the camera.

    The C++ kernel does the work where it was built.
    """
    row, side, step, level, place = _rises(view)
    plane = np.column_stack([ahead_m(row.astype(np.float64)), place])
    alone = ~_upright(view, maps, plane, 0.5 * step + level)
    points = plane * (1.0 - level / view.frame.height_m)[:, np.newaxis]
    return KerbPoints(
        points[alone], step[alone].astype(np.float64), side[alone].astype(np.float64),
        view.image_row[row[alone]] // maps.row_step_px,
    )  # fmt: skip


_Rises = tuple[NDArray[np.int64], Floats32, Floats32, Floats32, Floats]


def _least_step_m(view: RoadView) -> Floats:
    """By row of the grid: what stands out of the matcher's noise."""
    noise = HEIGHT_SD_PX * view.frame.height_m / view.disparity_px
    return np.maximum(STEP_MIN_M, NOISE_SDS * noise)


def _rises(view: RoadView) -> _Rises:
    native = kernel("polemap.detect.native.road_kernel")
    if native is None:
        return plain_rises(view)
    settings = {
        "reach": _REACH, "step_max": STEP_MAX_M, "flat_m": _FLAT_M, "flat_share": _FLAT_SHARE,
        "low_m": _LOW_M, "height_m": view.frame.height_m, "step_aside": STEP_ASIDE_M,
        "aside": ASIDE_M, "blunt_m": _BLUNT_M, "least_matched": LEAST_MATCHED,
    }  # fmt: skip
    row, side, step, level, place = native.kerbs(
        view.ground_m, view.height_m, view.matched, _least_step_m(view), settings
    )
    narrow = (values.astype(np.float32) for values in (side, step, level))
    return row.astype(np.int64), *narrow, place


def plain_rises(view: RoadView) -> _Rises:
    """What the kernel does, in plain numpy: the tests' oracle.

    Returns:
        `(n,)` each: row of the grid, side, step and level (m), place left of the camera's foot on
        the plane (m).
    """
    mean = view.ground_m
    n = mean.shape[1]
    r = _REACH
    middle = slice(2 * r, n - 2 * r)
    rise = mean[:, 3 * r : n - r] - mean[:, r : n - 3 * r]
    side = np.sign(left_m(np.arange(2 * r, n - 2 * r, dtype=np.float64))).astype(np.float32)
    step = rise * side
    # NaN where a side is not known: every comparison fails
    least = _least_step_m(view)[:, np.newaxis]
    peak = (step >= least) & (step <= STEP_MAX_M)
    peak[:, 1:] &= step[:, 1:] >= step[:, :-1]
    peak[:, :-1] &= step[:, :-1] > step[:, 1:]
    row, column = np.nonzero(peak)
    s, step = side[column], step[row, column]
    column = column + middle.start
    out = (s * r).astype(np.int64)
    low, high = mean[row, column - out], mean[row, column + out]
    beyond, before = mean[row, column + 2 * out], mean[row, column - 2 * out]
    allowed = _FLAT_M + _FLAT_SHARE * step
    good = (np.abs(beyond - high) < allowed) & (np.abs(low - before) < allowed)
    good &= np.abs(low) < _LOW_M
    row, column, s, step, level = (a[good] for a in (row, column, s, step, 0.5 * (low + high)))
    return _locate(view, row, column, s, step, level)


def _locate(
    view: RoadView,
    row: NDArray[np.int64],
    column: NDArray[np.int64],
    side: Floats32,
    step: Floats32,
    level: Floats32,
) -> _Rises:
    """Where the profile passes half the step, at its own height.

    The kerb's face is upright, so that each of its heights has the place of its upper edge.
    """
    fine = mean_height(view.height_m, view.matched, _FINE_BOX)
    reach = np.arange(-_REACH, _REACH + 1)
    at = column[:, np.newaxis] + (side[:, np.newaxis] * reach).astype(np.int64)
    over = fine[row[:, np.newaxis], at] - level[:, np.newaxis]
    rising = (over[:, :-1] < 0.0) & (over[:, 1:] >= 0.0)
    away = np.where(rising, np.abs(reach[:-1] + 0.5), np.inf)
    first = np.argmin(away, axis=1)
    n = np.arange(len(row))
    # the rise is abrupt: slopes and what the matcher bridges are not
    quarter = 0.25 * step[:, np.newaxis]
    steps = np.arange(over.shape[1])
    low = np.where((over <= -quarter) & (steps <= first[:, np.newaxis]), steps, -_REACH).max(axis=1)
    high = np.where((over >= quarter) & (steps > first[:, np.newaxis]), steps, 3 * _REACH).min(
        axis=1
    )
    face = 0.5 * step / view.frame.height_m * np.abs(left_m(column.astype(np.float64)))
    good = np.isfinite(away[n, first]) & ((high - low) * STEP_ASIDE_M - face < _BLUNT_M)
    one, two = over[n, first], over[n, first + 1]
    with np.errstate(divide="ignore", invalid="ignore"):
        part = -one / (two - one)
    place = left_m(column + side * (reach[first] + part).astype(np.float64))
    return row[good], side[good], step[good], level[good], place[good]


def _upright(
    view: RoadView, maps: UprightMaps, plane_m: Floats, top_m: Floats32
) -> NDArray[np.bool_]:
    """Whether above an edge, seen at `plane_m` `(n, 2)`, something stands at its own depth.

    Above the edge of a kerb the image shows the ground behind it, which is farther; above the foot
    of a wall, a hedge or a car it shows that thing.
    """
    frame, rig = view.frame, view.frame.rig
    x, y, w = frame.pixel_from_road @ np.column_stack([plane_m, np.ones(len(plane_m))]).T
    column = np.clip(np.rint(x / w), 0, rig.width_px - 1).astype(np.int64)
    disparity = rig.focal_px * rig.baseline_m / (w * (1.0 - top_m / frame.height_m))
    above = np.multiply.outer(UPRIGHT_AT_M, disparity / rig.baseline_m)
    row = np.rint((y / w - above) / maps.row_step_px).astype(np.int64)
    there = maps.left[np.clip(row, 0, len(maps.left) - 1), column]
    return np.asarray((there > UPRIGHT_SHARE * disparity).any(axis=0))
