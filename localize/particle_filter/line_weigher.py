"""Lines of a scan held against the lines of the map, for all particles and for one pose."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.line_detections import LineDetections
from polemap.localize.particle_filter.line_model import (
    Geometry,
    Pieces,
    Spread,
    line_log_likelihood,
    pair_constants,
    station_bounds,
)
from polemap.localize.particle_filter.line_parts import LineIndex, NearLines
from polemap.map.line_map import LineMap
from polemap.vehicle.pose import rotate, rotate_back

Floats = NDArray[np.float64]

# poses this close are weighed together: the pairs that one of them could want are few
_CELL_M, _CELL_ALONG_M, _CELL_RAD = 4.0, 20.0, 0.2
# parts of lines are asked for so far around what a piece could be
_REACH_M = 25.0
# and so much further, to serve the next frames too
_AHEAD_M = 15.0
# lines this far apart in direction are not one and the same
_ALIKE_RAD = 0.2
# share of the variance of a piece that all pieces of a frame have in common: roll, pitch and yaw of
# the camera, and what one mapped line is off by
SHARED = 0.5
# errors of lines last longer than those of poles: the same paint, the same survey, the same camera
_CORRELATION_M, _CORRELATION_S = 6.0, 2.0


@dataclass(frozen=True, slots=True)
class LineMatch:
    """What one pose makes of the pieces that belong to a mapped line, `(m,)` each.

    Attributes:
        piece: row of the piece in the scan; ids: of its line.
        across_m: of the piece's middle, left of the line; turn_rad: against its direction.
        seen_m2, mapped_m2: variance across of the piece and of the line.
        seen_rad2: of the piece's direction.
        normal: `(m, 2)` east, north, left of the line.
        arm_m: `(m, 2)` from the rear axle to the piece's middle, east and north.
    """

    piece: NDArray[np.int64]
    ids: NDArray[np.int64]
    kind: NDArray[np.int8]
    across_m: Floats
    turn_rad: Floats
    seen_m2: Floats
    mapped_m2: Floats
    seen_rad2: Floats
    normal: Floats
    arm_m: Floats

    def __len__(self) -> int:
        return len(self.piece)

    @property
    def jacobian(self) -> Floats:
        """Of `across_m` by east, north, yaw; `(m, 3)`."""
        turned = np.stack([-self.arm_m[:, 1], self.arm_m[:, 0]], axis=1)
        return np.column_stack([self.normal, (self.normal * turned).sum(axis=1)])


def frame_share(pieces: int) -> float:
    """What each of so many pieces of a frame counts: part of their errors is one and the same.

    Of k errors with correlation r the mean has the information of k / (1 + (k - 1) r) single ones.
    """
    return 1.0 / (1.0 + (max(pieces, 1) - 1) * SHARED)


def _together(spread: Spread) -> bool:
    """Whether poses are close enough along and in yaw to be weighed at once."""
    return bool(spread.half_m[0] <= _CELL_ALONG_M and spread.half_rad <= _CELL_RAD)


def line_share(moved_m: float, elapsed_s: float) -> float:
    """How much of a frame's lines is independent of the last one's; see `independent_share`."""
    return float(min(1.0, moved_m / (2.0 * _CORRELATION_M) + elapsed_s / (2.0 * _CORRELATION_S)))


class LineWeigher:
    """Holds lines against those of a map."""

    def __init__(self, lines: LineMap | None) -> None:
        self._index: LineIndex | None = None
        # the parts that the last question has found, and where it was asked
        self._last: NearLines | None = None
        self._last_radius_m = 0.0
        self.use_lines(lines)

    def use_lines(self, lines: LineMap | None) -> None:
        """Go on with other lines, of the same frame."""
        self._index = LineIndex(lines) if lines is not None and len(lines) else None
        self._last = None

    @property
    def empty(self) -> bool:
        """Whether the map holds no line."""
        return self._index is None

    def weigh(self, rear: Floats, lines: LineDetections) -> Floats:
        """Log-likelihood `(n,)` of a frame's pieces at rear-axle poses `(n, 3)`."""
        if self._index is None or not len(lines):
            return np.zeros(len(rear))
        pieces = Pieces.of(lines)
        share = frame_share(len(pieces))
        spread = Spread.of(rear)
        if spread.half_m[1] <= 0.5 * _CELL_M and _together(spread):
            return share * self._weigh_together(rear, pieces, spread, count_misses=False)
        local = rotate_back(rear[:, :2] - spread.centre[:2], spread.centre[2])
        cell = np.column_stack([local / (_CELL_ALONG_M, _CELL_M), spread.turned_rad / _CELL_RAD])
        _, group = np.unique(np.floor(cell), axis=0, return_inverse=True)
        order = np.argsort(group.ravel(), kind="stable")
        out = np.empty(len(rear))
        for rows in np.split(order, np.flatnonzero(np.diff(group.ravel()[order])) + 1):
            own = Spread.of(rear[rows])
            out[rows] = self._weigh_together(rear[rows], pieces, own, count_misses=True)
        return share * out

    def _weigh_together(
        self, rear: Floats, pieces: Pieces, spread: Spread, *, count_misses: bool
    ) -> Floats:
        near = self._near(spread.centre[:2], float(np.hypot(*spread.half_m)), pieces)
        return line_log_likelihood(rear, pieces, near, spread, count_misses=count_misses)

    def _near(self, centre_m: Floats, spread_m: float, pieces: Pieces) -> NearLines:
        assert self._index is not None
        radius_m = float(np.hypot(*pieces.middle_m.T).max()) + spread_m + _REACH_M
        last = self._last
        if last is not None:
            away_m = float(np.hypot(*(centre_m - last.origin_m)))
            if away_m + radius_m <= self._last_radius_m <= 2.0 * radius_m:
                return last
        self._last_radius_m = radius_m + _AHEAD_M
        self._last = self._index.near(centre_m, self._last_radius_m)
        return self._last

    def match(self, pose: Floats, lines: LineDetections, *, nearest: bool = False) -> LineMatch:
        """The line of each piece from one pose `(3,)`, by which it is likelier than clutter.

        Args:
            nearest: instead of that, the nearest line of the kind and direction, however far aside.
        """
        pieces = Pieces.of(lines)
        if self._index is None or not len(pieces):
            return _no_match()
        near = self._near(pose[:2], 0.0, pieces)
        if not len(near):
            return _no_match()
        at = Geometry.at(pose, pieces, near)
        log_value, variance_m2, variance_rad2 = pair_constants(pieces, near)
        low, high = station_bounds(near)
        on = at.same_kind & (at.station_m >= low) & (at.station_m <= high)
        value = log_value - 0.5 * at.across_m**2 / variance_m2
        value = value - 0.5 * at.turn_rad**2 / variance_rad2
        least = pieces.log_clutter[:, None]
        if nearest:
            on &= np.abs(at.turn_rad) <= _ALIKE_RAD
            value, least = -np.abs(at.across_m), np.full((len(pieces), 1), -np.inf)
        value = np.where(on & (value > least), value, -np.inf)
        part = value.argmax(axis=1)
        piece = np.flatnonzero(np.isfinite(value[np.arange(len(pieces)), part]))
        part = part[piece]
        return LineMatch(
            piece=piece,
            ids=near.ids[part],
            kind=pieces.kind[piece],
            across_m=at.across_m[piece, part],
            turn_rad=at.turn_rad[piece, part],
            seen_m2=pieces.variance_m2[piece],
            mapped_m2=near.variance_m2[part],
            seen_rad2=pieces.variance_rad2[piece],
            normal=np.stack([-near.along[part, 1], near.along[part, 0]], axis=1),
            arm_m=np.asarray(rotate(pieces.middle_m[piece], pose[2])),
        )


def _no_match() -> LineMatch:
    none, rows = np.empty(0), np.empty(0, dtype=np.int64)
    pairs = np.empty((0, 2))
    return LineMatch(
        rows, rows, np.empty(0, dtype=np.int8), none, none, none, none, none, pairs, pairs
    )  # fmt: skip
