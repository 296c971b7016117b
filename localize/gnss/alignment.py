"""Position and heading from GNSS alone: the dead-reckoned path laid onto the recent fixes.

A fix has no heading, and the course between two fixes turns with the noise of both. The path that
the odometry draws, moved and turned until it fits the fixes of the last half minute, gives both,
says backward from forward, and shows which fixes are outliers.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.samples import GnssFix
from polemap.localize.gnss.outlier_mixture import GnssReceiver
from polemap.vehicle.pose import rigid_fit, rotate, rotation, transform_points, wrap_angle

Floats = NDArray[np.float64]

_SPACING_S = 0.5
_MOST_FIXES = 60
_INLIER_GATE_SD = 3.0
_SHORT_TERM_SHARE = 0.5  # the part of the receiver's error that differs from fix to fix
_STRAY_S = 2.0
_DRIFT_SHARE = 0.02
_SAME_PLACE_M = 1.0
_FIXES_AT_A_PLACE = 5  # the newest; enough for a median that one outlier or two do not move
_WINDOW_S = 30.0  # older fixes are forgotten: dead reckoning has drifted under them


@dataclass(frozen=True, slots=True)
class GnssPose:
    """A coarse pose of the rear axle: `(3,)`, covariance `(3, 3)`, and whether the yaw is known."""

    pose: Floats
    covariance: Floats
    heading_known: bool

    def sample(self, count: int, rng: np.random.Generator) -> Floats:
        """Rear-axle poses `(count, 3)`; any heading where it is not known."""
        drawn = rng.multivariate_normal(self.pose, self.covariance, size=count, method="cholesky")
        if not self.heading_known:
            drawn[:, 2] = rng.uniform(-np.pi, np.pi, count)
        return np.asarray(drawn)

    def misfit(self, poses: Floats, receiver: GnssReceiver) -> Floats:
        """How much less likely than the best pose others `(n, 3)` are, `(n,)` as minus the log.

        Mixed with a far wider Gaussian: GNSS may be wrong altogether.
        """
        known = 3 if self.heading_known else 2
        offset = poses - self.pose
        offset[:, 2] = wrap_angle(offset[:, 2])
        inverse = np.linalg.inv(self.covariance[:known, :known])
        d2 = np.einsum("ni,ij,nj->n", offset[:, :known], inverse, offset[:, :known])
        return -receiver.mixture(d2)


@dataclass(frozen=True, slots=True)
class _Pair:
    """A fix, and where dead reckoning had the antenna at that moment."""

    stamp_s: float
    fix_m: Floats
    odometry_m: Floats
    sd_m: float


class GnssAlignment:
    """Keeps the recent fixes with the dead-reckoned antenna positions, and aligns the two."""

    def __init__(self, receiver: GnssReceiver) -> None:
        self._receiver = receiver
        self._pairs: deque[_Pair] = deque(maxlen=_MOST_FIXES)
        self._latest: _Pair | None = None

    @property
    def newest_s(self) -> float:
        """Stamp of the newest fix, minus infinity before the first."""
        return self._latest.stamp_s if self._latest else -np.inf

    @property
    def newest_m(self) -> Floats | None:
        """East, north `(2,)` of the newest fix, None before the first."""
        return self._latest.fix_m if self._latest else None

    def add_fix(self, fix: GnssFix, odometry_pose: Floats) -> None:
        """Add a fix together with the dead-reckoned rear-axle pose `(3,)` of its moment."""
        position = odometry_pose[:2] + rotate(self._receiver.antenna_m, odometry_pose[2])
        sd = self._receiver.sd_m(fix.hdop)
        pair = _Pair(fix.stamp_s, np.array([fix.east_m, fix.north_m]), position, sd)
        self._latest = pair
        if not self._pairs or fix.stamp_s - self._pairs[-1].stamp_s >= _SPACING_S:
            self._pairs.append(pair)
        while self._pairs[0].stamp_s < fix.stamp_s - _WINDOW_S:
            self._pairs.popleft()

    def align(self, odometry_pose: Floats) -> GnssPose | None:
        """Where the car is now, given its dead-reckoned pose `(3,)`; None without recent fixes."""
        if self._latest is None or not self._pairs:
            return None
        pairs = list(self._pairs)
        if pairs[-1].stamp_s < self._latest.stamp_s:
            pairs.append(self._latest)
        result, kept = self._fit(pairs, odometry_pose)
        late = np.array([p.stamp_s >= pairs[-1].stamp_s - _STRAY_S for p in pairs])
        if late.sum() >= 3 and not kept[late].any():
            # the newest fixes agree with nothing before them: the car was moved, or was elsewhere
            self._pairs = deque(
                (p for p, is_late in zip(pairs, late, strict=True) if is_late), _MOST_FIXES
            )
            result, _ = self._fit(list(self._pairs), odometry_pose)
        return result

    def _fit(self, pairs: list[_Pair], odometry_pose: Floats) -> tuple[GnssPose, NDArray[np.bool_]]:
        fixes = np.array([p.fix_m for p in pairs])
        path = np.array([p.odometry_m for p in pairs])
        sd = np.array([p.sd_m for p in pairs])
        # dead reckoning that lies far back has drifted
        away = np.hypot(*(path - odometry_pose[:2]).T)
        tolerance = np.hypot(_SHORT_TERM_SHARE * sd, _DRIFT_SHARE * away)
        extent = float(np.hypot(*np.ptp(path, axis=0)))
        if len(pairs) >= 2 and extent > 2.0 * float(np.median(tolerance)):
            yaw, kept = _best_rotation(fixes, path, tolerance)
            yaw, shift, yaw_sd, kept = _refine(fixes, path, tolerance, yaw, kept)
        else:
            yaw, yaw_sd = 0.0, np.inf
            offset = fixes - path
            shift = np.median(offset, axis=0)
            kept = np.hypot(*(offset - shift).T) < _INLIER_GATE_SD * sd
        known = yaw_sd < 0.35
        if not known:
            return self._unknown_heading(fixes, path, sd, odometry_pose), kept
        turn = rotation(yaw)
        pose = np.empty(3)
        pose[:2] = turn @ odometry_pose[:2] + shift
        pose[2] = wrap_angle(odometry_pose[2] + yaw)
        # what all fixes share (Gauss-Markov) does not shrink with their number
        position_var = float(np.median(sd)) ** 2 * (1.0 - _SHORT_TERM_SHARE**2 / 2)
        centre = path[kept].mean(axis=0)
        arm = turn @ (odometry_pose[:2] - centre)
        across = np.array([-arm[1], arm[0]])
        covariance = np.zeros((3, 3))
        covariance[:2, :2] = np.eye(2) * position_var + np.outer(across, across) * yaw_sd**2
        covariance[:2, 2] = covariance[2, :2] = across * yaw_sd**2
        covariance[2, 2] = yaw_sd**2
        return GnssPose(pose, covariance, True), kept

    def _unknown_heading(
        self, fixes: Floats, path: Floats, sd: Floats, odometry_pose: Floats
    ) -> GnssPose:
        """Rear axle somewhere around the antenna, in any direction.

        Args:
            fixes: `(n, 2)` east, north of the antenna, oldest first.
            path: `(n, 2)` where dead reckoning had the antenna at their moments.
            sd: `(n,)` standard deviations of the fixes, an axis, metres.
            odometry_pose: `(3,)` the rear axle now, in the frame of `path`.
        """
        # older fixes lie behind, nobody knows in which direction
        here = np.hypot(*(path - path[-1]).T) < _SAME_PLACE_M
        position = np.median(fixes[here][-_FIXES_AT_A_PLACE:], axis=0)
        lever = float(np.hypot(*self._receiver.antenna_m))
        since = float(np.hypot(*(odometry_pose[:2] - path[-1])))
        variance = float(np.median(sd)) ** 2 + 0.5 * max(lever, since) ** 2
        return GnssPose(
            np.array([position[0], position[1], 0.0]), np.diag([variance, variance, 1.0]), False
        )


def _best_rotation(
    fixes: Floats, path: Floats, tolerance: Floats
) -> tuple[float, NDArray[np.bool_]]:
    """The rotation between two far fixes that most others agree with (all pairs are tried)."""
    i, j = np.triu_indices(len(fixes), 1)
    along_path, along_fix = path[j] - path[i], fixes[j] - fixes[i]
    length = np.hypot(*along_path.T)
    far = length > 0.4 * length.max()
    i, along_path, along_fix = i[far], along_path[far], along_fix[far]
    yaw = np.arctan2(along_fix[:, 1], along_fix[:, 0]) - np.arctan2(
        along_path[:, 1], along_path[:, 0]
    )
    predicted = rotate(path[None] - path[i][:, None], yaw[:, None]) + fixes[i][:, None]
    error2 = ((predicted - fixes[None]) ** 2).sum(axis=-1)
    scaled = error2 / tolerance**2
    best = int(np.argmin(np.minimum(scaled, _INLIER_GATE_SD**2).sum(axis=1)))
    return float(yaw[best]), scaled[best] < _INLIER_GATE_SD**2


def _refine(
    fixes: Floats, path: Floats, tolerance: Floats, yaw: float, kept: NDArray[np.bool_]
) -> tuple[float, Floats, float, NDArray[np.bool_]]:
    """Weighted least squares (closed form) over the fixes that agree, three rounds."""
    shift = np.zeros(2)
    yaw_sd = np.inf
    for _ in range(3):
        if kept.sum() < 2:
            return yaw, shift, np.inf, kept
        weight = np.where(kept, 1.0 / tolerance**2, 0.0)
        fit = rigid_fit(path, fixes, weight)
        shift, yaw = fit[:2], float(fit[2])
        lever = path - weight @ path / weight.sum()
        # neighbouring fixes share most of their noise: as if a quarter of them were independent
        information = float(weight @ (lever**2).sum(axis=1)) / 4.0
        yaw_sd = max(float(1.0 / np.sqrt(max(information, 1e-9))), 0.02)
        error = np.hypot(*(transform_points(fit, path) - fixes).T)
        kept = error < _INLIER_GATE_SD * tolerance
    return yaw, shift, yaw_sd, kept
