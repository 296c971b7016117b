"""Depth edges to pole hypotheses: pairs of flanks, grouped along an upright line.

A flank left and a flank right of one disparity bound a slice of an object in one image row. Slices
above each other form a stem. Stems of one line are joined over gaps (foliage, a car in front), and
the columns of their flanks are sharpened on the image gradient.

Source: S16, section III-A (contours of depth edges grouped to hypotheses).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from polemap.config import DetectionConfig
from polemap.ground import Ground
from stereo.depth_edges import DepthEdges
from stereo.rig import StereoRig

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

_ROWS_APART = 4  # slices are linked over so many looked-at rows
_REACH_PX = 3  # and so many columns


@dataclass(frozen=True, slots=True)
class Slices:
    """Row slices of thin objects: `(n,)` row, first and last column, disparity, flags."""

    row_px: Floats
    left_px: Floats
    right_px: Floats
    disparity_px: Floats
    far_left_px: Floats
    far_right_px: Floats
    occluding_left: Floats
    occluding_right: Floats


@dataclass(frozen=True, slots=True)
class Stems:
    """Upright groups of slices, one a row of every array.

    The centre line is `column_px + slope * (row - row_px)`; `(n,)` each.

    Attributes:
        column_px, row_px: a point of the centre line.
        slope: columns a row.
        width_px: distance of the flanks.
        top_px, bottom_px: first and last row with a slice.
        disparity_px: median over the slices.
        slices: how many there are.
        centre_sd_px, width_sd_px, disparity_sd_px: scatter about line, width and disparity.
        far_left_px, far_right_px: median disparity seen beside it.
        occluding_left, occluding_right: share of slices with a half-occluded band beside them.
    """

    column_px: Floats
    row_px: Floats
    slope: Floats
    width_px: Floats
    top_px: Floats
    bottom_px: Floats
    disparity_px: Floats
    slices: Floats
    centre_sd_px: Floats
    width_sd_px: Floats
    disparity_sd_px: Floats
    far_left_px: Floats
    far_right_px: Floats
    occluding_left: Floats
    occluding_right: Floats

    def __len__(self) -> int:
        return len(self.column_px)

    def take(self, rows: NDArray[np.int64] | NDArray[np.bool_]) -> Stems:
        """The chosen rows."""
        return Stems(*(getattr(self, name)[rows] for name in self.__slots__))


def find_slices(
    left: DepthEdges, right: DepthEdges, rig: StereoRig, config: DetectionConfig
) -> Slices:
    """Every left flank with the nearest right flank of its disparity in the same row."""
    stride = float(rig.width_px + 4096)
    key_left = left.row_px * stride + left.column_px
    key_right = right.row_px * stride + right.column_px
    partner = np.full(len(left), -1)
    first = np.searchsorted(key_right, key_left - 0.5)
    for rank in range(6):
        at = np.minimum(first + rank, max(len(right) - 1, 0))
        if not len(right):
            break
        width = right.column_px[at] - left.column_px + 1.0
        alike = np.abs(right.near_px[at] - left.near_px) <= 1.0 + 0.04 * left.near_px
        same = (right.row_px[at] == left.row_px) & (first + rank < len(right))
        metric = width * rig.baseline_m / left.near_px
        good = same & alike & (metric <= 1.3 * config.width_max_m) & (partner < 0)
        partner[good] = at[good]
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


def find_stems(slices: Slices, ground: Ground, rig: StereoRig, config: DetectionConfig) -> Stems:
    """Groups of slices that could be a pole: upright, thin, tall enough, near the ground."""
    if len(slices.row_px) == 0:
        return _fit(slices, np.empty(0, dtype=np.int64), 0)
    label, count = _link(slices, rig, config)
    stems = _fit(slices, label, count)
    tall = (stems.bottom_px - stems.top_px) * rig.baseline_m / stems.disparity_px
    enough = (stems.slices >= 3) & (tall >= 0.5 * config.height_min_m)
    renumber = np.where(enough, np.cumsum(enough) - 1, -1)
    stems, label = stems.take(enough), renumber[label]
    if len(stems) == 0:
        return stems
    merged, count = _join(stems, rig, config)
    label = np.where(label >= 0, merged[label], -1)
    return _keep(_fit(slices, label, count), ground, rig, config)


def _link(slices: Slices, rig: StereoRig, config: DetectionConfig) -> tuple[Ints, int]:
    """Components of slices that follow each other in neighbouring rows."""
    n = len(slices.row_px)
    row = (slices.row_px / config.row_step_px).astype(np.int64) + _ROWS_APART
    centre = 0.5 * (slices.left_px + slices.right_px)
    column = np.round(centre).astype(np.int64) + _REACH_PX
    width = rig.width_px + 2 * _REACH_PX + 2
    cells = np.full((int(row.max()) + _ROWS_APART + 1) * width, -1, dtype=np.int64)
    at = row * width + column
    cells[at] = np.arange(n)
    down, aside = np.meshgrid(
        np.arange(1, _ROWS_APART + 1), np.arange(-_REACH_PX, _REACH_PX + 1), indexing="ij"
    )
    other = cells[at[:, None] + (down * width + aside).ravel()]
    one, which = np.nonzero(other >= 0)
    two = other[one, which]
    alike = np.abs(slices.disparity_px[one] - slices.disparity_px[two]) <= (
        0.75 + 0.03 * slices.disparity_px[one]
    )
    w1 = slices.right_px[one] - slices.left_px[one] + 1.0
    w2 = slices.right_px[two] - slices.left_px[two] + 1.0
    alike &= np.maximum(w1, w2) <= 1.5 * np.minimum(w1, w2) + 2.0
    one, two = one[alike], two[alike]
    graph = coo_matrix((np.ones(len(one), dtype=np.int8), (one, two)), shape=(n, n))
    count, label = connected_components(graph, directed=False)
    return label.astype(np.int64), int(count)


def _fit(slices: Slices, label: Ints, count: int) -> Stems:
    """Line, width and scatter of every group; slices with label -1 are left out."""
    centre = 0.5 * (slices.left_px + slices.right_px)
    width = slices.right_px - slices.left_px + 1.0
    use = label >= 0
    weight: Floats = use.astype(np.float64)
    safe = np.where(use, label, 0)

    def total(values: Floats) -> Floats:
        sums = np.bincount(safe, weights=values * weight, minlength=count)[:count]
        return sums.astype(np.float64)

    for sweep in range(3):
        n = np.maximum(total(np.ones_like(centre)), 1.0)
        row0 = total(slices.row_px) / n
        column0 = total(centre) / n
        dv = slices.row_px - row0[safe] if count else slices.row_px
        spread = total(dv * dv)
        slope = total(dv * centre) / np.maximum(spread, 1.0)
        # a short stem says little about its lean: the upright prior shrinks the slope
        slope = slope * spread / (spread + 200.0)
        mean_width = total(width) / n
        mean_disparity = total(slices.disparity_px) / n
        off_centre = centre - column0[safe] - slope[safe] * dv if count else centre
        off_width = width - mean_width[safe] if count else width
        off_disparity = slices.disparity_px - mean_disparity[safe] if count else width
        if sweep < 2 and count:
            sd_c = np.sqrt(total(off_centre**2) / n)[safe]
            sd_w = np.sqrt(total(off_width**2) / n)[safe]
            inlier = use & (np.abs(off_centre) <= 2.0 * sd_c + 0.6)
            weight = (inlier & (np.abs(off_width) <= 2.0 * sd_w + 0.6)).astype(np.float64)
    big = np.where(weight > 0, slices.row_px, -np.inf)
    bottom = np.full(count, -np.inf)
    top = np.full(count, np.inf)
    if count:
        np.maximum.at(bottom, safe, big)
        np.minimum.at(top, safe, np.where(weight > 0, slices.row_px, np.inf))
    return Stems(
        column_px=column0,
        row_px=row0,
        slope=slope,
        width_px=mean_width,
        top_px=top,
        bottom_px=bottom,
        disparity_px=mean_disparity,
        slices=n,
        centre_sd_px=np.sqrt(total(off_centre**2) / n),
        width_sd_px=np.sqrt(total(off_width**2) / n),
        disparity_sd_px=np.sqrt(total(off_disparity**2) / n),
        far_left_px=total(slices.far_left_px) / n,
        far_right_px=total(slices.far_right_px) / n,
        occluding_left=total(slices.occluding_left) / n,
        occluding_right=total(slices.occluding_right) / n,
    )


def _join(stems: Stems, rig: StereoRig, config: DetectionConfig) -> tuple[Ints, int]:
    """Components of stems that continue each other over a gap: one line, disparity and width."""
    lower = stems.row_px[:, None] < stems.row_px[None, :]
    gap_m = np.maximum(
        stems.top_px[None, :] - stems.bottom_px[:, None],
        0.0,
    ) * (rig.baseline_m / stems.disparity_px[:, None])
    # both centre lines, and a plain vertical, are extended to the other's centre
    down = stems.row_px[None, :] - stems.row_px[:, None]
    across = stems.column_px[None, :] - stems.column_px[:, None]
    slope = (
        stems.slope[:, None] * stems.slices[:, None] + stems.slope[None, :] * stems.slices[None, :]
    ) / (stems.slices[:, None] + stems.slices[None, :])
    miss = np.abs(across - slope * down)
    scale = 1.5 + 0.15 * 0.5 * (stems.width_px[:, None] + stems.width_px[None, :])
    alike = np.abs(stems.disparity_px[:, None] - stems.disparity_px[None, :]) <= (
        0.6 + 0.025 * stems.disparity_px[:, None]
    )
    wide = np.maximum(stems.width_px[:, None], stems.width_px[None, :])
    thin = np.minimum(stems.width_px[:, None], stems.width_px[None, :])
    link = lower & alike & (miss <= scale) & (gap_m <= 1.5) & (wide <= 1.6 * thin + 1.5)
    count, label = connected_components(coo_matrix(link), directed=False)
    return label.astype(np.int64), int(count)


def _keep(stems: Stems, ground: Ground, rig: StereoRig, config: DetectionConfig) -> Stems:
    """Drop what cannot be a pole: too short, too wide, too high above the ground, leaning."""
    per_px = rig.baseline_m / np.maximum(stems.disparity_px, 0.1)
    height = (stems.bottom_px - stems.top_px) * per_px
    base = (ground.row_px(stems.column_px, stems.disparity_px) - stems.bottom_px) * per_px
    width = stems.width_px * per_px
    good = (height >= config.height_min_m) & (base <= config.base_max_m)
    good &= base + height >= 0.4  # kerbs
    good &= (width >= config.width_min_m) & (width <= config.width_max_m)
    good &= (np.abs(np.arctan(stems.slope)) <= config.lean_max_rad) & (height >= 0.8 * width)
    kept = stems.take(good)
    if len(kept) > config.hypotheses_max:
        tallest = np.argsort(-(kept.slices / kept.disparity_px))[: config.hypotheses_max]
        kept = kept.take(np.sort(tallest))
    return kept
