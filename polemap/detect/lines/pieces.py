"""Straight pieces of a few metres among points that lie along the road, by a Hough transform.

Every point votes, in the windows of distance that hold it, for the lines y = a + m x through it;
the cells with most votes are fitted by least squares, and what a piece took is gone for the others.
So no stretch of a line comes twice.

Source: R. Duda, P. Hart, Use of the Hough transformation to detect lines and curves in pictures,
CACM 15(1), 1972; here in slope and offset, since lines along the road are never steep.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from polemap.detect.lines.road_frame import ASIDE_M, FAR_M, NEAR_M, ROWS, STEP_AHEAD_M
from polemap.extras import kernel

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

WINDOW_M = 6.0
LEAST_ROWS = 6  # of the image or map, that show a piece
GAP_M = 1.0  # a longer one ends a piece

_SLOPE_MAX = 0.4
_SLOPES = np.linspace(-_SLOPE_MAX, _SLOPE_MAX, 17)
_BIN_M = 0.12
_BINS = int(2.0 * (ASIDE_M + 2.0) / _BIN_M)
_STRIDE_M = 0.5 * WINDOW_M
_WINDOWS = int(np.ceil((FAR_M - NEAR_M) / _STRIDE_M))
_TAKE_M = 0.15
CLEAR_M = 0.25  # two lines that are nearer than this are one, or a double one
_NEIGHBOURS = np.ones((3, 5), np.uint8)
_TRIES = 32  # bounds the time of a frame
_PROMISING = 1.1  # with what lies behind a gap a piece may scatter a little more


@dataclass(frozen=True, slots=True)
class PieceRules:
    """What a piece has to be.

    Attributes:
        length_m: at least.
        share: of its rows that show it, at least.
        rms_m: of its points, at most.
    """

    length_m: float
    share: float
    rms_m: float

    @property
    def rows(self) -> int:
        """Of the grid, that the least length covers."""
        return round(self.length_m / STEP_AHEAD_M)

    @property
    def points(self) -> int:
        """At least so many."""
        return int(self.share * self.length_m / STEP_AHEAD_M)

    def settings(self) -> dict[str, float]:
        """All that the kernel has to know."""
        return {
            "near_m": NEAR_M, "step_ahead_m": STEP_AHEAD_M, "aside_m": ASIDE_M, "bin_m": _BIN_M,
            "window_m": WINDOW_M, "take_m": _TAKE_M, "clear_m": CLEAR_M, "gap_m": GAP_M,
            "rms_max_m": self.rms_m, "least_length_m": self.length_m, "least_share": self.share,
            "promising": _PROMISING, "slope_max": _SLOPE_MAX, "rows": ROWS, "windows": _WINDOWS,
            "bins": _BINS, "slopes": len(_SLOPES), "tries": _TRIES, "least_points": self.points,
            "least_rows": LEAST_ROWS, "shortest": self.rows,
        }  # fmt: skip


PLAIN = PieceRules(2.4, 0.7, 0.06)
# what is left of a dash at the picture's lower rim: only where it is clear
SHORT = PieceRules(1.6, 0.85, 0.025)


@dataclass(frozen=True, slots=True)
class Piece:
    """y = offset + slope (x - middle) from `start_m` to `end_m` of x, road frame.

    Attributes:
        rms_m: of its points.
        share: of its rows that have a point.
        rows: of the image or map that showed it.
        members: `(n,)` rows of the points.
    """

    middle_m: float
    offset_m: float
    slope: float
    start_m: float
    end_m: float
    rms_m: float
    share: float
    rows: int
    members: Ints

    @property
    def length_m(self) -> float:
        """Of its projection on x, which it is nearly parallel to."""
        return self.end_m - self.start_m

    def at(self, x_m: float) -> float:
        """Its y at x."""
        return self.offset_m + self.slope * (x_m - self.middle_m)


def straight_pieces(points_m: Floats, source_row: Ints, rules: PieceRules = PLAIN) -> list[Piece]:
    """Pieces among points `(n, 2)` of the road frame, those with most points first.

    `source_row` `(n,)` is the row of the image or map that showed each: rows of the grid that share
    one say nothing twice. The C++ kernel does the work where it was built.
    """
    if len(points_m) < LEAST_ROWS:
        return []
    native = kernel("polemap.detect.native.pieces_kernel")
    if native is None:
        return plain_pieces(points_m, source_row, rules)
    found = native.straight_pieces(points_m, source_row, rules.settings())
    return [Piece(*values) for values in found]


def plain_pieces(points_m: Floats, source_row: Ints, rules: PieceRules = PLAIN) -> list[Piece]:
    """`straight_pieces` in plain numpy, the tests' oracle."""
    x, y = points_m.T
    votes, middle = _vote(x, y)
    peaks = (votes == cv2.dilate(votes, _NEIGHBOURS)) & (votes >= 0.8 * rules.points)
    slope_at, cell = np.nonzero(peaks)
    best = np.argsort(-votes[slope_at, cell], kind="stable")[:_TRIES]
    best = best[_promising(x, y, slope_at[best], cell[best], middle, rules)]
    found: list[Piece] = []
    free = np.ones(len(x), dtype=bool)
    for s, at in zip(slope_at[best].tolist(), cell[best].tolist(), strict=True):
        k, b = divmod(at, _BINS)
        ahead = x - middle[k]
        # a line between two bins voted for both
        off = y - (b + 1.0) * _BIN_M + ASIDE_M + 2.0 - _SLOPES[s] * ahead
        near = free & (np.abs(ahead) <= 0.5 * WINDOW_M) & (np.abs(off) < _TAKE_M)
        piece = _fit(x, y, source_row, np.flatnonzero(near), rules)
        if piece is None:
            continue
        found.append(piece)
        along = (x >= piece.start_m - 0.5) & (x <= piece.end_m + 0.5)
        free &= ~(
            along & (np.abs(y - piece.offset_m - piece.slope * (x - piece.middle_m)) < CLEAR_M)
        )
    return found


def _promising(
    x: Floats, y: Floats, slope_at: Ints, cell: Ints, middle: Floats, rules: PieceRules
) -> Ints:
    """Which peaks of the votes a straight line explains, all at once: most are scattered points."""
    window, bins = np.divmod(cell, _BINS)
    ahead = x - middle[window][:, np.newaxis]
    start = (bins + 1.0) * _BIN_M - ASIDE_M - 2.0
    off = y - start[:, np.newaxis] - _SLOPES[slope_at][:, np.newaxis] * ahead
    take = ((np.abs(ahead) <= 0.5 * WINDOW_M) & (np.abs(off) < _TAKE_M)).astype(np.float64)
    rms = np.zeros((len(cell), 1))
    for last in (False, True):
        count = np.maximum(take.sum(axis=1), 1.0)
        mean_u, mean_v = (take * ahead).sum(axis=1) / count, (take * off).sum(axis=1) / count
        u, v = ahead - mean_u[:, np.newaxis], off - mean_v[:, np.newaxis]
        slope = (take * u * v).sum(axis=1) / np.maximum((take * u * u).sum(axis=1), 1e-6)
        v -= slope[:, np.newaxis] * u
        rms = np.sqrt((take * v * v).sum(axis=1) / count)
        if not last:
            take *= np.abs(v) <= np.maximum(2.5 * rms, 0.04)[:, np.newaxis]
    # some stretch of the least length shows it in most of its rows
    row = np.clip(np.rint((x - NEAR_M) / STEP_AHEAD_M), 0, ROWS - 1).astype(np.int64)
    shown = np.zeros((len(x), ROWS))
    shown[np.arange(len(x)), row] = 1.0
    so_far = np.minimum(take @ shown, 1.0).cumsum(axis=1)
    dense = (so_far[:, rules.rows :] - so_far[:, : -rules.rows]).max(axis=1) >= rules.points
    return np.flatnonzero((rms <= _PROMISING * rules.rms_m) & dense)


def _vote(x: Floats, y: Floats) -> tuple[NDArray[np.float32], Floats]:
    """Votes `(slopes, windows x bins)`, and the middles of the windows, which overlap by half."""
    middle = NEAR_M + _STRIDE_M * (np.arange(_WINDOWS) + 1.0)
    last = np.minimum(((x - NEAR_M) / _STRIDE_M).astype(np.int64), _WINDOWS - 1)
    window = np.concatenate([last, np.maximum(last - 1, 0)])
    offset = np.tile(y, 2) - np.multiply.outer(_SLOPES, np.tile(x, 2) - middle[window])
    bins = ((offset + ASIDE_M + 2.0) / _BIN_M).astype(np.int64)
    cell = np.clip(bins, 0, _BINS - 1) + _BINS * window
    cell += _WINDOWS * _BINS * np.arange(len(_SLOPES))[:, np.newaxis]
    counts = np.bincount(cell.ravel(), minlength=len(_SLOPES) * _WINDOWS * _BINS)
    votes: NDArray[np.float32] = counts.reshape(len(_SLOPES), -1).astype(np.float32)
    votes[:, :-1] += votes[:, 1:].copy()
    return votes, np.asarray(middle, dtype=np.float64)


def _fit(x: Floats, y: Floats, source_row: Ints, members: Ints, rules: PieceRules) -> Piece | None:
    """Least squares over the longest run without a gap; points far off are left out once."""
    slope = offset = middle = 0.0
    for limit in (0.0, 2.5):
        if len(members) < rules.points:
            return None
        if limit:
            off = y[members] - offset - slope * (x[members] - middle)
            rms = float(np.sqrt(np.mean(off * off)))
            members = _longest_run(x, members[np.abs(off) <= max(limit * rms, 0.04)])
            if len(members) < rules.points:
                return None
        middle = float(x[members].mean())
        u = x[members] - middle
        spread = float(u @ u)
        if spread <= 0.0:
            return None
        offset = float(y[members].mean())
        slope = float(u @ y[members]) / spread
    off = y[members] - offset - slope * (x[members] - middle)
    rms = float(np.sqrt(np.mean(off * off)))
    start, end = float(x[members].min()), float(x[members].max())
    rows = len(np.unique(np.rint(x[members] / STEP_AHEAD_M)))
    share = min(rows / ((end - start) / STEP_AHEAD_M + 1.0), 1.0)
    long_enough = end - start >= rules.length_m
    seen = len(np.unique(source_row[members]))
    if (
        seen < LEAST_ROWS
        or not long_enough
        or rms > rules.rms_m
        or share < rules.share
        or abs(slope) > 0.5
    ):
        return None
    return Piece(middle, offset, slope, start, end, rms, share, seen, members)


def _longest_run(x: Floats, members: Ints) -> Ints:
    """Members between two gaps, those that reach over the longest way."""
    order = members[np.argsort(x[members], kind="stable")]
    if not len(order):
        return order
    cuts = np.flatnonzero(np.diff(x[order]) > GAP_M) + 1
    runs = np.split(order, cuts)
    return max(runs, key=lambda run: float(x[run[-1]] - x[run[0]]))
