"""Where the pole detector stands, by how poles move from scan to scan while the car turns.

With poles given in a frame whose origin stands at c and which is turned by a against the vehicle
frame, a pole seen at s is seen after the motion (t, turn) at

    R(-turn) (s - t) + (R(-turn) - I) c + a J R(-turn) t

to first order, J being the turn by 90 degrees. If y is q times too large as well, s is y / q in all
of this and what comes out is multiplied by q again. The scale of the way against the distances and
the slip of the rear axle are unknowns beside c, a and q, so that none passes for another.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.drive import Drive
from polemap.drivelog.findings import Finding
from polemap.drivelog.plausibility.odometer import Odometer
from polemap.drivelog.plausibility.scan_pairs import ScanPairs, find_pairs
from polemap.vehicle.motion import move_along_arc
from polemap.vehicle.pose import rotate_back, rotation

Floats = NDArray[np.float64]

_PAIRS_MIN, _MATCHES_MIN = 20, 40
_TURN_MIN_RAD, _BENDS_MIN = 0.1, 8
_RATE_MAX_RADPS, _LATERAL_MAX_MPS2 = 1.5, 10.0
_GATES_M = (2.0, 2.0, 1.5, 1.0, 0.7, 0.7)
# x, y of the frame (m), its yaw (rad), scale of the way, slip (rad per m/s2); log of y's scale
_PRIOR_SD = np.array([3.0, 3.0, 0.3, 0.2, 0.004])
_ACROSS_SD, _TURN_SD, _NONE = 1.0, 0.5, 1e-6
_ACROSS_STARTS = (0.0, np.log(2.0), -np.log(2.0))
# clean drives against the reference: within 0.25 m and 0.5 degrees, but for what their sd allows;
# against an odometry from encoder and steering, within 1.5 m and 1.9 degrees
_DOUBT = {True: (0.5, 0.5, np.radians(2.0)), False: (2.0, 2.0, np.radians(3.5))}
# clean drives: within 0.01 against the reference, 0.04 against an odometry; y within 0.05
_WAY = {True: 0.04, False: 0.07}
_ACROSS, _ACROSS_WRONG = 0.12, 0.3
_TURN, _TURN_WRONG = 0.15, 0.4
_SDS = 5.0
_STEP = 1e-5
_WRONG_M = 5.0


@dataclass(frozen=True, slots=True)
class DetectorPlace:
    """Frame and scales that the poles are given in, with their sds.

    Attributes:
        values, sds: `(3,)` x, y (m) and yaw (rad) in the vehicle frame.
        way, way_sd: logarithm of how much longer the way of the poles is than that of the motion.
        across, across_sd: logarithm of the scale of y over that of x; 0 where it is not sought.
        turn, turn_sd: logarithm of the turn of the poles over that of the motion; likewise.
        matches: poles that were met again.
    """

    values: Floats
    sds: Floats
    way: float
    way_sd: float
    across: float
    across_sd: float
    turn: float
    turn_sd: float
    matches: int


def place_findings(drive: Drive, motion: Odometer, *, surveyed: bool) -> list[Finding]:
    """A detector mounted elsewhere than its poles were brought from, or with distances of its own.

    Args:
        surveyed: the motion is a reference's, not an odometry's.
    """
    pairs = find_pairs(drive, motion)
    # with more unknowns nothing is as certain, so that they are believed only where they are large
    starts = (
        find_place(pairs, motion, across=start, seek_turn=not surveyed) for start in _ACROSS_STARTS
    )
    scaled = max(filter(None, starts), key=lambda place: place.matches, default=None)
    if scaled is not None and abs(scaled.across) > max(_ACROSS, _SDS * scaled.across_sd):
        return [_across_finding(drive, motion, scaled)]
    if scaled is not None and abs(scaled.turn) > max(_TURN, _SDS * scaled.turn_sd):
        return [_turn_finding(drive, motion, scaled)]
    place = find_place(pairs, motion)
    if place is None:
        return []
    found = _scale_findings(drive, motion, place, surveyed=surveyed)
    limits = np.maximum(_DOUBT[surveyed], _SDS * place.sds)
    off = np.abs(place.values) > limits
    if not off.any():
        return found
    x, y, yaw = place.values
    said = []
    if off[0]:
        said.append(f"{abs(x):.2f} m {'ahead of' if x > 0 else 'behind'}")
    if off[1]:
        said.append(f"{abs(y):.2f} m {'left' if y > 0 else 'right'} of")
    where = f"from {' and '.join(said)} the rear axle" if said else ""
    turned = f"turned by {np.degrees(yaw):.1f} degrees" if off[2] else ""
    far = bool((np.abs(place.values[:2]) > _WRONG_M)[off[:2]].any())
    # a car is no longer than that: an axis of another scale moves poles likewise
    remedy = (
        "check the units of x and y, each by itself"
        if far
        else ("correct the detector's mounting by this")
    )
    return [
        Finding(
            "pole_mounting", "error" if far else "warning", drive.names.poles,
            f"its poles move as if seen {' and '.join(filter(None, (where, turned)))} "
            f"({place.matches} met again)", "poles in the vehicle frame, from the rear axle",
            remedy,
        ),
        *found,
    ]  # fmt: skip


def _across_finding(drive: Drive, motion: Odometer, place: DetectorPlace) -> Finding:
    """Two axes that are not in one unit."""
    return Finding(
        "pole_axes", "error" if abs(place.across) > _ACROSS_WRONG else "warning",
        drive.names.poles,
        f"its y_m is {np.exp(place.across):.2f} times too large for its x_m, by how its poles move "
        f"with {motion.name} ({place.matches} met again)", "x and y of one scale",
        "check the units of x and y, each by itself",
    )  # fmt: skip


def _turn_finding(drive: Drive, motion: Odometer, place: DetectorPlace) -> Finding:
    """A yaw rate that is too large or too small for how poles move in bends."""
    return Finding(
        "yaw_rate_scale", "error" if abs(place.turn) > _TURN_WRONG else "warning", motion.name,
        f"the poles turn {np.exp(place.turn):.2f} times as fast ({place.matches} met again)",
        f"1 within {100 * _TURN:.0f} %", "check the yaw rate's unit and scale",
    )  # fmt: skip


def _scale_findings(
    drive: Drive, motion: Odometer, place: DetectorPlace, *, surveyed: bool
) -> list[Finding]:
    """Distances that are a few percent off: by the way of a reference, or of an odometry."""
    if abs(place.way) < max(_WAY[surveyed], _SDS * place.way_sd):
        return []
    ratio = float(np.exp(place.way))
    remedy = (
        f"multiply x and y by {1.0 / ratio:.2f}: check baseline and focal length of the detector"
    )
    return [
        Finding(
            "pole_scale", "warning", drive.names.poles,
            f"its poles move {ratio:.3f} times as far as {motion.name} goes ({place.matches} met "
            "again)", f"1 within {100 * _WAY[surveyed]:.0f} %",
            remedy if surveyed
            else f"calibrate the wheel radius of {motion.name}, or the distances of the poles",
        )
    ]  # fmt: skip


def find_place(
    pairs: ScanPairs,
    motion: Odometer,
    across: float | None = None,
    *,
    seek_turn: bool = False,
) -> DetectorPlace | None:
    """The frame that the poles are given in; None where too few are met again.

    Args:
        across: where the search for a scale of y begins; None if y is of the scale of x.
        seek_turn: the turn of the motion may be of another scale as well.
    """
    if len(pairs) < _PAIRS_MIN:
        return None
    first, second = pairs.first, pairs.second
    way, turn, known = motion.spans(first.stamp_s, second.stamp_s)
    ay = way * turn / (second.stamp_s - first.stamp_s) ** 2

    def told(values: Floats) -> Floats:
        """Where the poles are told to be seen: `(pairs, poles, 2)`."""
        turns = turn * np.exp(values[6])
        moves = move_along_arc(np.zeros(3), way, turns)
        back = rotate_back(moves[:, :2], turns)
        left = np.stack([-back[:, 1], back[:, 0]], axis=1)
        shift = (rotation(-turns) - np.eye(2)) @ values[:2]
        shift += values[2] * left - values[3] * back - values[4] * left * ay[:, None]
        axes = np.array([1.0, np.exp(values[5])])
        moved = rotate_back(first.points_m / axes - moves[:, None, :2], turns[:, None])
        return np.asarray((moved + shift[:, None]) * axes)

    # sharper than a car turns, the motion is no measurement
    steps = np.diff(motion.heading_rad) / np.maximum(np.diff(motion.stamp_s), 1e-3)
    sharp = np.concatenate([[0], np.cumsum(np.abs(steps) > _RATE_MAX_RADPS)])
    rows = [np.searchsorted(motion.stamp_s, s) for s in (first.stamp_s, second.stamp_s)]
    turned = [
        sharp[np.clip(row + k, 0, len(sharp) - 1)] for row, k in zip(rows, (-1, 0), strict=True)
    ]
    driven = known & (np.abs(ay) < _LATERAL_MAX_MPS2) & (turned[0] == turned[1])
    usable = first.there & driven[:, None]
    prior_sd = np.array(
        [*_PRIOR_SD, _NONE if across is None else _ACROSS_SD, _TURN_SD if seek_turn else _NONE]
    )
    values: Floats = np.array([0.0, 0.0, 0.0, 0.0, 0.0, across or 0.0, 0.0])
    covariance: Floats = np.diag(prior_sd**2)
    matches = bends = 0
    for gate in _GATES_M:
        here = told(values)
        offset = second.points_m[:, None] - here[:, :, None]
        distance = np.hypot(offset[..., 0], offset[..., 1])
        distance = np.where(second.there[:, None], distance, np.inf)
        nearest = distance.argmin(axis=2)
        # a pole that could be either of two says nothing
        ordered = np.sort(distance, axis=2)
        alone = ordered[..., 1] > 2.0 * ordered[..., 0] if ordered.shape[2] > 1 else True
        near = ordered[..., 0] < gate
        pair, row = np.nonzero(usable & near & alone)
        matches = len(pair)
        if matches < _MATCHES_MIN:
            return None
        columns = [(told(values + _STEP * unit) - here)[pair, row] for unit in np.eye(7)]
        design = np.stack(columns, axis=2) / _STEP
        rest = offset[pair, row, nearest[pair, row]] + design @ values
        values, covariance = _solve(design, rest, pair, values, prior_sd)
        bends = len(np.unique(pair[np.abs(turn[pair]) > _TURN_MIN_RAD]))

    sds = np.sqrt(np.diag(covariance))
    if bends < _BENDS_MIN:
        sds[[0, 1, 5, 6]] = np.inf
    way_log, across_log, turn_log = (float(values[k]) for k in (3, 5, 6))
    way_sd, across_sd, turn_sd = (float(sds[k]) for k in (3, 5, 6))
    return DetectorPlace(
        values[:3], sds[:3], way_log, way_sd, across_log, across_sd, turn_log, turn_sd, matches
    )


def _solve(
    design: Floats, rest: Floats, pair: NDArray[np.int64], start: Floats, prior_sd: Floats
) -> tuple[Floats, Floats]:
    """Robust least squares; errors of the poles of one pair of scans count as one error."""
    values = start
    bread: Floats = np.eye(len(start))
    prior = np.diag(1.0 / prior_sd**2)
    error = rest - design @ values
    weight: Floats = np.ones(len(rest))
    for _ in range(5):
        size = np.hypot(error[:, 0], error[:, 1])
        scale = float(np.median(size)) + 1e-3
        weight = 1.0 / (1.0 + (size / (2.0 * scale)) ** 2) / scale**2
        weighted = design * weight[:, None, None]
        bread = np.asarray(np.linalg.inv(np.einsum("nij,nik->jk", weighted, design) + prior))
        values = bread @ np.einsum("nij,ni->j", weighted, rest)
        error = rest - design @ values
    scores = np.einsum("nij,ni->nj", design * weight[:, None, None], error)
    summed = np.zeros((int(pair.max()) + 1, len(start)))
    np.add.at(summed, pair, scores)
    return values, np.asarray(bread @ (summed.T @ summed + prior) @ bread)
