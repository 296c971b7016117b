"""Where a local map lies on another: every place within reach is tried, and weighed as a whole.

A placement d of local map B on A has the log odds

    L(d) = sum over pairs [ log( N(r; 0, S) w / lambda ) ] - misses
           - d' C^-1 d / 2 - log |1 + C H| / 2

against B being elsewhere: pairs of an optimal one-to-one assignment with residual r, w the
likelihood ratio of their widths, lambda the density of poles, one miss for a pole that the other
should have seen, C the covariance of the predicted placement and H the information of the pairs
(the share of the prior that fits as well, Laplace's approximation).

Source: Neira and Tardos, Data association in stochastic mapping using the joint compatibility
test, IEEE TRA 17(6), 2001; Blanco et al., An alternative to the Mahalanobis distance for
determining optimal correspondences in data association, IEEE TRO 28(4), 2012 (matching likelihood).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from polemap.build.slam.submaps import Submap
from polemap.vehicle.kalman import chi_square_gate
from polemap.vehicle.pose import compose, rotate, transform_points

Floats = NDArray[np.float64]
Whole = NDArray[np.int64]

_POINT_SD_M = 0.2  # of a pole in a local map against the same in another
_WIDTH_SD_M, _WIDTH_SPREAD_M = 0.1, 0.25
_DENSITY = 0.01  # poles a square metre where poles stand
_DETECTED = 0.7
_TURN_STEP_RAD = 0.03
_HYPOTHESES = 6  # placements that are refined
_APART_M = 1.5  # placements farther apart are two
_GATE_PROBABILITY = 0.997  # of a true pair


@dataclass(frozen=True, slots=True)
class Placement:
    """One placement of a local map on another.

    Attributes:
        correction: `(3,)` what is added to the predicted pose of B, in A's axes.
        log_odds: L above.
        pairs: `(k, 2)` rows of A and B.
        prior2: squared Mahalanobis distance of the correction from the prediction.
    """

    correction: Floats
    log_odds: float
    pairs: Whole
    prior2: float


def place(a: Submap, b: Submap, predicted: Floats, covariance: Floats) -> list[Placement]:
    """Placements of B on A near the predicted `a_from_b` `(3,)`, the likeliest first.

    Those within the gate of the prediction, and beyond it those that would compete with them.
    """
    points = transform_points(predicted, b.points_m)
    pivot = points.mean(axis=0)
    sd = np.sqrt(np.diag(covariance))
    # the turn acts about the middle of the poles, whose place is uncertain with it
    lever = np.array(
        [
            [1.0, 0.0, -(pivot[1] - predicted[1])],
            [0.0, 1.0, pivot[0] - predicted[0]],
            [0.0, 0.0, 1.0],
        ]
    )
    spread = lever @ covariance @ lever.T
    fits = _alike(a, b)
    if not fits.any():
        return []
    turns = _turns(float(sd[2]))
    i, j = np.nonzero(fits)
    candidates = []
    for turn in turns:
        turned = transform_points(np.array([0.0, 0.0, turn]), points - pivot)
        move = a.points_m[i] - (turned[j] + pivot)
        reach = 3.5 * np.sqrt(np.diag(spread)[:2]) + 1.0
        near = (np.abs(move) <= reach).all(axis=1)
        if near.any():
            candidates.append(np.column_stack([move[near], np.full(np.count_nonzero(near), turn)]))
    if not candidates:
        return []
    moves = np.concatenate(candidates)
    support = _support(a, points - pivot, pivot, moves, fits)
    inverse = np.linalg.inv(spread)
    rank = support * 4.0 - 0.5 * np.einsum("ni,ij,nj->n", moves, inverse, moves)
    found: list[Placement] = []
    tried: list[Floats] = []
    for row in np.argsort(-rank, kind="stable"):
        if any(np.hypot(*(moves[row, :2] - other[:2])) < 0.5 * _APART_M for other in tried):
            continue
        tried.append(moves[row])
        placement = _refine(a, b, points - pivot, pivot, moves[row], spread, inverse, fits)
        if placement is not None and not any(
            np.hypot(*(placement.correction[:2] - other.correction[:2])) < _APART_M
            for other in found
        ):
            found.append(placement)
        if len(tried) >= _HYPOTHESES:
            break
    return sorted(found, key=lambda placement: -placement.log_odds)


def corrected(predicted: Floats, placement: Placement, b: Submap) -> Floats:
    """`a_from_b` `(3,)` after the correction about the middle of B's poles."""
    pivot = transform_points(predicted, b.points_m).mean(axis=0)
    x, y, turn = placement.correction
    about = compose(np.array([*pivot, 0.0]), np.array([0.0, 0.0, turn]))
    moved = compose(about, np.array([*(predicted[:2] - pivot), predicted[2]]))
    return np.asarray(moved + np.array([x, y, 0.0]))


def _turns(sd: float) -> Floats:
    steps = int(np.ceil(3.0 * sd / _TURN_STEP_RAD))
    return np.asarray(_TURN_STEP_RAD * np.arange(-steps, steps + 1), dtype=np.float64)


def _alike(a: Submap, b: Submap) -> NDArray[np.bool_]:
    """Pairs `(n, m)` that kind and width allow, and that are not one landmark already."""
    off = np.abs(a.width_m[:, None] - b.width_m[None, :])
    narrow = ~(off > 4.0 * _WIDTH_SD_M + 0.3 * np.fmax(a.width_m[:, None], b.width_m[None, :]))
    return np.asarray(narrow & (a.kind[:, None] == b.kind[None, :]))


def _support(
    a: Submap, centred: Floats, pivot: Floats, moves: Floats, fits: NDArray[np.bool_]
) -> Floats:
    """How many of B's poles have one of A's near them, for every placement `(h,)`."""
    placed = rotate(centred[None], moves[:, None, 2]) + pivot + moves[:, None, :2]
    squared = np.sum((placed[:, :, None] - a.points_m) ** 2, axis=3)
    squared = np.where(fits.T[None], squared, np.inf)
    return np.asarray(np.exp(-squared.min(axis=2) / (2.0 * 0.4**2)).sum(axis=1))


def _refine(
    a: Submap,
    b: Submap,
    centred: Floats,
    pivot: Floats,
    move: Floats,
    spread: Floats,
    inverse: Floats,
    fits: NDArray[np.bool_],
) -> Placement | None:
    """Assignment and placement in turn, to a fixed point; the log odds of what comes out."""
    gain = _pair_gain(a, b)
    variance, gate = 2.0 * _POINT_SD_M**2, chi_square_gate(_GATE_PROBABILITY, 2)
    pairs = np.empty((0, 2), dtype=np.int64)
    # a window that narrows, so that a start a metre off finds its place
    for widened in (4.0, 2.0, 1.0, 1.0):
        placed = _placed(centred, pivot, move)
        squared = np.sum((a.points_m[:, None] - placed[None]) ** 2, axis=2) / (
            variance * widened**2
        )
        worth = np.where(fits & (squared < gate), gain - 0.5 * squared, 0.0)
        rows, columns = scipy.optimize.linear_sum_assignment(-np.maximum(worth, 0.0))
        good = worth[rows, columns] > 0.0
        pairs = np.column_stack([rows[good], columns[good]]).astype(np.int64)
        if len(pairs) < 2:
            return None
        move, information = _fit(
            a.points_m[pairs[:, 0]], centred[pairs[:, 1]], pivot, move, variance, inverse
        )
    placed = _placed(centred, pivot, move)
    residual = a.points_m[pairs[:, 0]] - placed[pairs[:, 1]]
    worth = gain[pairs[:, 0], pairs[:, 1]] - 0.5 * np.sum(residual**2, axis=1) / variance
    prior2 = float(move @ inverse @ move)
    fitting = 0.5 * float(np.linalg.slogdet(np.eye(3) + spread @ information)[1])
    missed = _missed(a, b, placed, pairs)
    odds = float(worth.sum()) - 0.5 * prior2 - fitting + missed * float(np.log(1.0 - _DETECTED))
    return Placement(move, odds, pairs, prior2)


def _pair_gain(a: Submap, b: Submap) -> Floats:
    """Log of the likelihood ratio `(n, m)` of a pair in the same place, by place and width."""
    variance = 2.0 * _POINT_SD_M**2
    base = np.log(_DETECTED**2 / (2.0 * np.pi * variance * _DENSITY))
    off = a.width_m[:, None] - b.width_m[None, :]
    sd = np.hypot(_WIDTH_SD_M, 0.2 * np.fmax(a.width_m[:, None], b.width_m[None, :]))
    ratio = np.log(_WIDTH_SPREAD_M / sd) - 0.5 * (off / sd) ** 2
    worth = np.where(np.isfinite(ratio), np.clip(ratio, -3.0, 1.0), 0.0)
    return np.asarray(base + worth, dtype=np.float64)


def _placed(centred: Floats, pivot: Floats, move: Floats) -> Floats:
    turned = transform_points(np.array([0.0, 0.0, move[2]]), centred)
    return np.asarray(turned + pivot + move[:2], dtype=np.float64)


def _fit(
    target: Floats, centred: Floats, pivot: Floats, move: Floats, variance: float, inverse: Floats
) -> tuple[Floats, Floats]:
    """Placement by least squares with the prediction as a prior; the information of the pairs."""
    information = np.zeros((3, 3))
    for _ in range(3):
        placed = _placed(centred, pivot, move)
        arm = placed - pivot - move[:2]
        jacobian = np.zeros((len(arm), 2, 3))
        jacobian[:, 0, 0] = jacobian[:, 1, 1] = 1.0
        jacobian[:, 0, 2], jacobian[:, 1, 2] = -arm[:, 1], arm[:, 0]
        information = np.einsum("nki,nkj->ij", jacobian, jacobian) / variance
        slope = np.einsum("nki,nk->i", jacobian, target - placed) / variance
        move = move + np.linalg.solve(information + inverse, slope - inverse @ move)
    return move, information


def _missed(a: Submap, b: Submap, placed: Floats, pairs: Whole) -> int:
    """Poles of B without a partner, well within what both saw."""
    reach = 0.6 * min(a.reach_m, b.reach_m)
    from_a = np.min(np.hypot(*(placed[:, None] - a.way_m[None]).transpose(2, 0, 1)), axis=1)
    alone_b = np.setdiff1d(np.flatnonzero(from_a < reach), pairs[:, 1])
    from_b = np.min(np.hypot(*(b.points_m[:, None] - b.way_m[None]).transpose(2, 0, 1)), axis=1)
    alone_b = alone_b[from_b[alone_b] < reach]
    return len(alone_b)
