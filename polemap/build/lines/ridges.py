"""Samples of pieces drawn onto the ridge of their density, so that each line becomes one curve.

A sample moves across its direction only, to the weighted mean of those beside it: mean shift
constrained to the normal, whose resting places are the ridges of the density.

Source: U. Ozertem and D. Erdogmus, Locally Defined Principal Curves and Surfaces, JMLR 12 (2011).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from polemap.build.lines.seen_lines import MapPieces
from polemap.vehicle.pose import wrap_angle

Floats = NDArray[np.float64]
Whole = NDArray[np.int64]

STEP_M = 2.0  # between samples of a piece
ACROSS_M = 0.5  # two lines of a kind that lie closer are one
DIRECTION_RAD = 0.26
_ALONG_M = 1.5
_ROUNDS = 4


@dataclass(frozen=True, slots=True)
class Samples:
    """Points of pieces of one kind, every `STEP_M`.

    Attributes:
        piece: `(n,)` row of the piece.
        seen_m: `(n, 2)` where it was seen.
        points_m: `(n, 2)` on the ridge.
        direction_rad: `(n,)` of the ridge, of which the sense means nothing.
        weight: `(n,)` inverse variance, times what the piece stands for.
    """

    piece: Whole
    seen_m: Floats
    points_m: Floats
    direction_rad: Floats
    weight: Floats


def sample(pieces: MapPieces) -> Samples:
    """Points of all pieces, every `STEP_M` and at least one, drawn onto their ridges."""
    along = pieces.end_m - pieces.start_m
    length = np.hypot(*along.T)
    count = np.maximum(np.ceil(length / STEP_M).astype(np.int64), 1)
    piece = np.repeat(np.arange(len(pieces)), count)
    number = np.arange(len(piece)) - np.repeat(np.cumsum(count) - count, count)
    share = (number + 0.5) / count[piece]
    seen = pieces.start_m[piece] + share[:, None] * along[piece]
    direction = np.arctan2(along[:, 1], along[:, 0])[piece]
    variance = (pieces.sd_m**2 + pieces.shared_sd_m**2)[piece]
    weight = pieces.weight[piece] / variance
    points, direction = _drawn(seen, direction, weight)
    return Samples(piece, seen, points, direction, weight)


def _drawn(points: Floats, direction: Floats, weight: Floats) -> tuple[Floats, Floats]:
    """Points and directions after some rounds of mean shift across."""
    if len(points) < 2:
        return points, direction
    tree = scipy.spatial.KDTree(points)
    pairs = tree.query_pairs(np.hypot(_ALONG_M, ACROSS_M), output_type="ndarray")
    one, two = (np.concatenate([pairs[:, side], pairs[:, 1 - side]]) for side in (0, 1))
    alike = np.abs(wrap_angle(2.0 * (direction[one] - direction[two]))) < 2.0 * DIRECTION_RAD
    one, two = one[alike], two[alike]
    n = len(points)
    for _ in range(_ROUNDS):
        normal = np.column_stack([-np.sin(direction), np.cos(direction)])
        offset = np.einsum("ij,ij->i", points[two] - points[one], normal[one])
        share = np.where(np.abs(offset) < ACROSS_M, weight[two], 0.0)
        total = weight + np.bincount(one, share, n)
        moved = np.bincount(one, share * offset, n) / total
        doubled = np.exp(2j * direction)
        mean = weight * doubled
        mean += np.bincount(one, share * doubled[two].real, n)
        mean += 1j * np.bincount(one, share * doubled[two].imag, n)
        points = points + moved[:, None] * normal
        direction = 0.5 * np.angle(mean)
    return points, direction
