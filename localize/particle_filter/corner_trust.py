"""Whether corners are believed: houses that moved, or a wrong map, must not drag the pose.

Before the corners of a scan move the particles they are held against where poles, fixes and the way
have put the car. Corners that do not fit accuse their map, not the place, as long as poles hold it;
where none does, they accuse both. And a place that was lost where only corners stand is found again
when several of them say so, not one or two.
"""

from __future__ import annotations

from collections import Counter

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.detections import Detections
from polemap.drivelog.landmark_kind import LandmarkKind
from polemap.localize.contradictions import StrangePoles
from polemap.localize.particle_filter.estimate import position_sd
from polemap.localize.particle_filter.landmarks import Landmarks
from polemap.localize.particle_filter.persistent_errors import at_least, look
from polemap.vehicle.pose import (
    pose_rotation,
    transform_points,
    wrap_angle,
)

Floats = NDArray[np.float64]
Rows = NDArray[np.int64]

# a place known worse than this says nothing of corners
_JUDGE_SD_M = 0.5
# corners further off, facing another way, or so many deviations away, are others
_FARTHEST_M, _SIDE_RAD, _GATE = 3.5, 0.9, 14.0
# cumulative sums of what exceeds one deviation, as of lines: ahead, back, left, right; half of an
# error stays with a corner while it is passed, so scans count less than those of independent errors
_SLACK_SD, _LIMIT, _MOST, _COUNTED = 1.0, 4.0, 6.0, 0.33
# they come back where they fit for so many independent scans at a place known this well without
# them
_FITS_SD, _FITS_SCANS, _SURE_SD_M = 1.5, 3.0, 0.3
# known no better than this, the place is looked for by them again, but not called proven
_LOST_SD_M = 1.0
# poles that hold the pose have matched within this time; so many independent ones end a doubt
_POLES_S, _CONFIRMING_POLES = 3.0, 4.0
# a place that was not known to a metre is found by so many corners, of which with two one that is
# wrong is half of the proof; a pole counts for two
_FINDING_CORNERS = 3


class CornerTrust:
    """Judges the corners of a map, all together.

    Args:
        counts: `corners_suspended` is counted here.

    Attributes:
        suspended: they are not believed.
        doubted: corners have contradicted the place where no pole held it, or were not believed and
            found it all the same: whether it is right, poles must say.
        found: whether the place was always known, or several landmarks have found it again.

    Source: Page (1954), "Continuous inspection schemes", Biometrika 41.
    """

    def __init__(self, counts: Counter[str]) -> None:
        self._counts = counts
        self._poles_s = -np.inf
        self.forget()

    def forget(self) -> None:
        """A new place: what corners said at another one says nothing here."""
        self._strange = StrangePoles()
        self._sums = np.zeros(4)
        self._fitting = self._confirming = 0.0
        self._finding: set[int] = set()
        self.suspended = self.doubted = False
        self.found = True

    def believed(
        self, scan: Detections, landmarks: Landmarks, pose: Floats, particles: Floats,
        stated: Floats, share: float, floor_m: float,
    ) -> bool:  # fmt: skip
        """Whether the corners of a scan may move the particles.

        Args:
            landmarks: of the map, around the car.
            pose, particles: `(3,)`, `(3, 3)` of the particles before the scan.
            stated: `(3, 3)` what lasting errors leave of the pose.
            share: of the scan that is independent of the last one.
            floor_m: standard deviation of every seen position besides what its detector states.
        """
        place_sd_m = position_sd(particles)[0]
        if place_sd_m > _LOST_SD_M:
            self.found = False
            self._finding.clear()
            if self.suspended:
                self.forget()
                self.doubted, self.found = True, False
        mine = np.flatnonzero(scan.kind == LandmarkKind.CORNER)
        mapped = landmarks.take(landmarks.kind == LandmarkKind.CORNER)
        if place_sd_m > _JUDGE_SD_M or not len(mine) or not len(mapped):
            return not self.suspended
        place = at_least(particles, stated)
        self._judge(scan, mine, mapped, pose, place, share, floor_m, place_sd_m)
        return not self.suspended

    def _judge(
        self, scan: Detections, mine: Rows, mapped: Landmarks, pose: Floats, covariance: Floats,
        share: float, floor_m: float, place_sd_m: float,
    ) -> None:  # fmt: skip
        residual, spread, distance = _residuals(scan, mine, mapped, pose, covariance, floor_m)
        fits = distance <= _GATE
        self._strange.add_scan(
            int(fits.sum()), len(mine), float(distance[fits].sum()), share, mapped=True
        )
        off_sd = _off_sd(residual[fits], spread[fits], pose, covariance)
        self._sums = np.clip(
            self._sums + _COUNTED * share * (np.concatenate([off_sd, -off_sd]) - _SLACK_SD),
            0.0,
            _MOST,
        )
        if not self.suspended and (self._strange.contradict or self._sums.max() >= _LIMIT):
            self.suspended, self._fitting = True, 0.0
            self._counts["corners_suspended"] += 1
            # where no pole holds the place, it may be wrong as well as the map
            self.doubted |= scan.stamp_s - self._poles_s > _POLES_S
        elif self.suspended:
            fitting = 2 * int(fits.sum()) >= len(mine) and np.abs(off_sd).max() <= _FITS_SD
            sure = place_sd_m <= _SURE_SD_M
            self._fitting = self._fitting + share * sure if fitting else 0.0
            if self._fitting >= _FITS_SCANS and not self._strange.contradict:
                self.suspended, self._sums = False, np.zeros(4)

    def without_suspended(self, scan: Detections) -> Detections:
        """A scan without its corners where they are not believed."""
        return without_corners(scan) if self.suspended else scan

    def add_matched(
        self, stamp_s: float, poles: Rows, corners: Rows, share: float, *, contradicted: bool
    ) -> None:
        """Take in what the estimate has matched.

        Args:
            poles, corners: ids in the map.
            share: of the scan that is independent of the last one.
            contradicted: poles contradict the place.
        """
        if contradicted:
            self._confirming = 0.0
        elif len(poles):
            self._poles_s = stamp_s
            self._confirming += len(poles) * share if self.doubted else 0.0
        if self._confirming >= _CONFIRMING_POLES:
            self.doubted, self._confirming = False, 0.0
        if not self.found:
            # ids of poles and corners are of one map, so the negative ones are free
            both = [*poles.tolist(), *(-1 - poles).tolist(), *corners.tolist()]
            self._finding.update(both)
            self.found = len(self._finding) >= _FINDING_CORNERS


def without_corners(scan: Detections) -> Detections:
    """The other landmarks of a scan."""
    corners = scan.kind == LandmarkKind.CORNER
    return scan.take(~corners) if corners.any() else scan


def _residuals(
    scan: Detections, mine: Rows, mapped: Landmarks, pose: Floats, covariance: Floats,
    floor_m: float,
) -> tuple[Floats, Floats, Floats]:  # fmt: skip
    """Of each seen corner how far it lies from the nearest mapped one, `(k, 2)`, the covariance of
    what is seen and mapped `(k, 2, 2)`, and the squared distance `(k,)` with that of the place;
    infinite where there is none."""
    points = scan.points_vehicle_m.reshape(-1, 2)[mine]
    seen = transform_points(pose, points)
    offset = seen[:, None] - mapped.points_m
    away = np.hypot(offset[..., 0], offset[..., 1])
    if mapped.facing_rad is not None:
        turn = wrap_angle(scan.facing_rad[mine][:, None] + pose[2] - mapped.facing_rad)
        away[np.abs(turn) > _SIDE_RAD] = np.inf
    nearest = away.argmin(axis=1)
    rows = np.arange(len(mine))
    own, theirs, jacobian = look(
        points, scan.covariance_m2.reshape(-1, 2, 2)[mine], mapped.covariance_m2[nearest], pose[2],
        floor_m**2,
    )  # fmt: skip
    spread = own + theirs
    total = spread + jacobian @ covariance @ jacobian.transpose(0, 2, 1)
    residual = offset[rows, nearest]
    distance = np.einsum("ni,nij,nj->n", residual, np.linalg.inv(total), residual)
    return residual, spread, np.where(away[rows, nearest] <= _FARTHEST_M, distance, np.inf)


def _off_sd(residual: Floats, spread: Floats, pose: Floats, covariance: Floats) -> Floats:
    """How many deviations corners lie ahead and left of the map's, `(2,)`; zero without any."""
    if not len(residual):
        return np.zeros(2)
    weights = np.linalg.inv(spread)
    own = np.linalg.inv(weights.sum(axis=0))
    middle = own @ (weights @ residual[:, :, None]).sum(axis=0)[:, 0]
    turn = pose_rotation(-pose[2])[:2, :2]
    total = np.diag(turn @ (own + covariance[:2, :2]) @ turn.T)
    return np.asarray((turn @ middle) / np.sqrt(total))
