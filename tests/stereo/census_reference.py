"""Census SGM in plain numpy and python loops: slow, short, and what the kernel must equal."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from polemap.stereo.census import census_planes

LARGEST_SUM = 255  # larger sums count as this one, and so does a rival that does not exist
EIGHT = [(0, 1), (0, -1), (1, 0), (-1, 0), (1, 1), (1, -1), (-1, 1), (-1, -1)]


@dataclass
class Settings:
    census: str = "centre5x5"
    bits: int = 8
    smoothing: int = 1  # 0 none, 1 upright, 2 square
    disparities: int = 16
    offset: int = 0
    paths: int = 8
    own_right: bool = False
    p1: int = 7
    across: tuple = (17, 50, 60, 1 << 17)  # p2_min, p2_max, gamma, alpha in 2^-16
    upright: tuple = (20, 90, 100, 1 << 16)
    uniqueness_percent: int = 5
    subpixel: int = 2  # 0 none, 1 parabola, 2 equiangular
    median: bool = False
    tolerance: float = 1.0
    speckle_px: int = 0
    speckle_rows: int = 8
    speckle_step_px: float = 1.0
    outside_cost: int = 12
    cost_weight: int = 8


def gained_bits(s):
    """By how many bits the smoothed grey values are larger than those of the image."""
    return min(2 * s.smoothing, 16 - s.bits)


def smooth(image, s):
    """1-2-1 along columns, and along rows if square, keeping as many bits as 16 allow."""
    shift = 2 * s.smoothing - gained_bits(s)
    out = image.astype(np.int64)
    if s.smoothing >= 1:
        first = shift if s.smoothing == 1 else shift // 2
        padded = np.pad(out, ((1, 1), (0, 0)), mode="edge")
        out = (padded[:-2] + 2 * padded[1:-1] + padded[2:]) >> first
    if s.smoothing == 2:
        padded = np.pad(out, ((0, 0), (1, 1)), mode="edge")
        out = (padded[:, :-2] + 2 * padded[:, 1:-1] + padded[:, 2:]) >> (shift - shift // 2)
    return out.astype(np.uint16)


def cost_volume(left, right, s):
    """`(height, width, disparities)` Hamming distances; `outside_cost` without a partner."""
    bits_left = np.unpackbits(census_planes(left, s.census), axis=0)
    bits_right = np.unpackbits(census_planes(right, s.census), axis=0)
    height, width = left.shape
    cost = np.full((height, width, s.disparities), s.outside_cost, dtype=np.int64)
    for d in range(s.disparities):
        shift = d + s.offset
        if shift < width:
            differ = bits_left[:, :, shift:] != bits_right[:, :, : width - shift]
            cost[:, shift:, d] = differ.sum(axis=0)
    return cost


def aggregate(cost, image, s, searched):
    """Sum of what the path costs of all directions exceed the cost by, and the weighted cost.

    A row searches the first `searched[y]` disparities; of the row before only these count, too, but
    for the least of its path costs.
    """
    height, width, _ = cost.shape
    total = s.cost_weight * cost
    for dv, du in EIGHT[: s.paths]:
        p2_min, p2_max, gamma, alpha_q16 = s.upright if du == 0 else s.across
        alpha_q16 >>= gained_bits(s)
        path = np.zeros_like(cost)
        for y in range(height)[:: -1 if dv < 0 else 1]:
            for x in range(width)[:: -1 if du < 0 else 1]:
                v, u = y - dv, x - du
                if not (0 <= v < height and 0 <= u < width):
                    path[y, x] = cost[y, x]
                    continue
                old = path[v, u].copy()
                least = old[: searched[v]].min()
                old[min(searched[v], searched[y]) :] = 10**6
                step = abs(int(image[y, x]) - int(image[v, u]))
                p2 = min(max(gamma - ((step * alpha_q16) >> 16), p2_min), p2_max)
                far = np.full(1, 10**6)
                below = np.concatenate([far, old[:-1]]) + s.p1
                above = np.concatenate([old[1:], far]) + s.p1
                best = np.minimum(np.minimum(old, below), np.minimum(above, least + p2))
                path[y, x] = cost[y, x] + best - least
        total += path - cost
    return np.minimum(total, LARGEST_SUM)


def winners(lists, s):
    """Disparity, margin and uniqueness of each pixel from `lists[y][x]`: its sums by disparity."""
    height, width = len(lists), len(lists[0])
    disparity = np.full((height, width), np.nan, dtype=np.float32)
    margin = np.zeros((height, width), dtype=np.uint8)
    unique = np.zeros((height, width), dtype=bool)
    for y in range(height):
        for x in range(width):
            sums = lists[y][x]
            if len(sums) == 0:
                continue
            d = int(np.argmin(sums))
            best = int(sums[d])
            rivals = [int(v) for k, v in enumerate(sums) if abs(k - d) > 1]
            second = min(rivals) if rivals else LARGEST_SUM
            unique[y, x] = second * (100 - s.uniqueness_percent) >= best * 100
            if second:
                margin[y, x] = int(np.float32(255 * (second - best)) / np.float32(second))
            fraction = np.float32(0)
            if s.subpixel and 0 < d < len(sums) - 1:
                below, above = int(sums[d - 1]) - best, int(sums[d + 1]) - best
                step, higher = below - above, max(below, above)
                if s.subpixel == 1 and higher > 0:
                    fraction = np.float32(step) / np.float32(2 * (below + above))
                elif higher > 0:
                    bent = step * (27 * higher - 7 * abs(step))
                    fraction = np.float32(bent) / np.float32(40 * higher**2)
            disparity[y, x] = np.float32(d + s.offset) + fraction
    return disparity, margin, unique


def left_lists(total, s, searched):
    height, width, _ = total.shape
    reach = [max(x - s.offset + 1, 0) for x in range(width)]
    return [
        [total[y, x, : min(reach[x], searched[y])] for x in range(width)] for y in range(height)
    ]


def right_lists(total, s, searched):
    height, width, _ = total.shape
    lists = []
    for y in range(height):
        row = []
        for x in range(width):
            reach = min(max(width - x - s.offset, 0), searched[y])
            d = np.arange(reach)
            row.append(total[y, x + d + s.offset, d])
        lists.append(row)
    return lists


def median3(disparity):
    out = disparity.copy()
    height, width = disparity.shape
    for y in range(1, height - 1):
        for x in range(1, width - 1):
            window = disparity[y - 1 : y + 2, x - 1 : x + 2]
            if np.isfinite(window).all():
                out[y, x] = np.sort(window.ravel())[4]
    return out


def check(own, other, unique, sign, tolerance):
    out = np.full_like(own, np.nan)
    height, width = own.shape
    for y in range(height):
        for x in range(width):
            d = own[y, x]
            if not unique[y, x]:
                continue
            if tolerance >= 0:
                partner = x + sign * int(np.floor(d + np.float32(0.5)))
                if not 0 <= partner < width:
                    continue
                if not abs(other[y, partner] - d) <= np.float32(tolerance):
                    continue
            out[y, x] = d
    return out


def without_speckles(disparity, s):
    """Flood fill from each pixel; small and low components become NaN."""
    if s.speckle_px <= 1:
        return disparity
    out = disparity.copy()
    height, width = out.shape
    seen = ~np.isfinite(out)
    for start in np.argwhere(~seen):
        if seen[tuple(start)]:
            continue
        seen[tuple(start)] = True
        component = [tuple(start)]
        for y, x in component:  # grows while it is read
            for v, u in ((y, x - 1), (y, x + 1), (y - 1, x), (y + 1, x)):
                if not (0 <= v < height and 0 <= u < width) or seen[v, u]:
                    continue
                if abs(disparity[v, u] - disparity[y, x]) <= np.float32(s.speckle_step_px):
                    seen[v, u] = True
                    component.append((v, u))
        rows = [y for y, _ in component]
        if len(component) < s.speckle_px and max(rows) - min(rows) + 1 < s.speckle_rows:
            for place in component:
                out[place] = np.nan
    return out


STRIP_ROWS = 32


def strips(height):
    """Slices of rows from the middle outwards, as horizontal paths run side by side."""
    middle = height // 2
    down = [slice(y, min(y + STRIP_ROWS, height)) for y in range(middle, height, STRIP_ROWS)]
    up = [slice(max(y - STRIP_ROWS + 1, 0), y + 1) for y in range(middle - 1, -1, -STRIP_ROWS)]
    return down + up


def searched_rows(left, right, s):
    """How many disparities each row searches: what the pair at an eighth of its size shows."""
    height, width = left.shape
    if s.disparities <= 64 or width < 64 or height < 128:
        return [s.disparities] * height
    left, right = (
        ((image[: height // 4 * 4, : width // 2 * 2].astype(np.int64)
          .reshape(height // 4, 4, width // 2, 2).sum(axis=(1, 3)) + 4) >> 3).astype(image.dtype)
        for image in (left, right)
    )  # fmt: skip
    offset = s.offset // 2
    small = dataclasses.replace(
        s, offset=offset, disparities=(s.offset + s.disparities - 1) // 2 - offset + 1, paths=4,
        own_right=False, subpixel=0, uniqueness_percent=0, median=False, tolerance=1.0,
        speckle_px=25, speckle_rows=4, speckle_step_px=1.0,
    )  # fmt: skip
    seen = match(left, right, small)[0]
    counts = []
    for rows in strips(height):
        strip = seen[rows.start // 4 : (rows.stop - 1) // 4 + 1]
        found = np.sort(strip[np.isfinite(strip)].astype(int))
        nearest = int(found[-6]) if len(found) >= 6 else offset
        count = -((s.offset - 8 - 2 * (nearest + 1)) // 8) * 8
        counts.append((rows, min(max(count, 48), s.disparities)))
    searched = [0] * height
    for rows, _ in counts:
        beside = [c for r, c in counts if r.start <= rows.stop and rows.start <= r.stop]
        searched[rows] = [max(beside)] * (rows.stop - rows.start)
    return searched


def match(left, right, s: Settings, searched=None):
    """`(left, right, left_unchecked, right_unchecked, left_margin, right_margin)`."""
    searched = [s.disparities] * len(left) if searched is None else searched
    left, right = smooth(left, s), smooth(right, s)
    total = aggregate(cost_volume(left, right, s), left, s, searched)
    raw_left, margin_left, unique_left = winners(left_lists(total, s, searched), s)
    if s.own_right:
        one, two = right[:, ::-1], left[:, ::-1]
        total = aggregate(cost_volume(one, two, s), one, s, searched)
        found = winners(left_lists(total, s, searched), s)
        raw_right, margin_right, unique_right = (item[:, ::-1] for item in found)
    else:
        raw_right, margin_right, unique_right = winners(right_lists(total, s, searched), s)
    if s.median:
        raw_left, raw_right = median3(raw_left), median3(raw_right)
    return (
        without_speckles(check(raw_left, raw_right, unique_left, -1, s.tolerance), s),
        without_speckles(check(raw_right, raw_left, unique_right, +1, s.tolerance), s),
        raw_left,
        raw_right,
        margin_left,
        margin_right,
    )
