"""How likely the lines of a moment are at a pose: across and direction of each piece, clutter.

A piece belongs to the mapped line of its kind by which it is likeliest. Many pieces may be of one
line (dashes, both sides of a gap), so there is no one-to-one assignment whose rows compete: the
choice of each piece is an optimum by itself. Along the line nothing is measured.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.landmark_kind import LandmarkKind, LineStyle
from polemap.drivelog.line_detections import LineDetections
from polemap.localize.particle_filter.line_parts import NearLines
from polemap.vehicle.pose import rotate, rotate_back, wrap_angle

Floats = NDArray[np.float64]
Rows = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class LineKindModel:
    """What is expected of lines of one kind.

    Attributes:
        clutter_share: of the pieces, those of no mapped line: shadows, repairs, what was painted
            since.
        detection: chance that a mapped line beside the car shows in a scan; paint is often hidden.
        span_m: pieces of no mapped line lie anywhere within so much across ...
        span_rad: ... and within so much of direction.
        view_m: a line is expected so far aside of the car.
        floor_m, floor_rad: standard deviations besides those of piece and map: paint and stone are
            no lines.
    """

    clutter_share: float
    detection: float
    span_m: float
    span_rad: float
    view_m: float
    floor_m: float = 0.03
    floor_rad: float = 0.01


KIND_MODELS = {
    int(LandmarkKind.LANE_MARKING): LineKindModel(0.2, 0.4, 8.0, 0.6, 6.0),
    int(LandmarkKind.KERB): LineKindModel(0.3, 0.3, 12.0, 0.6, 8.0),
    int(LandmarkKind.FACADE): LineKindModel(0.3, 0.3, 20.0, 1.0, 15.0),
}
# of lines of two known styles: log ratio of a style that is read right, or wrong, against clutter
_SAME_STYLE, _OTHER_STYLE = np.log(0.8 / 0.5), np.log(0.2 / 0.5)
_GATE_SD = 5.0
# a piece may lie so far beyond a bend of its line, where neither of the straight parts reaches
_JOINT_M = 1.0
# so far aside of a mapped line the map is taken to know the others of its kind
KNOWN_M = 20.0
# log-likelihood of a right piece in the mean, below that of a perfect one: two degrees of freedom
_EXPECTED_FIT = 1.0
# lines are expected beside this point, m ahead of the rear axle
_PROBE_M = 8.0


@dataclass(frozen=True, slots=True)
class Pieces:
    """What the model needs of seen pieces, `(k,)` each.

    Attributes:
        log_clutter: log of the chance that the piece is of no mapped line.
        log_right: log of the chance that it is, times the spans: the density of clutter is one.
        variance_m2, variance_rad2: across and of direction, without the map's.
        log_unknown: log-likelihood where the map knows no line of the kind.
    """

    kind: NDArray[np.int8]
    style: NDArray[np.int8]
    middle_m: Floats
    direction_rad: Floats
    variance_m2: Floats
    variance_rad2: Floats
    log_clutter: Floats
    log_right: Floats
    log_unknown: Floats

    @classmethod
    def of(cls, lines: LineDetections) -> Pieces:
        """Of pieces of `LINE_KINDS`."""
        models = [KIND_MODELS[kind] for kind in lines.kind.tolist()]

        def of_kind(name: str) -> Floats:
            return np.array([getattr(model, name) for model in models], dtype=np.float64)

        right = np.clip(lines.probability * (1.0 - of_kind("clutter_share")), 0.01, 0.99)
        variance_m2 = lines.offset_sd_m**2 + of_kind("floor_m") ** 2
        variance_rad2 = lines.direction_sd_rad**2 + of_kind("floor_rad") ** 2
        log_clutter = np.log1p(-right)
        log_right = np.log(right * of_kind("span_m") * of_kind("span_rad") / (2.0 * np.pi))
        at_best = log_right - 0.5 * np.log(variance_m2 * variance_rad2)
        return cls(
            lines.kind,
            lines.style,
            lines.middle_vehicle_m,
            lines.direction_rad,
            variance_m2,
            variance_rad2,
            log_clutter,
            log_right,
            np.logaddexp(log_clutter, at_best - _EXPECTED_FIT),
        )

    def __len__(self) -> int:
        return len(self.kind)


@dataclass(frozen=True, slots=True)
class Geometry:
    """Pieces `(k,)` seen from one pose against parts `(s,)`: `(k, s)` each.

    Attributes:
        across_m: of the piece's middle, left of the part.
        station_m: along the part, from its begin.
        turn_rad: direction of the piece less that of the part, lines having none forward.
        same_kind: whether they may belong together.
    """

    across_m: Floats
    station_m: Floats
    turn_rad: Floats
    same_kind: NDArray[np.bool_]

    @classmethod
    def at(cls, pose: Floats, pieces: Pieces, near: NearLines) -> Geometry:
        """From a rear-axle pose `(3,)`."""
        place = rotate(pieces.middle_m, pose[2]) + (pose[:2] - near.origin_m)
        offset = place[:, None] - near.start_m
        return cls(
            offset[..., 1] * near.along[:, 0] - offset[..., 0] * near.along[:, 1],
            offset[..., 0] * near.along[:, 0] + offset[..., 1] * near.along[:, 1],
            undirected(pieces.direction_rad[:, None] + pose[2] - near.angle_rad),
            pieces.kind[:, None] == near.kind,
        )


_PROBE = Pieces(
    np.zeros(1, dtype=np.int8), np.zeros(1, dtype=np.int8), np.array([[_PROBE_M, 0.0]]),
    *(np.zeros(1) for _ in range(6)),
)  # fmt: skip


def undirected(angle_rad: Floats) -> Floats:
    """Angles between lines, in [-pi/2, pi/2)."""
    return np.asarray(0.5 * wrap_angle(2.0 * np.asarray(angle_rad)))


def pair_constants(pieces: Pieces, near: NearLines) -> tuple[Floats, Floats, Floats]:
    """Log-value of a perfect pair, and variances across and of direction, `(k, s)` each."""
    variance_m2 = pieces.variance_m2[:, None] + near.variance_m2
    # a mapped line that lies sd aside at one end of a part and not at the other is turned by this
    bent = near.variance_m2 / np.maximum(near.length_m, 5.0) ** 2
    variance_rad2 = pieces.variance_rad2[:, None] + bent
    known = (pieces.style[:, None] != LineStyle.UNKNOWN) & (near.style != LineStyle.UNKNOWN)
    alike = np.where(pieces.style[:, None] == near.style, _SAME_STYLE, _OTHER_STYLE)
    log_value = (
        pieces.log_right[:, None]
        + np.log(near.existence)
        - 0.5 * np.log(variance_m2 * variance_rad2)
        + np.where(known, alike, 0.0)
    )
    return log_value, variance_m2, variance_rad2


def station_bounds(near: NearLines) -> tuple[Floats, Floats]:
    """Least and largest station `(s,)` at which a piece may be of a part: at the end of a line
    nothing beyond it, at a bend a little more."""
    low = np.where(near.before_m > 0.0, -_JOINT_M, 0.0)
    high = near.length_m + np.where(near.after_m > 0.0, _JOINT_M, 0.0)
    return low, high


@dataclass(frozen=True, slots=True)
class Spread:
    """How far poses lie apart.

    Attributes:
        centre: `(3,)` the middle of their box, which lies along `centre[2]`.
        half_m: `(2,)` half of the box along and aside.
        turned_rad: `(n,)` from the centre's yaw.
        half_rad: the largest of them.
    """

    centre: Floats
    half_m: Floats
    turned_rad: Floats
    half_rad: float

    @classmethod
    def of(cls, poses: Floats) -> Spread:
        """Of poses `(n, 3)`."""
        turned = wrap_angle(poses[:, 2] - poses[0, 2])
        low, high = float(turned.min()), float(turned.max())
        yaw = poses[0, 2] + 0.5 * (low + high)
        local = np.ascontiguousarray(rotate_back(poses[:, :2] - poses[0, :2], yaw).T)
        least, most = local.min(axis=1), local.max(axis=1)
        place = poses[0, :2] + rotate(0.5 * (least + most), yaw)
        half = 0.5 * (high - low)
        return cls(np.array([*place, yaw]), 0.5 * (most - least), turned - 0.5 * (low + high), half)

    def reaches(self, pieces: Pieces, near: NearLines) -> tuple[Floats, Floats]:
        """How far pieces lie from where the centre sees them at most, across and along the parts,
        `(k, s)` each."""
        along, aside = np.abs(rotate_back(near.along, self.centre[2])).T
        swing = (self.half_rad * np.hypot(*pieces.middle_m.T))[:, None]
        a, b = self.half_m
        return swing + (a * aside + b * along), swing + (a * along + b * aside)


def line_log_likelihood(
    poses: Floats, pieces: Pieces, near: NearLines, spread: Spread, *, count_misses: bool = False
) -> Floats:
    """Log-likelihood `(n,)` of pieces at rear-axle poses `(n, 3)` that lie close together.

    Of piece z it is `log(1 - w + w max_l e_l N(d; S) N(turn; Q) / kappa)`, relative to clutter of
    density kappa, with w that it belongs to a mapped line, e_l that the line exists, d across it.
    Where the map knows no line of its kind a piece says as much as a right one does in the mean, so
    that the end of a mapped line does not pretend to say where along the street the car is.

    Only pairs that one of the poses could want are looked at; for those the result is exact.

    Args:
        spread: of the poses.
        count_misses: charge every pose for the lines beside it of which no piece was seen. Poses
            within a metre see the same lines, and need not.

    Source: the mixture of a hit and of clutter, Thrun, Burgard, Fox (2005), section 6.3, here
    across a line and in direction.
    """
    at_centre = Geometry.at(spread.centre, pieces, near)
    features = _features(poses, near.origin_m)
    reaches = spread.reaches(pieces, near)
    total = np.full(len(poses), 0.0)
    low, high = station_bounds(near)
    known, unsure = _known(at_centre, near, reaches)
    pairs = _Pairs.of(at_centre, pieces, near, spread, reaches, features)
    if count_misses:
        total += _misses(features, pieces, near, pairs, spread)
    for k, best in enumerate(pairs.best(len(pieces))):
        here = pieces.log_clutter[k] if best is None else np.logaddexp(pieces.log_clutter[k], best)
        if known[k]:
            total += here
        elif not unsure[k].any():
            total += pieces.log_unknown[k]
        else:
            parts = np.flatnonzero(unsure[k])
            across, station = _placed(features, pieces, near, np.full(len(parts), k), parts)
            covered = (np.abs(across) <= KNOWN_M) & (station >= low[parts])
            covered &= station <= high[parts]
            total += np.where(covered.any(axis=1), here, pieces.log_unknown[k])
    return total


@dataclass(frozen=True, slots=True)
class _Pairs:
    """Piece and part `(p,)` of the pairs that count, and their log-values `(n, p)`."""

    piece: Rows
    part: Rows
    value: Floats

    @classmethod
    def of(
        cls, at_centre: Geometry, pieces: Pieces, near: NearLines, spread: Spread,
        reaches: tuple[Floats, Floats], features: Floats,
    ) -> _Pairs:  # fmt: skip
        """Those that a pose within the bounds could want."""
        log_value, variance_m2, variance_rad2 = pair_constants(pieces, near)
        low, high = station_bounds(near)
        across_m, along_m = reaches
        gate_rad = _GATE_SD * np.sqrt(variance_rad2) + spread.half_rad
        wanted = np.abs(at_centre.across_m) <= _GATE_SD * np.sqrt(variance_m2) + across_m
        wanted &= np.abs(at_centre.turn_rad) <= gate_rad
        wanted &= (at_centre.station_m >= low - along_m) & (at_centre.station_m <= high + along_m)
        piece, part = np.nonzero(wanted & at_centre.same_kind)
        across, station = _placed(features, pieces, near, piece, part)
        turn = at_centre.turn_rad[piece, part] + spread.turned_rad[:, None]
        value = across * across * (-0.5 / variance_m2[piece, part])
        value += turn * turn * (-0.5 / variance_rad2[piece, part])
        value += log_value[piece, part]
        value[(station < low[part]) | (station > high[part])] = -np.inf
        return cls(piece, part, value)

    def best(self, count: int) -> list[Floats | None]:
        """Of each of `count` pieces the largest value `(n,)`, None where it has no pair."""
        largest: list[Floats | None] = [None] * count
        if len(self.piece):
            first = np.flatnonzero(np.diff(self.piece, prepend=-1))
            of_piece = np.maximum.reduceat(self.value, first, axis=1)
            for column, k in enumerate(self.piece[first].tolist()):
                largest[k] = of_piece[:, column]
        return largest


def _misses(
    features: Floats, pieces: Pieces, near: NearLines, pairs: _Pairs, spread: Spread
) -> Floats:
    """Log-likelihood `(n,)` of having seen nothing of lines beside the car."""
    view = np.array([KIND_MODELS[kind].view_m for kind in near.kind.tolist()])
    probe = replace(_PROBE, kind=near.kind[:1])
    at = Geometry.at(spread.centre, probe, near)
    reach_m = float(np.hypot(*spread.half_m)) + _PROBE_M * spread.half_rad
    possible = (np.abs(at.across_m[0]) <= view + reach_m) & (at.station_m[0] >= -reach_m)
    part = np.flatnonzero(possible & (at.station_m[0] <= near.length_m + reach_m))
    across, station = _placed(features, probe, near, np.zeros_like(part), part)
    beside = (np.abs(across) <= view[part]) & (station >= 0.0) & (station <= near.length_m[part])
    fits = pairs.value > pieces.log_clutter[pairs.piece]
    out = np.zeros(len(features))
    for line in np.unique(near.line[part]).tolist():
        mine = near.line[part] == line
        first = int(part[mine][0])
        detection = KIND_MODELS[int(near.kind[first])].detection * near.existence[first]
        missed = beside[:, mine].any(axis=1) & ~fits[:, near.line[pairs.part] == line].any(axis=1)
        out += np.where(missed, np.log1p(-detection), 0.0)
    return out


def _features(poses: Floats, origin_m: Floats) -> Floats:
    """`(n, 5)` in which across and station of a piece are linear: place, turn, and one."""
    out = np.empty((len(poses), 5))
    out[:, :2] = poses[:, :2] - origin_m
    out[:, 2:4] = rotate(np.array([1.0, 0.0]), poses[:, 2])  # cosine and sine
    out[:, 4] = 1.0
    return out


def _placed(
    features: Floats, pieces: Pieces, near: NearLines, piece: Rows, part: Rows
) -> tuple[Floats, Floats]:
    """Across and station `(n, p)` of pairs at all poses."""
    u, a, m = near.along[part], near.start_m[part], pieces.middle_m[piece]
    dot, cross = (u * m).sum(axis=1), u[:, 0] * m[:, 1] - u[:, 1] * m[:, 0]
    at = u[:, 0] * a[:, 1] - u[:, 1] * a[:, 0]
    across = np.stack([-u[:, 1], u[:, 0], cross, dot, -at])
    station = np.stack([u[:, 0], u[:, 1], dot, -cross, -(u * a).sum(axis=1)])
    return features @ across, features @ station


def _known(
    at_centre: Geometry, near: NearLines, reaches: tuple[Floats, Floats]
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Pieces `(k,)` for which all poses lie beside a line of their kind, and the parts `(k, s)`
    that must be asked for the others."""
    across_m, reach = reaches
    station = at_centre.station_m
    inside = (station >= 0.0) & (station <= near.length_m)
    inside &= (near.before_m + station >= reach) & (near.after_m + near.length_m - station >= reach)
    sure = at_centre.same_kind & inside & (np.abs(at_centre.across_m) <= KNOWN_M - across_m)
    known: NDArray[np.bool_] = np.any(sure, axis=1)
    possible = at_centre.same_kind & (np.abs(at_centre.across_m) <= KNOWN_M + across_m)
    low, high = station_bounds(near)
    possible &= (station >= low - reach) & (station <= high + reach)
    return np.asarray(known), np.asarray(possible & ~known[:, None])
