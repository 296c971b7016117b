"""Where the pole detector stands, by how poles move from scan to scan while the car turns.

With poles given in a frame whose origin stands at c and which is turned by a against the vehicle
frame, a pole seen at s is seen after the motion (t, turn) at

    R(-turn) (s - t) + (R(-turn) - I) c + a J R(-turn) t

to first order, J being the turn by 90 degrees. The scale of the speed and the slip of the rear axle
are unknowns beside c and a, so that neither passes for the other.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.drive import Drive
from polemap.drivelog.findings import Finding
from polemap.drivelog.plausibility.odometer import Odometer
from polemap.drivelog.plausibility.poles import ScanPairs, find_pairs
from polemap.vehicle.motion import move_along_arc
from polemap.vehicle.pose import rotate_back, rotation

Floats = NDArray[np.float64]

_PAIRS_MIN, _MATCHES_MIN = 20, 40
_TURN_MIN_RAD, _BENDS_MIN = 0.1, 8
_RATE_MAX_RADPS, _LATERAL_MAX_MPS2 = 1.5, 10.0
_GATES_M = (2.0, 2.0, 1.5, 1.0, 0.7, 0.7)
# x, y of the frame (m), its yaw (rad), scale of the speed, slip (rad per m/s2)
_PRIOR_SD = np.array([3.0, 3.0, 0.3, 0.05, 0.004])
# clean drives against the reference: within 0.25 m and 0.5 degrees, but for what their sd allows;
# against an odometry from encoder and steering, within 1.5 m and 1.9 degrees
_DOUBT = {True: (0.5, 0.5, np.radians(2.0)), False: (2.0, 2.0, np.radians(5.0))}
_SDS = 5.0
_WRONG_M = 5.0


@dataclass(frozen=True, slots=True)
class DetectorPlace:
    """Place and yaw of the frame that the poles are given in, in the vehicle frame, and their sds.

    Attributes:
        values, sds: `(3,)` x, y (m) and yaw (rad).
        matches: poles that were met again.
    """

    values: Floats
    sds: Floats
    matches: int


def place_findings(drive: Drive, motion: Odometer, *, surveyed: bool) -> list[Finding]:
    """A detector mounted elsewhere than its poles were brought from.

    Args:
        surveyed: the motion is a reference's, not an odometry's.
    """
    place = find_place(find_pairs(drive, motion), motion)
    if place is None:
        return []
    limits = np.maximum(_DOUBT[surveyed], _SDS * place.sds)
    off = np.abs(place.values) > limits
    if not off.any():
        return []
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
        )
    ]  # fmt: skip


def find_place(pairs: ScanPairs, motion: Odometer) -> DetectorPlace | None:
    """The frame that the poles are given in; None where too few are met again."""
    if len(pairs) < _PAIRS_MIN:
        return None
    first, second = pairs.first, pairs.second
    way, turn, known = motion.spans(first.stamp_s, second.stamp_s)
    moves = move_along_arc(np.zeros(3), way, turn)
    back = rotate_back(moves[:, :2], turn)
    elapsed = second.stamp_s - first.stamp_s
    ay = way * turn / elapsed**2
    left = np.stack([-back[:, 1], back[:, 0]], axis=1)
    # R(-turn) - I, and the columns of yaw, scale and slip
    by_place = rotation(-turn) - np.eye(2)
    by_rest = np.stack([left, -back, -left * ay[:, None]], axis=2)
    jacobian = np.concatenate([by_place, by_rest], axis=2)
    moved = rotate_back(first.points_m - moves[:, None, :2], turn[:, None])
    # sharper than a car turns, the motion is no measurement
    steps = np.diff(motion.heading_rad) / np.maximum(np.diff(motion.stamp_s), 1e-3)
    sharp = np.concatenate([[0], np.cumsum(np.abs(steps) > _RATE_MAX_RADPS)])
    rows = [np.searchsorted(motion.stamp_s, s) for s in (first.stamp_s, second.stamp_s)]
    turned = [
        sharp[np.clip(row + k, 0, len(sharp) - 1)] for row, k in zip(rows, (-1, 0), strict=True)
    ]
    driven = known & (np.abs(ay) < _LATERAL_MAX_MPS2) & (turned[0] == turned[1])
    usable = first.there & driven[:, None]
    values: Floats = np.zeros(5)
    covariance: Floats = np.diag(_PRIOR_SD**2)
    matches = bends = 0
    for gate in _GATES_M:
        told = moved + (jacobian @ values)[:, None]
        offset = second.points_m[:, None] - told[:, :, None]
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
        rest = second.points_m[pair, nearest[pair, row]] - moved[pair, row]
        values, covariance = _solve(jacobian[pair], rest, pair, values)
        bends = len(np.unique(pair[np.abs(turn[pair]) > _TURN_MIN_RAD]))
    sds = np.sqrt(np.diag(covariance)[:3])
    if bends < _BENDS_MIN:
        sds[:2] = np.inf
    return DetectorPlace(values[:3], sds, matches)


def _solve(
    design: Floats, rest: Floats, pair: NDArray[np.int64], start: Floats
) -> tuple[Floats, Floats]:
    """Robust least squares; errors of the poles of one pair of scans count as one error."""
    values = start
    bread: Floats = np.eye(5)
    prior = np.diag(1.0 / _PRIOR_SD**2)
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
    summed = np.zeros((int(pair.max()) + 1, 5))
    np.add.at(summed, pair, scores)
    return values, np.asarray(bread @ (summed.T @ summed + prior) @ bread)
