"""Depth edges to slices: a left and a right flank of one disparity bound an object in one row.

Source: S16, section III-A (contours of depth edges grouped to hypotheses).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from polemap.detect.config import DetectionConfig
from polemap.drivelog.columns import Columns
from polemap.stereo.depth_edges import DepthEdges
from polemap.stereo.rig import StereoRig

Floats = NDArray[np.float64]

_RANKS = 6  # right flanks that are tried for a left one


@dataclass(frozen=True, slots=True)
class Slices(Columns):
    """Row slices of thin objects: `(n,)` row, first and last column, disparity, flags."""

    row_px: Floats
    left_px: Floats
    right_px: Floats
    disparity_px: Floats
    far_left_px: Floats
    far_right_px: Floats
    occluding_left: Floats
    occluding_right: Floats


def find_slices(
    left: DepthEdges, right: DepthEdges, rig: StereoRig, config: DetectionConfig
) -> Slices:
    """Every left flank with the nearest right flank of its disparity in the same row."""
    stride = float(rig.width_px + 4096)
    key_left = left.row_px * stride + left.column_px
    key_right = right.row_px * stride + right.column_px
    partner = np.full(len(left), -1)
    first = np.searchsorted(key_right, key_left - 0.5)
    right_rows = np.append(right.row_px, -1)  # beyond the last there is none
    open_ = np.arange(len(left))  # no partner yet, and there may be one farther right
    for rank in range(_RANKS):
        at = np.minimum(first[open_] + rank, len(right))
        same = right_rows[at] == left.row_px[open_]
        open_, at = open_[same], at[same]
        near = left.near_px[open_]
        width = right.column_px[at] - left.column_px[open_] + 1.0
        within = width * rig.baseline_m / near <= 1.3 * config.width_max_m
        alike = within & (np.abs(right.near_px[at] - near) <= 1.0 + 0.04 * near)
        partner[open_[alike]] = at[alike]
        open_ = open_[within & ~alike]
    one = np.flatnonzero(partner >= 0)
    two = partner[one]
    disparity = 0.5 * (left.near_px[one] + right.near_px[two]).astype(np.float64)
    depth = rig.focal_px * rig.baseline_m / disparity
    near = (depth <= config.range_max_m * 1.1) & (depth >= config.range_min_m * 0.8)
    one, two, disparity = one[near], two[near], disparity[near]
    return Slices(
        left.row_px[one].astype(np.float64),
        left.column_px[one].astype(np.float64),
        right.column_px[two].astype(np.float64),
        disparity,
        left.far_px[one].astype(np.float64),
        right.far_px[two].astype(np.float64),
        left.occluding[one].astype(np.float64),
        right.occluding[two].astype(np.float64),
    )
