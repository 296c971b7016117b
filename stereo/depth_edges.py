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

from stereo.matching import DisparityPair

Floats = NDArray[np.float32]
Ints = NDArray[np.int32]


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
    thin = np.array(disparity[::step], dtype=np.float32)
    cv2.patchNaNs(thin, 0.0)
    upper, here, lower = thin[:-2], thin[1:-1], thin[2:]
    median = thin.copy()
    if len(thin) > 2:
        # fresh arrays of this size cost as much as the arithmetic: results go where they can
        most = cv2.max(upper, here)
        cv2.min(most, lower, dst=most)
        cv2.min(upper, here, dst=median[1:-1])
        cv2.max(median[1:-1], most, dst=median[1:-1])
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
    left, right = _matched(maps.left), _matched(maps.right)
    sides = []
    for toward_right in (False, True):
        # the band beside the left flank is seen in the left view, the one beside the right flank
        # in the right view; the other view still shows the jump
        own, other = (right, left) if toward_right else (left, right)
        seen = _jumps(own, toward_right, step_min_px, depth_step)
        bare = _jumps(other, toward_right, step_min_px, depth_step)
        # a column of the right view moves by its disparity into the left view
        moved = (seen if toward_right else bare)[2]
        columns = (seen[1] + moved, bare[1]) if toward_right else (seen[1], bare[1] + moved)
        row = np.concatenate([seen[0], bare[0]])
        column = np.concatenate(columns)
        near, far = (np.concatenate([seen[k], bare[k]]) for k in (2, 3))
        occluding = np.concatenate([seen[4], np.zeros(len(bare[0]), dtype=bool)])
        order = np.argsort(row * np.float64(1 << 20) + column)
        row = (row[order] * maps.row_step_px).astype(np.int32)
        sides.append(DepthEdges(row, column[order], near[order], far[order], occluding[order]))
    return sides[0], sides[1]


class _Matched(NamedTuple):
    """The matched pixels of a map in reading order: flat position, disparity, step to the next."""

    width: int
    position: NDArray[np.int64]
    value: Floats
    step: Floats


def _matched(disparity: Floats) -> _Matched:
    flat = disparity.ravel()
    position = np.flatnonzero(flat > 0)
    value = flat[position]
    return _Matched(disparity.shape[1], position, value, np.diff(value))


def _jumps(
    pixels: _Matched, toward_right: bool, step_min_px: float, depth_step: float
) -> tuple[Ints, Floats, Floats, Floats, NDArray[np.bool_]]:
    """Row, column, near, far of every jump of one view, and whether a band lies in it.

    Neighbours are taken over holes: only matched pixels are compared. A jump counts if the hole
    is not wider than twice the jump and some pixels: geometry makes them equal.
    """
    width, position, value, step = pixels
    at = np.flatnonzero(step <= -step_min_px if toward_right else step >= step_min_px)
    near_at, far_at = (at, at + 1) if toward_right else (at + 1, at)
    near, far = value[near_at], value[far_at]
    gap = position[at + 1] - position[at] - 1
    jump = near - far
    row = position[near_at] // width
    good = (row == position[far_at] // width) & (jump >= depth_step * near * far)
    good &= gap <= 2.0 * jump + 4.0
    # a speck is no surface: the object goes on inward, and what is beside it stays farther
    inward, outward = (1, -1) if not toward_right else (-1, 1)
    last = len(value) - 1
    goes_on = np.abs(value[np.clip(near_at + inward, 0, last)] - near) <= 1.0 + 0.03 * near
    stays_far = value[np.clip(far_at + outward, 0, last)] <= near - 0.5 * jump
    good &= goes_on & stays_far
    near_at, near, far, gap, jump = near_at[good], near[good], far[good], gap[good], jump[good]
    column = (position[near_at] - row[good] * width).astype(np.float32)
    band = gap >= np.maximum(1.0, 0.4 * jump)
    return row[good].astype(np.int32), column, near, far, band
