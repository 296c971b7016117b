"""Corners of a grid, followed from picture to picture and from the left view to the right one."""

from __future__ import annotations

from typing import cast

import cv2
import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]
Grey = NDArray[np.uint8]

# one corner a cell spreads them over the picture: what is far tells the rotation, what is near
# the translation
CELL_PX = (40, 30)
# of a smallest eigenvalue at half resolution: a step of some ten grey values in two directions
_TEXTURE_MIN = 2e-4
_BORDER_PX = 8
# windows of 11 and 15 px cost more and measured no better
_WINDOW_PX = 9
_LK_STOP = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 10, 0.03)
_LK_EIGENVALUE_MIN = 1e-3
# exposure that changes by less is left to the tracker
_EXPOSURE_FREE = 0.03


def find_corners(picture: Grey, taken_px: Floats) -> Floats:
    """The best corner `(n, 2)` of every cell that holds none of `taken_px` `(m, 2)`.

    The smallest eigenvalue of the structure tensor at half resolution, because the tracker
    places them between pixels anyway.

    Source: Shi, Tomasi, Good features to track, CVPR 1994.
    """
    half = cv2.pyrDown(picture)
    strength = cv2.cornerMinEigenVal(half, 5, ksize=3)
    cell_x, cell_y = CELL_PX[0] // 2, CELL_PX[1] // 2
    rows, columns = half.shape[0] // cell_y, half.shape[1] // cell_x
    if not rows or not columns:
        return np.empty((0, 2))
    blocks = strength[: rows * cell_y, : columns * cell_x]
    by_cell = blocks.reshape(rows, cell_y, columns, cell_x).transpose(0, 2, 1, 3)
    cells = by_cell.reshape(rows * columns, cell_y * cell_x)
    best = cells.argmax(axis=1)
    number = np.arange(rows * columns)
    row, column = divmod(number, columns)
    x = 2.0 * (column * cell_x + best % cell_x)
    y = 2.0 * (row * cell_y + best // cell_x)
    free = np.ones((rows, columns), dtype=bool)
    taken = np.minimum(taken_px // CELL_PX, (columns - 1, rows - 1)).astype(np.int64)
    free[taken[:, 1], taken[:, 0]] = False
    free = free.ravel()
    good = free & (cells[number, best] > _TEXTURE_MIN)
    good &= inside(np.column_stack([x, y]), picture, _BORDER_PX)
    return np.asarray(np.column_stack([x, y])[good])


def thinned(places_px: Floats, variances: Floats) -> NDArray[np.int64]:
    """Rows of the places `(n, 2)` that are the surest of their cell."""
    cells = (places_px // CELL_PX).astype(np.int64)
    surest = np.argsort(variances, kind="stable")
    _, first = np.unique(cells[surest] @ (1, 10_000), return_index=True)
    return np.sort(surest[first])


def inside(points_px: Floats, picture: Grey, border_px: float) -> Bools:
    """Which points `(n, 2)` lie in the picture and off its border."""
    height, width = picture.shape
    x, y = points_px[:, 0], points_px[:, 1]
    return np.asarray(
        (x >= border_px)
        & (x <= width - 1 - border_px)
        & (y >= border_px)
        & (y <= height - 1 - border_px)
    )


def follow(
    before: Grey, after: Grey, points_px: Floats, guess_px: Floats, levels: int
) -> tuple[Floats, Bools]:
    """Where points `(n, 2)` of one picture stand in another one, and which were found.

    Args:
        guess_px: `(n, 2)` where to begin.
        levels: pyramid levels above the picture itself: each doubles how far off a guess may be.

    Source: pyramidal Lucas-Kanade; Bouguet 2000.
    """
    if not len(points_px):
        return np.empty((0, 2)), np.empty(0, dtype=bool)
    start = guess_px.astype(np.float32)
    found, status, _ = cv2.calcOpticalFlowPyrLK(
        before,
        after,
        points_px.astype(np.float32),
        start.copy(),
        winSize=(_WINDOW_PX, _WINDOW_PX),
        maxLevel=levels,
        flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
        criteria=_LK_STOP,
        minEigThreshold=_LK_EIGENVALUE_MIN,
    )
    places = np.asarray(found, dtype=np.float64).reshape(-1, 2)
    good = (np.asarray(status).ravel() > 0) & np.isfinite(places).all(axis=1)
    return places, good & inside(places, after, 3.0)


def eight_bit(picture: NDArray[np.uint8] | NDArray[np.uint16], bits: int) -> Grey:
    """A picture of `bits` bits as 8 bit, which the tracker takes."""
    if picture.dtype == np.uint8:
        return cast(Grey, picture)
    return cast(Grey, cv2.convertScaleAbs(picture, alpha=255.0 / (2**bits - 1)))


def bits_of(picture: NDArray[np.uint8] | NDArray[np.uint16]) -> int:
    """Bits that a camera uses whose picture this is: 8, 10, 12, 14 or 16."""
    used = int(picture.max()).bit_length()
    return min(16, max(8, used + used % 2))


def grey_shares(picture: Grey) -> Floats:
    """Share of the pixels `(256,)` that have each grey value or a lower one."""
    counts = cv2.calcHist([picture[::4, ::4]], [0], None, [256], [0.0, 256.0])
    below = np.cumsum(np.asarray(counts, dtype=np.float64).ravel())
    return np.asarray(below / below[-1])


def same_exposure(picture: Grey, shares: Floats, like: Floats) -> Grey:
    """The picture with the grey values of another one, where they differ by much.

    The tracker takes brightness for constant; an exposure that jumps would stop it. Neighbouring
    pictures show nearly the same, so each grey value goes to the one that as many pixels of the
    other picture lie below; that holds where the sky is burnt out, too.

    Args:
        shares, like: `grey_shares` of this picture and of the other one.
    """
    # area between the two distribution functions: by how much grey values differ in the mean
    if float(np.abs(shares - like).sum()) < 255.0 * _EXPOSURE_FREE:
        return picture
    here, there = (below - 0.5 * np.diff(below, prepend=0.0) for below in (shares, like))
    # values that no pixel has lie between those that some have
    table = np.interp(here, there + 1e-9 * np.arange(256), np.arange(256.0))
    return cast(Grey, cv2.LUT(picture, np.rint(table).astype(np.uint8)))
