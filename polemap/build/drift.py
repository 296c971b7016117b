"""Slow drift of the reference within a drive: traversals of one street that disagree are levelled.

A reference that wanders by half a metre or more in minutes shows the same street twice, apart. Its
error is modelled as a shift that changes along the drive, linear between knots:

    min  sum_pairs rho(|p_i + c(t_i) - p_j - c(t_j)|)
         +  sum_k [ |c_k+1 - c_k|^2 T / (2 sd^2 dt)  +  |c_k|^2 dt / (2 T sd^2) ]

with pairs of landmarks that two traversals made of what may be one pole (mutually nearest), the
last two terms being a random walk that holds on to zero with the time T and the sd of the settings.
The pairs are found again with a radius that shrinks (graduated non-convexity), so that a shift
larger than the distance of neighbouring poles' landmarks is found if most poles agree about it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from polemap.build.config import MappingConfig
from polemap.build.constants import DISPARITY_TRAVERSAL_SD_PX, DRIFT_LEAST_M, TRAVERSAL_GAP_S
from polemap.build.merge import close_pairs, shared_sd
from polemap.build.traversals import TraversalLandmarks

Floats = NDArray[np.float64]
Whole = NDArray[np.int64]

KNOT_S = 10.0
# correlation time of a reference that drifts: uncoupled INS wanders over minutes, and a drive shows
# too few of these to tell 100 s from 200
_DRIFT_TIME_S = 100.0
_RADII_M = (3.0, 2.0, 1.3, 0.9, 0.7, 0.6, 0.6)
_SOFT = 3.0  # of a radius: beyond this share of it a pair loses weight
_LEAST_M = 0.05  # no two traversals agree better than this
_PAIRS_MIN = 20
_EXACT_KNOTS = 4000  # of more the sd is not computed, but taken from the settings


@dataclass(frozen=True, slots=True)
class Drift:
    """Correction of one drive: `move_m` `(k, 2)`, and what it leaves, at `knots_s` `(k,)`."""

    knots_s: Floats
    move_m: Floats
    sd_m: Floats

    def at(self, stamps_s: Floats) -> Floats:
        """Correction `(n, 2)` at stamps."""
        move = [np.interp(stamps_s, self.knots_s, self.move_m[:, axis]) for axis in (0, 1)]
        return np.stack(move, axis=1)

    def sd_at(self, stamps_s: Floats) -> Floats:
        """What it leaves, `(n,)`, an axis."""
        return np.asarray(np.interp(stamps_s, self.knots_s, self.sd_m), dtype=np.float64)

    @property
    def size_m(self) -> float:
        """Root mean square of the correction."""
        return float(np.sqrt(np.mean(np.sum(self.move_m**2, axis=1))))


@dataclass(frozen=True, slots=True)
class _Traversals:
    """Solid landmarks of all drives: their times, drives, and knots with weights `(n, 2)`."""

    points_m: Floats
    variance_m2: Floats
    drive: Whole
    time_s: Floats
    knot: Whole
    share: Floats


def middle_s(landmarks: TraversalLandmarks) -> Floats:
    """When a landmark was seen, `(n,)`: the middle of its traversal."""
    return (landmarks.first_s + landmarks.last_s) / 2.0


def measure_drift(
    drives: Sequence[TraversalLandmarks],
    config: MappingConfig,
    *,
    fixed: TraversalLandmarks | None = None,
    between: bool = False,
) -> list[Drift] | None:
    """How each drive's reference wandered; None where traversals agree well enough.

    Args:
        drives: landmarks of each drive.
        config: settings.
        fixed: landmarks of an old map, which stays where it is.
        between: whether traversals of different drives are laid onto each other too.
    """
    solid = [part for part in drives if len(part)]
    if not solid:
        return None
    parts = [*drives, *([fixed] if fixed is not None and between else [])]
    knots = [_knots(part) for part in drives]
    traversals = _traversals(parts, knots, config)
    if _disagreement(traversals, config, between) < DRIFT_LEAST_M:
        return None
    starts = np.cumsum([0, *(len(k) for k in knots)])
    prior = _prior(knots, config)
    move: Floats = np.zeros((int(starts[-1]), 2))
    information = prior
    for radius in _RADII_M:
        pairs = _pairs(traversals, move, radius, config, between)
        if len(pairs) < _PAIRS_MIN:
            return None
        move, information = _solve(traversals, pairs, move, prior, radius)
    sd = _posterior_sd(information, config)
    return [
        Drift(k, move[a:b], sd[a:b]) for k, a, b in zip(knots, starts, starts[1:], strict=False)
    ]


def _knots(part: TraversalLandmarks) -> Floats:
    if not len(part):
        return np.zeros(1)
    time = middle_s(part)
    count = int(np.ceil((time.max() - time.min()) / KNOT_S)) + 1
    return np.asarray(time.min() + KNOT_S * np.arange(max(count, 1)), dtype=np.float64)


def _traversals(
    parts: Sequence[TraversalLandmarks], knots: Sequence[Floats], config: MappingConfig
) -> _Traversals:
    columns: list[tuple[Floats, Floats, Whole, Floats, Whole, Floats]] = []
    start = 0
    for number, part in enumerate(parts):
        rows = np.flatnonzero(part.observations >= config.observations_min)
        time = middle_s(part)[rows]
        variance = np.trace(part.covariance_m2[rows], axis1=1, axis2=2) / 2.0
        variance = variance + DISPARITY_TRAVERSAL_SD_PX**2 * np.sum(
            part.gain_m_per_px[rows] ** 2, axis=1
        )
        knot = np.full((len(rows), 2), -1, dtype=np.int64)
        share = np.zeros((len(rows), 2))
        if number < len(knots):
            first = np.clip(
                np.floor((time - knots[number][0]) / KNOT_S).astype(np.int64),
                0,
                max(len(knots[number]) - 2, 0),
            )
            second = np.minimum(first + 1, len(knots[number]) - 1)
            share[:, 1] = np.where(second > first, (time - knots[number][first]) / KNOT_S, 0.0)
            share[:, 0] = 1.0 - share[:, 1]
            knot = np.stack([first, second], axis=1) + start
            start += len(knots[number])
        drive = np.full(len(rows), number, dtype=np.int64)
        columns.append((part.points_m[rows], variance, drive, time, knot, share))
    return _Traversals(*(np.concatenate(column) for column in zip(*columns, strict=True)))


def _moves(traversals: _Traversals, move: Floats) -> Floats:
    # landmarks of the old map have no knots and stay
    moved = np.where(traversals.knot[:, :, None] >= 0, move[traversals.knot], 0.0)
    return np.asarray(np.einsum("nk,nkj->nj", traversals.share, moved))


def _pairs(
    traversals: _Traversals, move: Floats, radius_m: float, config: MappingConfig, between: bool
) -> Whole:
    """Pairs `(k, 2)` of landmarks of two traversals, each the nearest of the other's traversal."""
    points = traversals.points_m + _moves(traversals, move)
    pairs = close_pairs(points, radius_m)
    first, second = pairs[:, 0], pairs[:, 1]
    same = traversals.drive[first] == traversals.drive[second]
    cannot_link = np.abs(traversals.time_s[first] - traversals.time_s[second]) > TRAVERSAL_GAP_S
    pairs = pairs[(same & cannot_link) | (~same & between)]
    if not len(pairs):
        return np.empty((0, 2), dtype=np.int64)
    distance = np.hypot(*(points[pairs[:, 0]] - points[pairs[:, 1]]).T)
    slot = np.floor(traversals.time_s / TRAVERSAL_GAP_S).astype(np.int64)
    _, group = np.unique(np.stack([traversals.drive, slot]), axis=1, return_inverse=True)
    group = group.reshape(-1)
    groups = int(group.max()) + 1
    keep = np.ones(len(pairs), dtype=bool)
    for one, other in ((0, 1), (1, 0)):
        code = pairs[:, one] * groups + group[pairs[:, other]]
        order = np.lexsort((distance, code))
        _, nearest = np.unique(code[order], return_index=True)
        mine = np.zeros(len(pairs), dtype=bool)
        mine[order[nearest]] = True
        keep &= mine
    return np.asarray(pairs[keep], dtype=np.int64)


def _disagreement(traversals: _Traversals, config: MappingConfig, between: bool) -> float:
    """The sd an axis by which traversals differ beyond the detector's own error."""
    pairs = _pairs(
        traversals, np.zeros((int(traversals.knot.max(initial=0)) + 1, 2)), 2.0, config, between
    )
    if len(pairs) < _PAIRS_MIN:
        return 0.0
    offset = traversals.points_m[pairs[:, 0]] - traversals.points_m[pairs[:, 1]]
    own = traversals.variance_m2[pairs].sum(axis=1)[:, None, None] * np.eye(2)
    return shared_sd(offset, own, 2.0) / float(np.sqrt(2.0))


def _prior(knots: Sequence[Floats], config: MappingConfig) -> scipy.sparse.csc_matrix:
    """Information of a stationary Gauss-Markov process for each drive, block by block."""
    variance = config.drift_sd_m**2
    step = 2.0 * variance * KNOT_S / _DRIFT_TIME_S
    total = sum(len(k) for k in knots)
    last = np.cumsum([len(k) for k in knots]) - 1
    linked = np.ones(max(total - 1, 0))
    linked[last[:-1]] = 0.0
    main = np.full(total, KNOT_S / (2.0 * _DRIFT_TIME_S * variance))
    main[:-1] += linked / step
    main[1:] += linked / step
    # what the process was before a drive, and became after it
    for end in (last, np.concatenate([[0], last[:-1] + 1])):
        main[end] += 1.0 / (2.0 * variance)
    rows, beside = np.arange(total), np.arange(total - 1)
    value = np.concatenate([main, -linked / step, -linked / step])
    row = np.concatenate([rows, beside, beside + 1])
    column = np.concatenate([rows, beside + 1, beside])
    return scipy.sparse.csc_matrix(
        scipy.sparse.coo_matrix((value, (row, column)), shape=(total, total))
    )


def _solve(
    traversals: _Traversals,
    pairs: Whole,
    move: Floats,
    prior: scipy.sparse.csc_matrix,
    radius_m: float,
) -> tuple[Floats, scipy.sparse.csc_matrix]:
    """Corrections `(knots, 2)` from the pairs, and their information."""
    first, second = pairs[:, 0], pairs[:, 1]
    points = traversals.points_m + _moves(traversals, move)
    length = np.hypot(*(points[first] - points[second]).T)
    scale = radius_m / _SOFT
    variance = traversals.variance_m2[first] + traversals.variance_m2[second] + _LEAST_M**2
    weight = 1.0 / (np.maximum(variance, (scale / 2.0) ** 2) * (1.0 + (length / scale) ** 2))
    rows = np.arange(len(pairs))
    at, column, value = [], [], []
    for side, sign in ((first, 1.0), (second, -1.0)):
        for end in (0, 1):
            known = traversals.knot[side, end] >= 0
            at.append(rows[known])
            column.append(traversals.knot[side, end][known])
            value.append(sign * traversals.share[side, end][known])
    shape = (len(pairs), prior.shape[0])
    design = scipy.sparse.csc_matrix(
        scipy.sparse.coo_matrix(
            (np.concatenate(value), (np.concatenate(at), np.concatenate(column))), shape
        )
    )
    wanted = traversals.points_m[second] - traversals.points_m[first]
    weighted = design.multiply(weight[:, None])
    information = scipy.sparse.csc_matrix(design.T @ weighted + prior)
    right = design.T @ (weight[:, None] * wanted)
    return np.asarray(
        scipy.sparse.linalg.splu(information).solve(right), dtype=np.float64
    ), information


def _posterior_sd(information: scipy.sparse.csc_matrix, config: MappingConfig) -> Floats:
    n = information.shape[0]
    if n > _EXACT_KNOTS:
        return np.full(n, config.drift_sd_m)
    inverse = scipy.sparse.linalg.splu(information).solve(np.eye(n))
    return np.sqrt(np.maximum(np.diagonal(inverse), 0.0))
