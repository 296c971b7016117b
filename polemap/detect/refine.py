"""The disparity of a whole pole, straight from the two images.

A dense matcher looks at every pixel for itself; its values at thin things lean towards the
background and towards whole pixels. A pole is one surface at one disparity: the columns between
and on its flanks, over all its rows, are fitted to the right image at once, with gain and offset of
the cameras as unknowns, by Gauss-Newton with robust weights.

Source: B. Lucas, T. Kanade, IJCAI 1981, for the iteration; here with a single unknown shift.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.samples import Image

Floats = NDArray[np.float64]
Whole = NDArray[np.int64]

_ROWS = 28
_COLUMNS = 11
_ACROSS = np.linspace(0.0, 1.0, _COLUMNS)
_BESIDE_PX = 0.7  # the flanks themselves say most
_SWEEPS = 4
_REACH_PX = 1.6  # farther from the matcher's value the fit is not believed
_STEP_PX = 0.8
_CORRELATION_MIN = 0.7
_QUANTISATION_GREY = 0.29  # of whole grey levels: no picture is more exact
_NEIGHBOURS = 6.0  # so many samples share an error: blur, and columns taken twice


@dataclass(frozen=True, slots=True)
class Fit:
    """Disparity, its standard deviation (NaN where not trusted), and whether to believe it."""

    disparity_px: Floats
    sd_px: Floats
    trusted: NDArray[np.bool_]


def refine_disparity(
    left: Image,
    right: Image,
    left_px: Floats,
    right_px: Floats,
    top_px: Floats,
    bottom_px: Floats,
    slope: Floats,
    disparity_px: Floats,
) -> Fit:
    """Fit the disparity of every pole; arrays are `(n,)`.

    Args:
        left, right: the rectified pair.
        left_px, right_px: flanks at mid height.
        top_px, bottom_px: rows between which the pole is seen.
        slope: columns a row.
        disparity_px: where to begin, and what stays where the fit fails.
    """
    count = len(disparity_px)
    if not count:
        return Fit(disparity_px, np.empty(0), np.empty(0, dtype=bool))
    height, width = left.shape
    u, v = _pixels(left_px, right_px, top_px, bottom_px, slope, height)
    inside = (u >= 0) & (u < width)
    at = np.minimum(np.maximum(u, 0), width - 1)
    grey = _Smooth(left, v, int(at.min()), int(at.max())).grey(at)
    two = _reachable(right, v, u - disparity_px[:, None])
    shift, gain, offset = disparity_px.astype(np.float64), np.ones(count), np.zeros(count)
    # three columns of the design and the residual: one product gives both sides of the equations
    design = np.ones((count, 4, u.shape[1]))
    for _ in range(_SWEEPS):
        good, other, rise = _partners(two, u - shift[:, None], width)
        residual = grey - gain[:, None] * other - offset[:, None]
        weight = (inside & good) / _doubt(residual)
        np.multiply(-gain[:, None], rise, out=design[:, 0])  # right column is u minus disparity
        design[:, 1] = other
        design[:, 3] = residual
        step, normal = _solved(design, weight)
        shift = shift + np.minimum(np.maximum(step[:, 0], -_STEP_PX), _STEP_PX)
        gain, offset = gain + step[:, 1], offset + step[:, 2]
    sd, explained = _quality(grey, residual, weight, normal)
    trusted = (np.abs(shift - disparity_px) <= _REACH_PX) & (explained >= _CORRELATION_MIN**2)
    trusted &= (gain > 0.4) & (gain < 2.5) & (sd < 0.5) & np.isfinite(shift) & (shift > 0.5)
    return Fit(np.where(trusted, shift, disparity_px), np.where(trusted, sd, np.nan), trusted)


def _pixels(
    left_px: Floats,
    right_px: Floats,
    top_px: Floats,
    bottom_px: Floats,
    slope: Floats,
    height_px: int,
) -> tuple[Whole, Whole]:
    """Columns and rows `(n, k)` of the pixels that are fitted; rows are kept in the image."""
    share = (np.arange(_ROWS) + 0.5) / _ROWS
    rows = np.rint(top_px[:, None] + (bottom_px - top_px)[:, None] * share)
    middle = 0.5 * (top_px + bottom_px)
    first, last = left_px - _BESIDE_PX, right_px + _BESIDE_PX
    columns = first[:, None] + (last - first)[:, None] * _ACROSS
    lean = slope[:, None] * (rows - middle[:, None])
    u = np.rint(columns[:, None, :] + lean[:, :, None]).astype(np.int64)
    v = np.minimum(np.maximum(rows, 0), height_px - 1).astype(np.int64)
    return u.reshape(len(u), -1), np.repeat(v, _COLUMNS, axis=1)


def _reachable(right: Image, v: Whole, begin_px: Floats) -> _Smooth:
    """The right image where the fit may go to: as far as its steps allow, and not out of it."""
    reach = (_SWEEPS - 1) * _STEP_PX + 1.0
    ends = np.floor([begin_px.min() - reach, begin_px.max() + reach])
    low, high = np.minimum(np.maximum(ends, 1), right.shape[1] - 3).astype(np.int64).tolist()
    return _Smooth(right, v, low, high + 1)


def _partners(
    two: _Smooth, position_px: Floats, width_px: int
) -> tuple[NDArray[np.bool_], Floats, Floats]:
    """Whether columns `(n, k)` lie in the right image, its grey there, and that one's slope."""
    base_px = np.floor(position_px)
    part = position_px - base_px
    base = base_px.astype(np.int64)
    good = (base >= 1) & (base < width_px - 2)
    base = np.minimum(np.maximum(base, 1), width_px - 3)
    before = two.grey(base)
    rise = two.grey(base + 1) - before
    return good, before + part * rise, rise


def _doubt(residual: Floats) -> Floats:
    """What the weights `(n, k)` are divided by: 1 plus the square against the pole's own spread."""
    ordered, half = np.sort(np.abs(residual), axis=1), residual.shape[1] // 2
    spread = 1.4826 * (0.5 * (ordered[:, half - 1] + ordered[:, half])) + 0.3
    return np.asarray(1.0 + (residual / (2.0 * spread[:, None])) ** 2)


def _solved(design: Floats, weight: Floats) -> tuple[Floats, Floats]:
    """The step `(n, 3)` in disparity, gain and offset, and the normal matrix `(n, 3, 3)`."""
    sums = (design[:, :3] * weight[:, None]) @ np.swapaxes(design, 1, 2)
    normal = sums[:, :, :3]
    scale = normal[:, 0, 0] + normal[:, 1, 1] + normal[:, 2, 2]
    # a pole whose partner lies outside the right image has no equation at all
    normal = normal + (1e-9 * scale + 1e-12)[:, None, None] * np.eye(3)
    return np.asarray(np.linalg.solve(normal, sums[:, :, 3:])[:, :, 0], np.float64), normal


def _quality(
    grey: Floats, residual: Floats, weight: Floats, normal: Floats
) -> tuple[Floats, Floats]:
    """Standard deviation of the disparity, and the share of the grey that is explained, `(n,)`."""
    total = np.maximum(weight.sum(axis=1), 1.0)
    noise = np.sqrt((weight * residual**2).sum(axis=1) / total + _QUANTISATION_GREY**2)
    curvature = 1.0 / np.maximum(np.linalg.inv(normal)[:, 0, 0], 1e-12)
    mean = (weight * grey).sum(axis=1) / total
    variance = (weight * (grey - mean[:, None]) ** 2).sum(axis=1) / total
    explained = 1.0 - noise**2 / np.maximum(variance, 1e-9)
    return np.sqrt(_NEIGHBOURS) * noise / np.sqrt(curvature), explained


class _Smooth:
    """The part of an image in which all poles lie, smoothed; the whole would take twice as long."""

    def __init__(self, image: Image, rows: Whole, first: int, last: int) -> None:
        top, left = max(int(rows.min()) - 1, 0), max(first - 1, 0)  # a pixel more for the smoothing
        part = image[top : int(rows.max()) + 2, left : last + 2]
        self._values = cv2.GaussianBlur(part, (3, 3), 0.8).ravel()
        self._begin = (rows - top) * part.shape[1] - left

    def grey(self, columns: Whole) -> Floats:
        """Grey values in the given image columns, one for every row."""
        return np.asarray(self._values.take(self._begin + columns), dtype=np.float64)
