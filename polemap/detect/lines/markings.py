"""Lane markings of one frame: bright stripes on the ground, found row by row of the road grid.

A stripe answers by how much it is brighter than the brighter of its two sides, so a shadow's edge,
a step that has one bright side, does not answer at all. Its flanks, where the brightness passes
half its height, say how wide it is and where its middle lies.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from polemap.detect.lines.road_frame import (
    ASIDE_M,
    COLUMNS,
    STEP_ASIDE_M,
    RoadView,
    ahead_m,
    left_m,
)
from polemap.extras import kernel

Floats = NDArray[np.float64]
Floats32 = NDArray[np.float32]

WIDTH_MIN_M, WIDTH_MAX_M = 0.08, 0.5
_SIDE_BOX = 7  # columns of each side
_BOXES = (3, 7)  # columns: stripes of 0.1 to 0.2 m, and of 0.2 to 0.5 m
_LEAST_LEVELS = 5  # of 255: less is the camera's noise
_LEAST_SHARE = 0.1  # of the side's brightness: worn paint
_SIDES_SHARE = 0.5  # of the contrast, by which the sides may differ
_BESIDE = np.arange(1, 8)  # columns behind a flank that are its side
_SCATTER_SHARE = 0.4  # of the contrast: leaves' shadows scatter more
_REACH = 16  # columns of a profile to each side
_STEP_AT = 10  # columns
_RISE_MAX_M = 0.045
_GROUND_M = 0.25  # farther over or under the plane is no road


@dataclass(frozen=True, slots=True)
class MarkingPoints:
    """Middles `(n, 2)` of stripes in the road frame, on the ground as it was measured there.

    Attributes:
        width_m: `(n,)`.
        contrast: `(n,)` over the brighter side, in parts of it.
        row: `(n,)` row of the image that showed it.
    """

    points_m: Floats
    width_m: Floats
    contrast: Floats
    row: NDArray[np.int64]


def marking_points(view: RoadView) -> MarkingPoints:
    """Rows of the grid that a bright stripe crosses.

    The C++ kernel does the work behind the filter where it was built.
    """
    light = view.light
    sides = cv2.blur(light, (_SIDE_BOX, 1))
    answer = np.zeros_like(light)
    for box in _BOXES:
        apart = (box + _SIDE_BOX) // 2 + 1
        mean = sides if box == _SIDE_BOX else cv2.blur(light, (box, 1))
        beside = cv2.max(sides[:, : -2 * apart], sides[:, 2 * apart :])
        # bytes do not fall below 0
        ridge = cv2.subtract(mean[:, apart:-apart], beside)
        np.maximum(answer[:, apart:-apart], ridge, out=answer[:, apart:-apart])
    row, level, width, place, contrast = _stripes(view, answer)
    points = np.column_stack([ahead_m(row.astype(np.float64)), place])
    points *= (1.0 - level / view.frame.height_m)[:, np.newaxis]
    return MarkingPoints(points, width, contrast, view.image_row[row])


_Stripes = tuple[NDArray[np.int64], Floats32, Floats, Floats, Floats]
_SETTINGS = {
    "reach": _REACH, "step_at": _STEP_AT, "least_levels": _LEAST_LEVELS,
    "least_share": _LEAST_SHARE, "sides_share": _SIDES_SHARE, "scatter_share": _SCATTER_SHARE,
    "rise_max": _RISE_MAX_M, "ground_m": _GROUND_M, "width_min": WIDTH_MIN_M,
    "width_max": WIDTH_MAX_M, "step_aside": STEP_ASIDE_M, "aside": ASIDE_M,
}  # fmt: skip


def _stripes(view: RoadView, answer: NDArray[np.uint8]) -> _Stripes:
    native = kernel("polemap.detect.native.road_kernel")
    if native is None:
        return plain_stripes(view, answer)
    row, level, width, place, contrast = native.stripes(
        answer, view.light, view.inside, view.ground_m, _SETTINGS
    )
    return row.astype(np.int64), level.astype(np.float32), width, place, contrast


def plain_stripes(view: RoadView, answer: NDArray[np.uint8]) -> _Stripes:
    """What the kernel does, in plain numpy: the tests' oracle.

    Args:
        answer: `(ROWS, COLUMNS)` by how much each cell is brighter than the brighter side.

    Returns:
        `(n,)` each: row of the grid, level of the ground and width (m), place left of the camera's
        foot on the plane (m), contrast in parts of the brighter side.
    """
    middle = answer[:, 1:-1]
    peak = (middle >= _LEAST_LEVELS) & (middle >= answer[:, :-2]) & (middle > answer[:, 2:])
    peak &= view.inside[:, 1:-1]
    row, column = np.nonzero(peak)
    column += 1
    inner = (column >= _REACH) & (column < COLUMNS - _REACH)
    row, column = row[inner], column[inner]
    ground = view.ground_m
    level = ground[row, column]
    # NaN, where the ground is not known, is no road
    on_road = np.abs(level) < _GROUND_M
    # a bright kerbstone has a step beside it
    rise = ground[row, column + _STEP_AT] - ground[row, column - _STEP_AT]
    on_road &= ~(np.abs(rise) >= _RISE_MAX_M)
    return _measure(view, row[on_road], column[on_road], level[on_road])


def _measure(
    view: RoadView, row: NDArray[np.int64], column: NDArray[np.int64], level: Floats32
) -> _Stripes:
    """Flanks of the stripes; those too thin, too wide or with unequal sides are left out."""
    reach = np.arange(-_REACH, _REACH + 1)
    profile = view.light[row[:, np.newaxis], column[:, np.newaxis] + reach].astype(np.float32)
    top = profile[:, _REACH - 1 : _REACH + 2].max(axis=1)
    halves, lights, scatters = [], [], []
    for outward in (profile[:, _REACH::-1], profile[:, _REACH:]):
        half = 0.5 * (top + outward[:, 1:9].min(axis=1))
        first = np.argmax(outward < half[:, np.newaxis], axis=1)
        n = np.arange(len(row))
        inner, outer = outward[n, first - 1], outward[n, first]
        part = (inner - half) / np.maximum(inner - outer, 1e-6)
        halves.append(np.where(first > 0, first - 1 + part, np.inf))
        # the side proper: from behind the flank on
        beside = outward[n[:, np.newaxis], np.minimum(first[:, np.newaxis] + _BESIDE, _REACH)]
        beside = np.sort(beside, axis=1)
        # a double line has its twin in one side: the median does not see it
        lights.append(beside[:, 3])
        # nor is a tar seam along the paint, two of its seven columns, a scatter
        calm = np.minimum(beside[:, 3] - beside[:, 0], beside[:, 6] - beside[:, 2])
        scatters.append(np.minimum(beside.std(axis=1), calm))
    right, left = halves
    width = (right + left) * STEP_ASIDE_M
    brighter = np.maximum(*lights)
    contrast = top - brighter
    good = (width >= WIDTH_MIN_M) & (width <= WIDTH_MAX_M)
    good &= np.abs(lights[0] - lights[1]) <= _SIDES_SHARE * contrast
    good &= np.maximum(*scatters) <= _SCATTER_SHARE * contrast
    good &= contrast >= np.maximum(_LEAST_SHARE * brighter, _LEAST_LEVELS)
    row, level, width = row[good], level[good], width[good]
    place = left_m(column[good] + 0.5 * (left[good] - right[good]))
    share = contrast[good] / np.maximum(brighter[good], 1.0)
    return row, level, width.astype(np.float64), place, share.astype(np.float64)
