"""Slices to pole hypotheses: grouped along an upright line.

Slices above each other form a hypothesis. Hypotheses of one line are joined over gaps (foliage, a
car in front), and the columns of their flanks are sharpened on the image gradient.

Source: S16, section III-A (contours of depth edges grouped to hypotheses).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from polemap.detect.config import DetectionConfig
from polemap.detect.constants import BASE_MAX_M, HYPOTHESES_MAX, LEAN_MAX_RAD
from polemap.detect.ground import Ground
from polemap.detect.slices import Slices
from polemap.drivelog.columns import Columns
from polemap.stereo.rig import StereoRig

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

_LINK_ROWS = 4  # slices are linked over so many looked-at rows
_SUMMED = 5  # values of a slice that are summed over its group at once
_REACH_PX = 3  # and so many columns
_DOWN = np.repeat(np.arange(1, _LINK_ROWS + 1), 2 * _REACH_PX + 1)
_ASIDE = np.tile(np.arange(-_REACH_PX, _REACH_PX + 1), _LINK_ROWS)
_SLICES_MIN = 3  # of a hypothesis


@dataclass(frozen=True, slots=True)
class Hypotheses(Columns):
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


def find_hypotheses(
    slices: Slices, ground: Ground, rig: StereoRig, config: DetectionConfig
) -> Hypotheses:
    """Groups of slices that could be a pole: upright, thin, tall enough, near the ground."""
    if len(slices) == 0:
        return _fit(slices, np.empty(0, dtype=np.int64), 0)
    label, count = _link(slices, rig, config)
    # what has too few slices before outliers are left out has too few after, too
    label, count = _renumber(label, np.bincount(label, minlength=count) >= _SLICES_MIN)
    hypotheses = _fit(slices, label, count)
    tall = (hypotheses.bottom_px - hypotheses.top_px) * rig.baseline_m / hypotheses.disparity_px
    enough = (hypotheses.slices >= _SLICES_MIN) & (tall >= 0.5 * config.height_min_m)
    hypotheses, (label, count) = hypotheses.take(enough), _renumber(label, enough)
    if len(hypotheses) == 0:
        return hypotheses
    merged, count = _join(hypotheses, rig, config)
    label = np.where(label >= 0, merged[label], -1)
    return _keep(_fit(slices, label, count), ground, rig, config)


def _renumber(label: Ints, keep: NDArray[np.bool_]) -> tuple[Ints, int]:
    """Labels without the groups that are not kept; their members get -1."""
    number = np.where(keep, np.cumsum(keep) - 1, -1)
    number = np.append(number, -1)  # what -1 points to
    return number[label], int(np.count_nonzero(keep))


def _link(slices: Slices, rig: StereoRig, config: DetectionConfig) -> tuple[Ints, int]:
    """Components of slices that follow each other in neighbouring rows."""
    n = len(slices)
    row = (slices.row_px / config.row_step_px).astype(np.int64)
    row -= row.min()
    centre = 0.5 * (slices.left_px + slices.right_px)
    column = np.round(centre).astype(np.int64) + _REACH_PX
    stride = rig.width_px + 2 * _REACH_PX + 2
    cells = np.full((int(row.max()) + _LINK_ROWS + 1) * stride, -1, dtype=np.int32)
    at = row * stride + column
    cells[at] = np.arange(n)
    other = cells.take(at[:, None] + (_DOWN * stride + _ASIDE)).ravel()
    hit = np.flatnonzero(other >= 0)
    one, two = hit // len(_DOWN), other.take(hit).astype(np.int64)
    width = slices.right_px - slices.left_px + 1.0
    d1, d2, w1, w2 = (v.take(i) for v in (slices.disparity_px, width) for i in (one, two))
    alike = np.abs(d1 - d2) <= 0.75 + 0.03 * d1
    alike &= np.maximum(w1, w2) <= 1.5 * np.minimum(w1, w2) + 2.0
    return components(n, one[alike], two[alike])


class _GroupSums:
    """Sums over groups of slices, each with the weight that the slice has at the time."""

    def __init__(self, label: Ints, count: int) -> None:
        self.label, self.count = label, count
        self.weight = np.ones(len(label))
        self._place = (label + count * np.arange(_SUMMED)[:, None]).ravel()

    def totals(self, values: Floats) -> Floats:
        """Weighted sums of `(k, n)` over every group, `(k, count)`, in a single pass."""
        k = len(values)
        weighted = (values * self.weight).ravel()
        place = self._place[: k * len(self.label)]
        sums = np.bincount(place, weights=weighted, minlength=k * self.count)
        return sums.astype(np.float64, copy=False).reshape(k, self.count)


def _fit(slices: Slices, label: Ints, count: int) -> Hypotheses:
    """Line, width and scatter of every group; slices with label -1 are left out."""
    used = np.flatnonzero(label >= 0)
    label = label[used]
    row, left, right = slices.row_px[used], slices.left_px[used], slices.right_px[used]
    groups = _GroupSums(label, count)
    values = [row, 0.5 * (left + right), right - left + 1.0, slices.disparity_px[used]]
    means, slope, sd = _robust_lines(groups, *values)
    n, row0, column0, mean_width, mean_disparity = means
    bottom, top = np.full(count, -np.inf), np.full(count, np.inf)
    inside = np.flatnonzero(groups.weight)
    np.maximum.at(bottom, label[inside], row[inside])
    np.minimum.at(top, label[inside], row[inside])
    sides = [slices.far_left_px, slices.far_right_px]
    sides += [slices.occluding_left, slices.occluding_right]
    beside = np.concatenate([side[used] for side in sides]).reshape(4, len(used))
    far_left, far_right, occluding_left, occluding_right = groups.totals(beside) / n
    return Hypotheses(
        column_px=column0,
        row_px=row0,
        slope=slope,
        width_px=mean_width,
        top_px=top,
        bottom_px=bottom,
        disparity_px=mean_disparity,
        slices=n,
        centre_sd_px=sd[0],
        width_sd_px=sd[1],
        disparity_sd_px=sd[2],
        far_left_px=far_left,
        far_right_px=far_right,
        occluding_left=occluding_left,
        occluding_right=occluding_right,
    )


def _robust_lines(
    groups: _GroupSums, row: Floats, centre: Floats, width: Floats, disparity: Floats
) -> tuple[tuple[Floats, ...], Floats, Floats]:
    """A line through the centres of every group in three sweeps; outliers lose their weight.

    Returns:
        Number of slices and means of row, centre, width and disparity, each `(count,)`; slope
        `(count,)`, columns a row; standard deviations of centre, width and disparity `(3, count)`.
    """
    label, n_used = groups.label, len(groups.label)
    plain = np.concatenate([groups.weight, row, centre, width, disparity]).reshape(5, n_used)
    moments, off = np.empty((2, n_used)), np.empty((3, n_used))
    for sweep in range(3):
        sums = groups.totals(plain)
        n = np.maximum(sums[0], 1.0)
        row0, column0, mean_width, mean_disparity = sums[1:] / n
        dv = row - row0[label]
        np.multiply(dv, dv, out=moments[0])
        np.multiply(dv, centre, out=moments[1])
        spread, slope = groups.totals(moments)
        slope = slope / np.maximum(spread, 1.0)
        # a short hypothesis says little about its lean: the upright prior shrinks the slope
        slope = slope * spread / (spread + 200.0)
        np.subtract(centre - column0[label], slope[label] * dv, out=off[0])
        np.subtract(width, mean_width[label], out=off[1])
        np.subtract(disparity, mean_disparity[label], out=off[2])
        sd = np.sqrt(groups.totals(off * off) / n)
        if sweep < 2:
            limit = 2.0 * sd[:2] + 0.6
            inlier = np.abs(off[0]) <= limit[0].take(label)
            inlier &= np.abs(off[1]) <= limit[1].take(label)
            groups.weight = inlier.astype(np.float64)
    return (n, row0, column0, mean_width, mean_disparity), slope, sd


def _join(hypotheses: Hypotheses, rig: StereoRig, config: DetectionConfig) -> tuple[Ints, int]:
    """Components of hypotheses that continue each other over a gap: one line, depth and width."""
    lower = hypotheses.row_px[:, None] < hypotheses.row_px[None, :]
    gap_m = np.maximum(
        hypotheses.top_px[None, :] - hypotheses.bottom_px[:, None],
        0.0,
    ) * (rig.baseline_m / hypotheses.disparity_px[:, None])
    # both centre lines, and a plain vertical, are extended to the other's centre
    down = hypotheses.row_px[None, :] - hypotheses.row_px[:, None]
    across = hypotheses.column_px[None, :] - hypotheses.column_px[:, None]
    slope = (
        hypotheses.slope[:, None] * hypotheses.slices[:, None]
        + hypotheses.slope[None, :] * hypotheses.slices[None, :]
    ) / (hypotheses.slices[:, None] + hypotheses.slices[None, :])
    miss = np.abs(across - slope * down)
    scale = 1.5 + 0.15 * 0.5 * (hypotheses.width_px[:, None] + hypotheses.width_px[None, :])
    alike = np.abs(hypotheses.disparity_px[:, None] - hypotheses.disparity_px[None, :]) <= (
        0.6 + 0.025 * hypotheses.disparity_px[:, None]
    )
    wide = np.maximum(hypotheses.width_px[:, None], hypotheses.width_px[None, :])
    thin = np.minimum(hypotheses.width_px[:, None], hypotheses.width_px[None, :])
    link = lower & alike & (miss <= scale) & (gap_m <= 1.5) & (wide <= 1.6 * thin + 1.5)
    return components(len(hypotheses), *np.nonzero(link))


def _keep(
    hypotheses: Hypotheses, ground: Ground, rig: StereoRig, config: DetectionConfig
) -> Hypotheses:
    """Drop what cannot be a pole: too short, too wide, too high above the ground, leaning."""
    per_px = rig.baseline_m / np.maximum(hypotheses.disparity_px, 0.1)
    height = (hypotheses.bottom_px - hypotheses.top_px) * per_px
    base = (
        ground.row_px(hypotheses.column_px, hypotheses.disparity_px) - hypotheses.bottom_px
    ) * per_px
    width = hypotheses.width_px * per_px
    good = (height >= config.height_min_m) & (base <= BASE_MAX_M)
    good &= base + height >= 0.4  # kerbs
    good &= (width >= config.width_min_m) & (width <= config.width_max_m)
    good &= (np.abs(np.arctan(hypotheses.slope)) <= LEAN_MAX_RAD) & (height >= 0.8 * width)
    kept = hypotheses.take(good)
    if len(kept) > HYPOTHESES_MAX:
        tallest = np.argsort(-(kept.slices / kept.disparity_px))[:HYPOTHESES_MAX]
        kept = kept.take(np.sort(tallest))
    return kept


def components(n: int, one: Ints, two: Ints) -> tuple[Ints, int]:
    """Components of the links `one[i] - two[i]` between n nodes: labels `(n,)` and their number.

    Labels follow each component's first node. Every node points to a node before it or to itself;
    where the ends of a link lead to different roots, the later root is pointed to the earlier
    one. scipy gives the same labels, but needs longer to take in a graph of a thousand nodes than
    this needs for all of it.

    Source: Y. Shiloach, U. Vishkin, An O(log n) parallel connectivity algorithm, J. Algorithms
    3(1), 1982: hooking and shortcutting.
    """
    nodes = np.arange(n)
    root = nodes.copy()
    while len(one):
        a, b = root[one], root[two]
        differ = a != b
        one, two, a, b = one[differ], two[differ], a[differ], b[differ]
        root[np.maximum(a, b)] = np.minimum(a, b)
        above = root[root]
        while not np.array_equal(above, root):
            root, above = above, above[above]
    first = root == nodes
    number = np.cumsum(first)
    return (number - 1)[root], int(number[-1]) if n else 0
