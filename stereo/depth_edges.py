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


def depth_edges(
    disparity: DisparityPair, row_step_px: int, step_min_px: float, depth_step: float
) -> tuple[DepthEdges, DepthEdges]:
    """Left and right flanks on every `row_step_px`-th row.

    Args:
        disparity: both checked maps.
        row_step_px: rows between two that are looked at.
        step_min_px: smallest jump of the disparity.
        depth_step: smallest jump as `c` in `near - far >= c * near * far`: with c = dZ / (f b)
            that is a jump of the depth by dZ.
    """
    left = disparity.left[::row_step_px]
    right = disparity.right[::row_step_px]
    sides = []
    for toward_right in (False, True):
        # the band beside the left flank is seen in the left view, the one beside the right flank
        # in the right view; the other view still shows the jump
        seen = _jumps(right if toward_right else left, toward_right, step_min_px, depth_step)
        bare = _jumps(left if toward_right else right, toward_right, step_min_px, depth_step)
        to_left = (bare if not toward_right else seen)[2]
        if toward_right:
            seen = (seen[0], seen[1] + to_left, *seen[2:])
        else:
            bare = (bare[0], bare[1] + to_left, *bare[2:])
        row, column, near, far, _ = (np.concatenate(pair) for pair in zip(seen, bare, strict=True))
        occluding = np.concatenate([seen[4], np.zeros(len(bare[0]), dtype=bool)])
        order = np.lexsort((column, row))
        sides.append(
            DepthEdges(
                (row[order] * row_step_px).astype(np.int32),
                column[order],
                near[order],
                far[order],
                occluding[order],
            )
        )
    return sides[0], sides[1]


def _jumps(
    disparity: Floats, toward_right: bool, step_min_px: float, depth_step: float
) -> tuple[Ints, Floats, Floats, Floats, NDArray[np.bool_]]:
    """Row, column, near, far of every jump of one view, and whether a band lies in it.

    Neighbours are taken over holes: only matched pixels are compared. A jump counts if the hole
    is not wider than twice the jump and some pixels: geometry makes them equal.
    """
    width = disparity.shape[1]
    flat = disparity.ravel()
    position = np.flatnonzero(flat > 0)  # NaN compares false
    value = flat[position]
    step = np.diff(value) if not toward_right else -np.diff(value)
    at = np.flatnonzero(step >= step_min_px)
    near_at, far_at = (at + 1, at) if not toward_right else (at, at + 1)
    near, far = value[near_at], value[far_at]
    gap = position[at + 1] - position[at] - 1
    jump = near - far
    row = position[near_at] // width
    good = (row == position[far_at] // width) & (jump >= depth_step * near * far)
    good &= gap <= 2.0 * jump + 4.0
    near_at, near, far, gap, jump = near_at[good], near[good], far[good], gap[good], jump[good]
    column = (position[near_at] - row[good] * width).astype(np.float32)
    band = gap >= np.maximum(1.0, 0.4 * jump)
    return row[good].astype(np.int32), column, near, far, band
