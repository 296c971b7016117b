"""Depth edges of near objects from the half-occlusions of both views.

Left of a near object lies a band of background that only the left camera sees, right of it one
that only the right camera sees. Such a band is as wide as the disparity jump. So the left flank
of an object is read from the left map and its right flank from the right map: there the matched
surface, the unmatched band and the background follow each other in that order, and a hole that is
much wider than the jump (a textureless wall, the sky, a failed match) is not an edge.

Source: A. Bobick, S. Intille, Large occlusion stereo, IJCV 33(3), 1999, section 2 (the geometry of
half-occlusion); its use for poles in S16, section III-A.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from polemap.stereo.matching import DisparityPair

Floats = NDArray[np.float32]
Ints = NDArray[np.int32]

# maps are gone through in strips that stay in the cache: fresh memory costs more than arithmetic
_STRIP_ROWS = 24
_STRIP_PIXELS = 30_000


@dataclass(frozen=True, slots=True)
class DepthEdges:
    """Flanks of near objects on one side, sorted by row and then by column.

    Attributes:
        row_px: `(n,)` image row.
        column_px: `(n,)` column of the object's outermost pixel, in the left view.
        near_px: `(n,)` disparity of the object.
        far_px: `(n,)` disparity of what is seen next to it.
        occluding: `(n,)` whether the half-occluded band was seen, or only the jump.
    """

    row_px: Ints
    column_px: Floats
    near_px: Floats
    far_px: Floats
    occluding: NDArray[np.bool_]

    def __len__(self) -> int:
        return len(self.row_px)


@dataclass(frozen=True, slots=True)
class UprightMaps:
    """Both disparity maps on every `row_step_px`-th row, `(height / step, width)`, 0 for none.

    Every value is the median over three such rows: upright things keep their flanks to the pixel,
    while specks and pinholes go.
    """

    left: Floats
    right: Floats
    row_step_px: int
    height_px: int


def upright_maps(disparity: DisparityPair, row_step_px: int) -> UprightMaps:
    """The maps, thinned out and cleaned along the columns."""
    return UprightMaps(
        _upright_median(disparity.left, row_step_px),
        _upright_median(disparity.right, row_step_px),
        row_step_px,
        disparity.left.shape[0],
    )


def _upright_median(disparity: Floats, step: int) -> Floats:
    """Median over every step-th row, the one above and the one below; a missing value counts as 0.

    So two of the three have to be there, and where one is missing the smaller of the others is
    taken: a hole is filled from the background.
    """
    rows = disparity[::step]
    height = len(rows)
    median = np.empty(rows.shape, dtype=np.float32)
    for first in range(0, height, _STRIP_ROWS):
        last = min(first + _STRIP_ROWS, height)
        above = max(first - 1, 0)
        thin = np.array(rows[above : last + 1], dtype=np.float32)
        cv2.patchNaNs(thin, 0.0)
        if first == 0:
            median[0] = thin[0]
        if last == height:
            median[-1] = thin[-1]
        if len(thin) > 2:
            upper, here, lower = thin[:-2], thin[1:-1], thin[2:]
            out = median[above + 1 : above + len(thin) - 1]
            most = cv2.max(upper, here)
            cv2.min(most, lower, dst=most)
            cv2.min(upper, here, dst=out)
            cv2.max(out, most, dst=out)
    return median


def depth_edges(
    maps: UprightMaps, step_min_px: float, depth_step: float
) -> tuple[DepthEdges, DepthEdges]:
    """Left and right flanks in every row of the maps.

    Args:
        maps: both checked maps.
        step_min_px: smallest jump of the disparity.
        depth_step: smallest jump as `c` in `near - far >= c * near * far`: with c = dZ / (f b)
            that is a jump of the depth by dZ.
    """
    views = [_jumps(view, step_min_px, depth_step) for view in (maps.left, maps.right)]
    sides = []
    for toward_right in (0, 1):
        # the band beside the left flank is seen in the left view, the one beside the right flank
        # in the right view; the other view still shows the jump
        left, right = (view[toward_right] for view in views)
        # a column of the right view moves by its disparity into the left view
        right = right._replace(column=right.column + right.near)
        seen, bare = (right, left) if toward_right else (left, right)
        row = np.concatenate([seen.row, bare.row])
        column = np.concatenate([seen.column, bare.column])
        near = np.concatenate([seen.near, bare.near])
        far = np.concatenate([seen.far, bare.far])
        occluding = np.concatenate([seen.band, np.zeros(len(bare.row), dtype=bool)])
        order = np.argsort(row * np.float64(1 << 20) + column, kind="stable")
        row = (row[order] * maps.row_step_px).astype(np.int32)
        sides.append(DepthEdges(row, column[order], near[order], far[order], occluding[order]))
    return sides[0], sides[1]


class _Jumps(NamedTuple):
    """Jumps of one view on one side of the objects, in reading order, `(n,)` each.

    `column` is that of the nearer surface's outermost pixel, `band` says whether the half-occluded
    band lies between the surfaces.
    """

    row: Ints
    column: Floats
    near: Floats
    far: Floats
    band: NDArray[np.bool_]


def _jumps(disparity: Floats, step_min_px: float, depth_step: float) -> tuple[_Jumps, _Jumps]:
    """The jumps of one view at left and at right flanks.

    Neighbours are taken over holes: only matched pixels are compared. A jump counts if the hole
    is not wider than twice the jump and some pixels: geometry makes them equal.
    """
    width = disparity.shape[1]
    position, gap, inner, one, two, outer = _steps(disparity.ravel(), step_min_px)
    near, far = np.maximum(one, two), np.minimum(one, two)
    jump = near - far
    row = position // width
    column = position - row * width
    good = (column + gap < width - 1) & (jump >= depth_step * near * far)
    good &= gap <= 2.0 * jump + 4.0
    # a speck is no surface: the object goes on inward, and what is beside it stays farther
    halfway = near - 0.5 * jump
    left = (two > one) & (np.abs(outer - two) <= 1.0 + 0.03 * two) & (inner <= halfway)
    right = (two < one) & (np.abs(inner - one) <= 1.0 + 0.03 * one) & (outer <= halfway)
    band = gap >= np.maximum(1.0, 0.4 * jump)
    sides = []
    for side, at in enumerate((np.flatnonzero(good & left), np.flatnonzero(good & right))):
        outermost = column[at] if side else column[at] + gap[at] + 1
        sides.append(
            _Jumps(
                row[at].astype(np.int32),
                outermost.astype(np.float32),
                near[at],
                far[at],
                band[at],
            )
        )
    return sides[0], sides[1]


def _steps(
    flat: Floats, step_min_px: float
) -> tuple[NDArray[np.int64], NDArray[np.int64], Floats, Floats, Floats, Floats]:
    """Matched pixels that follow each other and differ by `step_min_px` or more, in reading order.

    Returns the position of the first of the two, the width of the hole between them, and the
    values of the matched pixel before them, of both, and of the one after them. Where nothing
    comes before or after, that is the value of the first or of the second.
    """
    at = _breaks(flat, step_min_px)
    one, two = flat.take(at), flat.take(at + 1)
    # a hole begins at one break and ends at the next
    first = np.flatnonzero(one > 0)
    if len(first) and first[-1] == len(at) - 1 and two[-1] <= 0:
        first = first[:-1]
    second = first + (two.take(first) <= 0)
    step = np.abs(two.take(second) - one.take(first))
    big = np.flatnonzero(step >= step_min_px)
    first, second = first.take(big), second.take(big)
    before, after = at.take(first), at.take(second) + 1
    value_one, value_two = one.take(first), two.take(second)
    inner = flat.take(np.maximum(before - 1, 0))
    outer = flat.take(np.minimum(after + 1, len(flat) - 1))
    hole = np.flatnonzero(inner <= 0)
    back = first.take(hole) - 2
    inner[hole] = np.where(back >= 0, one.take(np.maximum(back, 0)), value_one.take(hole))
    hole = np.flatnonzero(outer <= 0)
    on = second.take(hole) + 2
    last = len(at) - 1
    outer[hole] = np.where(on <= last, two.take(np.minimum(on, last)), value_two.take(hole))
    return before, after - before - 1, inner, value_one, value_two, outer


def _breaks(flat: Floats, step_min_px: float) -> NDArray[np.int64]:
    """Positions after which a hole begins or ends, or a matched pixel follows that may differ.

    A little too many jumps are returned, never too few.
    """
    last = len(flat) - 1
    breaks = np.zeros(-(-max(last, 0) // 8) * 8, dtype=np.bool_)
    for begin in range(0, last, _STRIP_PIXELS):
        end = min(begin + _STRIP_PIXELS, last)
        step = np.abs(flat[begin + 1 : end + 1] - flat[begin:end])
        matched = flat[begin : end + 1] > 0
        out = breaks[begin:end]
        np.greater_equal(step, 0.99 * step_min_px, out=out)
        out &= matched[1:]
        out |= matched[1:] != matched[:-1]
    # few are set: looking at eight at once is faster
    words = breaks.view(np.int64)
    eights = np.flatnonzero(words != 0)
    at = np.flatnonzero(words.take(eights).view(np.bool_))
    return eights.take(at >> 3) * 8 + (at & 7)
