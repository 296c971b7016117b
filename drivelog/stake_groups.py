"""Which poles are the stakes round one sapling.

Three or four thin stakes stand within a metre round a young tree: a LiDAR map holds them as one
pole, a camera sees each. A group needs three at the least, thin, of one height, in a ring: a lamp
post beside a sign, two posts of one sign, and posts in a row are none.
"""

from __future__ import annotations

import itertools

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]
Whole = NDArray[np.int64]

STAKES_MIN, STAKES_MAX = 3, 5  # parts of a group; more is a fence
WIDTH_MAX_M = 0.2
HEIGHT_M = (0.7, 3.2)
HEIGHT_RANGE_M = 1.2  # of the visible heights: leaves hide tops, hedges and grass hide feet
APART_M = (0.25, 1.1)  # nearer is one stake seen twice
DIAMETER_MAX_M = 1.35
RING_SHARE = 0.3  # least ratio of the spreads across and along: less is a row
# of the diameter: how far the middle of the stakes and what a map calls the place differ, an axis.
# Three stakes of 0.87 m round the sapling of KITTI 03: 0.2 m
MIDDLE_SD_SHARE = 0.2


def stake_groups(points_m: Floats, width_m: Floats, height_m: Floats, apart: Flags) -> Whole:
    """Number of each pole's group `(n,)`, -1 of what belongs to none.

    Args:
        points_m: `(n, 2)`.
        width_m, height_m: `(n,)`; what is NaN is no stake.
        apart: `(n, n)` pairs that are two things for certain, as both were seen at one time.
    """
    label = np.full(len(points_m), -1, dtype=np.int64)
    thin = (width_m <= WIDTH_MAX_M) & (height_m >= HEIGHT_M[0]) & (height_m <= HEIGHT_M[1])
    rows = np.flatnonzero(thin)
    if len(rows) < STAKES_MIN:
        return label
    gap = np.hypot(*np.moveaxis(points_m[rows, None] - points_m[rows], 2, 0))
    near = (gap <= APART_M[1]) & apart[np.ix_(rows, rows)]
    left, count = set(range(len(rows))), 0
    while left:
        members = _reached(near, left.pop())
        left -= set(members)
        if _is_ring(points_m[rows[members]], height_m[rows[members]]):
            label[rows[members]] = count
            count += 1
    return label


def _reached(near: Flags, first: int) -> list[int]:
    """All that hang together with the first."""
    found, edge = {first}, [first]
    while edge:
        more = set(np.flatnonzero(near[edge.pop()]).tolist()) - found
        found |= more
        edge += more
    return sorted(found)


def _is_ring(points_m: Floats, height_m: Floats) -> bool:
    if not STAKES_MIN <= len(points_m) <= STAKES_MAX:
        return False
    gaps = [float(np.hypot(*(a - b))) for a, b in itertools.combinations(points_m, 2)]
    if min(gaps) < APART_M[0] or max(gaps) > DIAMETER_MAX_M:
        return False
    spread = np.linalg.svd(points_m - points_m.mean(axis=0), compute_uv=False)
    return bool(np.ptp(height_m) <= HEIGHT_RANGE_M and spread[1] >= RING_SHARE * spread[0])


def diameter_m(points_m: Floats, width_m: Floats) -> float:
    """Width of a group: its greatest gap, and a stake."""
    gap = np.hypot(*np.moveaxis(points_m[:, None] - points_m, 2, 0))
    return float(gap.max() + np.nanmean(width_m))
