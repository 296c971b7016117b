"""Triangles of poles in a form that does not depend on where they stand or how they are turned.

A triangle is told by the lengths of its sides, counter-clockwise, the longest first: congruent
triangles have the same three numbers, mirror images have the last two exchanged. It leads from its
first corner along the longest side; corner and direction of two congruent triangles fix the motion
that lays one onto the other. Lengths are quantised to `QUANTUM_M` and packed into one key.

Source: Wolfson, Rigoutsos, Geometric hashing: an overview, IEEE Computational Science and
Engineering 4(4), 1997; pole patterns as places: Brenner, Vehicle localization using landmarks
obtained by a LIDAR mobile mapping system, PCV 2010.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
import scipy
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Whole = NDArray[np.int64]

QUANTUM_M = 0.25
REACH_M = 30.0
"""From a pole to the neighbours with which it forms triangles."""
SHORTEST_M = 2.0
"""Of a side: nearer poles are hardly told apart."""
LONGEST_LEAST_M = 6.0
"""Of the longest side: a shorter one tells no direction."""
BITS = 7
"""Of a quantised length."""
LONGEST_MOST_M = QUANTUM_M * (2**BITS - 1)


@dataclass(frozen=True, slots=True)
class Triangles:
    """Triangles in their standard form.

    Attributes:
        corners: `(n, 3)` rows of their poles, counter-clockwise from the begin of the longest side.
        sides_m: `(n, 3)` from each corner to the next.
        direction_rad: `(n,)` of the longest side.
    """

    corners: Whole
    sides_m: Floats
    direction_rad: Floats

    def __len__(self) -> int:
        return len(self.corners)

    def take(self, rows: NDArray[np.bool_] | Whole) -> Triangles:
        """Some of them."""
        return Triangles(self.corners[rows], self.sides_m[rows], self.direction_rad[rows])


def neighbour_triples(points_m: Floats, neighbours: int, bases: Whole | None = None) -> Whole:
    """Rows `(n, 3)`, ascending and each triple once, of poles and two of their nearest neighbours.

    Args:
        points_m: `(m, 2)`.
        neighbours: of each pole, within `REACH_M`, of which pairs are taken.
        bases: poles whose neighbours are taken; all by default.
    """
    if len(points_m) < 3:
        return np.empty((0, 3), dtype=np.int64)
    if bases is None:
        bases = np.arange(len(points_m))
    reach, rows = scipy.spatial.KDTree(points_m).query(
        points_m[bases], k=min(neighbours + 1, len(points_m)), distance_upper_bound=REACH_M
    )
    distance, near = np.asarray(reach), np.asarray(rows, dtype=np.int64)
    first, second = _pairs(near.shape[1] - 1)
    # the nearest is the pole itself; of poles in one place any, and a side of no length goes later
    triples = np.stack(
        np.broadcast_arrays(bases[:, np.newaxis], near[:, 1 + first], near[:, 1 + second]), axis=-1
    )
    found = np.isfinite(distance)
    triples = triples[found[:, 1 + first] & found[:, 1 + second]]
    triples = np.sort(triples, axis=1)
    distinct = (np.diff(triples, axis=1) > 0).all(axis=1)
    return _each_once(triples[distinct], len(points_m))


def _pairs(count: int) -> tuple[Whole, Whole]:
    """The smaller and the greater of all pairs of so many numbers."""
    pairs = np.array(list(combinations(range(count), 2)), dtype=np.int64).reshape(-1, 2)
    return pairs[:, 0], pairs[:, 1]


def _each_once(triples: Whole, count: int) -> Whole:
    """Rows without repeats, sorted."""
    if count >= 2_000_000:  # three of them do not fit into 63 bits
        return np.unique(triples, axis=0)
    packed = (triples[:, 0] * count + triples[:, 1]) * count + triples[:, 2]
    packed.sort()
    packed = packed[np.diff(packed, prepend=-1) != 0]
    rest, third = packed // count, packed % count
    return np.stack([rest // count, rest % count, third], axis=1)


def triangles(points_m: Floats, triples: Whole) -> Triangles:
    """The standard form of triples `(n, 3)` of poles; those too small or too large are left out."""
    corners = triples.copy()
    a, b, c = (points_m[corners[:, i]] for i in range(3))
    one, two = b - a, c - a
    clockwise = one[:, 0] * two[:, 1] - one[:, 1] * two[:, 0] < 0.0
    corners[clockwise, 1:] = corners[clockwise, :0:-1]
    sides = side_lengths(points_m, corners)
    turned = (sides.argmax(axis=1)[:, np.newaxis] + np.arange(3)) % 3
    corners = np.take_along_axis(corners, turned, axis=1)
    sides = np.take_along_axis(sides, turned, axis=1)
    good = (sides.min(axis=1) >= SHORTEST_M) & (sides[:, 0] >= LONGEST_LEAST_M)
    good &= sides[:, 0] < LONGEST_MOST_M
    return oriented(points_m, corners[good], sides[good])


def side_lengths(points_m: Floats, corners: Whole) -> Floats:
    """Lengths `(n, 3)` from each corner to the next."""
    offset = points_m[np.roll(corners, -1, axis=1)] - points_m[corners]
    return np.asarray(np.hypot(offset[..., 0], offset[..., 1]))


def oriented(points_m: Floats, corners: Whole, sides_m: Floats) -> Triangles:
    """Triangles whose corners are in order already."""
    along = points_m[corners[:, 1]] - points_m[corners[:, 0]]
    return Triangles(corners, sides_m, np.arctan2(along[:, 1], along[:, 0]))


def quantised(sides_m: Floats) -> Whole:
    """Whole numbers of quanta, kept within their bits."""
    return np.clip(np.floor(sides_m / QUANTUM_M).astype(np.int64), 0, 2**BITS - 1)


def keys(quanta: Whole) -> NDArray[np.uint32]:
    """One number `(...,)` for three quantised lengths `(..., 3)`, in their order."""
    packed = (quanta[..., 0] << 2 * BITS) | (quanta[..., 1] << BITS) | quanta[..., 2]
    return packed.astype(np.uint32)
