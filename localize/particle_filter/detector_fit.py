"""Do the poles of a stretch fit the path that the odometry tells? Least squares with named errors.

What is wrong with a detector's calibration bends that fit in a way of its own: a common turn makes
the car go aside of where it looks, a common scale of the ranges makes poles pass slower or faster
than the car, a common error of the stamps moves all poles by speed and turn rate. Each is one
column beside those of what may be wrong otherwise: where the stretch lies in the map, the offset
and scales of the odometry, side-slip, and the place of every map pole.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from polemap.localize.particle_filter.pole_adjustment import Sightings, Solution, solve
from polemap.vehicle.pose import rotation

Floats = NDArray[np.float64]

# sd before the stretch is seen: place of it, m, and heading, rad; of the odometry the yaw rate's
# offset, rad/s, and that of the curvature, 1/m (a steering that is not in its middle), the scales
# of speed and turn, and the side-slip for a lateral acceleration, rad per m/s^2
_PLACE_SD = (10.0, 10.0, 0.1)
_ODOMETRY_SD = (0.004, 0.002, 0.03, 0.04, 0.005)
# of the calibration: turn, rad, scale of the ranges, stamps, s
_CALIBRATION_SD = (0.012, 0.02, 0.1)
# a map pole is known no better, and a detection, m
_POLE_SD_M, _DETECTION_SD_M = 0.05, 0.03
TOLERANCE = np.array([0.0087, 0.02, 0.1])
"""A calibration is as good as this in use: 0.5 degrees, 2 %, 0.1 s (of a recording that is held
good, Victoria Park, the laser's stamps are 0.07 s off)."""
# heading that the odometry may lose at one place, rad, and as a share of what it turns within this;
# in a bend the car's middle and its wheels slip as no column says: 0.1 rad at a radius of 1 m
_JUMP_RAD, _JUMP_SHARE, _NEAR_M = 0.0035, 0.05, 5.0
_BEND_RADM = 0.1
# a change is told by so many poles before and after it, in so many scans, and within so long a way
_LEAST_BEFORE, _LEAST_POLES, _LEAST_SCANS, _RECENT_M = 8, 4, 3, 45.0
# what the camera's own course says of the turn counts unless it contradicts the poles: then only
# they are wrong
_AGREE_SD = 3.0
_FIRST = len(_PLACE_SD) + len(_ODOMETRY_SD)
_COMMON = _FIRST + len(_CALIBRATION_SD)


@dataclass(frozen=True, slots=True)
class Look:
    """One scan, its poles matched to the map.

    Attributes:
        stamp_s, travelled_m: time, and way driven until then.
        odometry_pose: `(3,)` dead reckoned.
        speed_mps, yaw_rate_radps: of the car.
        points_vehicle_m, covariance_m2: `(n, 2)` and `(n, 2, 2)` of the poles that match.
        map_points_m, map_var_m2: `(n, 2)` and `(n,)` of the map poles that they match.
        share: of the scan that is independent of the one before.
    """

    stamp_s: float
    travelled_m: float
    odometry_pose: Floats
    speed_mps: float
    yaw_rate_radps: float
    points_vehicle_m: Floats
    covariance_m2: Floats
    map_points_m: Floats
    map_var_m2: Floats
    share: float


@dataclass(frozen=True, slots=True)
class StretchFit:
    """What a stretch says of the calibration, each as if nothing were known of it before.

    Attributes:
        values: `(3,)` turn of the detector, counter-clockwise, rad; scale of its ranges less one;
            the moment that it looked at less the stamp, s.
        sd: `(3,)`, larger where the poles scatter more than they should.
        looks: poles that the fit stands on.
    """

    values: Floats
    sd: Floats
    looks: int

    def with_turn(self, told: tuple[float, float] | None) -> StretchFit:
        """The fit and what else tells the turn, with its standard deviation, together."""
        if told is None:
            return self
        values, sd = self.values.copy(), self.sd.copy()
        values[0], sd[0] = _joined((float(values[0]), float(sd[0])), told)
        return StretchFit(values, sd, self.looks)


@dataclass(frozen=True, slots=True)
class Change:
    """A change of the calibration at one place.

    Attributes:
        look: index of the first scan after it.
        kind: what has changed, as the columns of `StretchFit.values`.
        value, sd: by how much.
    """

    look: int
    kind: int
    value: float
    sd: float

    def with_turn(
        self, before: tuple[float, float] | None, after: tuple[float, float] | None
    ) -> Change:
        """The change and what else tells the turn before and after it, together."""
        if self.kind or before is None or after is None:
            return self
        told = after[0] - before[0], float(np.hypot(after[1], before[1]))
        return Change(self.look, self.kind, *_joined((self.value, self.sd), told))


class Stretch:
    """The normal equations of the last scans, for as many of the newest as one likes.

    Args:
        looks: scans in the order of time, at least one of them with a pole.
        pose: `(3,)` of the rear axle in the map at the newest.
    """

    def __init__(self, looks: list[Look], pose: Floats) -> None:
        count = np.array([len(look.map_points_m) for look in looks])
        k = np.repeat(np.arange(len(looks)), count)  # the scan of each row
        mapped = np.concatenate([look.map_points_m for look in looks])
        # a pole is known by its place: rows are of a window that may have moved on
        poles, column = np.unique(mapped, axis=0, return_inverse=True)
        column = column.ravel()
        self._k, self._column, self._looks = k, column, len(looks)
        self._travelled_m = np.array([look.travelled_m for look in looks])[k]
        path = _path_to(pose, np.array([look.odometry_pose for look in looks]))
        speed = np.array([look.speed_mps for look in looks])
        turn_rate = np.array([look.yaw_rate_radps for look in looks])
        seconds = np.array([look.stamp_s for look in looks]) - looks[-1].stamp_s

        map_to_car = np.swapaxes(rotation(path[:, 2]), 1, 2)[k]
        expected = np.einsum("nij,nj->ni", map_to_car, mapped - path[k, :2])
        aside = _left_of(expected)
        design = np.zeros((len(k), 2, _COMMON))
        design[:, :, :2] = -map_to_car
        design[:, :, 2] = -np.einsum("nij,nj->ni", map_to_car, _left_of(mapped - pose[:2]))
        ways = np.array([look.travelled_m for look in looks]) - looks[-1].travelled_m
        self._path, self._ways, self._map_to_car, self._aside = path, ways, map_to_car, aside
        for j, (yaw, moved) in enumerate(_bends(path, seconds, ways, speed * turn_rate)):
            design[:, :, len(_PLACE_SD) + j] = self._bent(yaw, moved)
        design[:, :, _FIRST] = aside
        design[:, :, _FIRST + 1] = expected
        design[:, :, _FIRST + 2] = -turn_rate[k, None] * aside
        design[:, 0, _FIRST + 2] -= speed[k]
        seen = np.concatenate([look.points_vehicle_m for look in looks])
        covariance = np.concatenate([look.covariance_m2 for look in looks])
        white = np.linalg.inv(np.linalg.cholesky(covariance + _DETECTION_SD_M**2 * np.eye(2)))
        member = (np.arange(len(poles))[:, None] == column).astype(np.float64)
        target = np.einsum("nij,nj->ni", white, seen - expected)
        share = np.array([look.share for look in looks])[k]
        self._seen = Sightings.of(white @ design, white @ map_to_car, member, target, share)
        pole_var = np.zeros(len(poles))
        pole_var[column] = np.concatenate([look.map_var_m2 for look in looks])
        self._place_prior = 1.0 / np.maximum(pole_var, _POLE_SD_M**2)
        self._prior = 1.0 / np.array(_PLACE_SD + _ODOMETRY_SD + _CALIBRATION_SD) ** 2

    def fit(self, since_m: float) -> StretchFit:
        """Fit what was seen from a way driven on; meaningless where that is nothing."""
        kept = self._seen.rows(self._travelled_m >= since_m)
        solved = solve(kept, self._prior, self._place_prior)
        return _fit_of(solved, slice(_FIRST, _COMMON), self._prior)

    def change(self) -> Change | None:
        """The change of the calibration that fits best; None where no scan has poles enough on
        either side of it.

        Where it lies, and what changes, is found by the score test; by how much, by a fit that
        grants the odometry the loss of some heading at the same place.

        Source: Rao's score test; Andrews (1993), "Tests for parameter instability and structural
        change with unknown change point", Econometrica 61.
        """
        seen = self._seen
        solved = solve(seen, self._prior, self._place_prior)
        poles = np.cumsum(np.bincount(self._k, minlength=self._looks))
        scans = np.cumsum(np.bincount(self._k, minlength=self._looks) > 0)
        # a change at a scan leaves those before it on the other side
        before = np.append(0, poles[:-1])
        enough = (before >= _LEAST_BEFORE) & (poles[-1] - before >= _LEAST_POLES)
        enough &= scans[-1] - np.append(0, scans[:-1]) >= _LEAST_SCANS
        enough &= self._ways >= -_RECENT_M
        places = np.flatnonzero(enough)
        if not len(places):
            return None
        best, look, kind = -np.inf, 0, 0
        for j in range(_FIRST, _COMMON):
            column = seen.common[:, :, j]
            score = self._since(solved.weight * np.einsum("ni,ni->n", column, solved.rest))
            power = self._since(solved.weight * np.einsum("ni,ni->n", column, column))
            shared = self._since(
                solved.weight[:, None] * np.einsum("nic,ni->nc", seen.common, column)
            )
            own = solved.weight[:, None] * np.einsum("nia,ni->na", seen.place, column)
            power = power - solved.variance_of(shared, self._since_at_poles(own))
            power = np.maximum(power, 1e-9)
            excess = (np.abs(score / power) - TOLERANCE[j - _FIRST]) * np.sqrt(power)
            at = int(places[excess[places].argmax()])
            if excess[at] > best:
                best, look, kind = float(excess[at]), at, j - _FIRST
        return self._changed(look, kind)

    def _changed(self, look: int, kind: int) -> Change:
        step = np.where((self._k >= look)[:, None], self._seen.common[:, :, _FIRST + kind], 0.0)
        before = np.arange(self._looks) < look
        back = np.where(before[:, None], _left_of(self._path[:, :2] - self._path[look, :2]), 0.0)
        lost = self._bent(before.astype(np.float64), back)
        # where no pole was seen for a while nobody knows where in it the heading was lost
        last = self._k[self._k < look].max()
        near = (self._ways >= self._ways[last] - _NEAR_M) & (
            self._ways <= self._ways[look] + _NEAR_M
        )
        bend = float(np.ptp(self._path[near, 2]))
        lost_sd = np.hypot(_JUMP_RAD, _JUMP_SHARE * bend)
        sd = 10.0 * _CALIBRATION_SD[kind]
        prior = np.append(self._prior, [1.0 / lost_sd**2, 1.0 / sd**2])
        solved = solve(self._seen.with_columns(lost, step), prior, self._place_prior)
        fit = _fit_of(solved, slice(len(prior) - 1, len(prior)), prior)
        slip = _BEND_RADM * bend / (2.0 * _NEAR_M) if kind == 0 else 0.0
        return Change(look, kind, float(fit.values[0]), float(np.hypot(fit.sd[0], slip)))

    def _bent(self, yaw: Floats, moved: Floats) -> Floats:
        """Rows `(n, 2)` of an error that changes yaw `(m,)` and place `(m, 2)` of the scans."""
        turned = -yaw[self._k, None] * self._aside
        return np.asarray(turned - np.einsum("nij,nj->ni", self._map_to_car, moved[self._k]))

    def _since(self, rows: Floats) -> Floats:
        """Sums over the scans from each one on, of values of the rows."""
        total = np.zeros((self._looks, *rows.shape[1:]))
        np.add.at(total, self._k, rows)
        return np.cumsum(total[::-1], axis=0)[::-1]

    def _since_at_poles(self, rows: Floats) -> Floats:
        """As `_since` of rows `(n, 2)`, for each pole apart: `(m, p, 2)`."""
        total = np.zeros((self._looks, len(self._seen.member), 2))
        np.add.at(total, (self._k, self._column), rows)
        return np.cumsum(total[::-1], axis=0)[::-1]


def _joined(one: tuple[float, float], other: tuple[float, float]) -> tuple[float, float]:
    """Mean of two estimates and its standard deviation; the first alone where they disagree."""
    (a, a_sd), (b, b_sd) = one, other
    if abs(a - b) > _AGREE_SD * np.hypot(a_sd, b_sd):
        return one
    variance = 1.0 / (1.0 / a_sd**2 + 1.0 / b_sd**2)
    return variance * (a / a_sd**2 + b / b_sd**2), float(np.sqrt(variance))


def _fit_of(solved: Solution, chosen: slice, prior: Floats) -> StretchFit:
    """Some of the values; what the prior alone knows of each is taken out again."""
    variance = np.diag(solved.covariance)[chosen]
    alone = 1.0 / np.maximum(1.0 / variance - prior[chosen], 1e-12)
    return StretchFit(
        alone * solved.values[chosen] / variance,
        np.sqrt(alone) * max(1.0, solved.scatter),
        len(solved.rest),
    )


def _left_of(vectors: Floats) -> Floats:
    return np.stack([-vectors[..., 1], vectors[..., 0]], axis=-1)


def _path_to(pose: Floats, odometry: Floats) -> Floats:
    """Dead-reckoned poses `(n, 3)` laid into the map so that the last one is `pose`."""
    last = odometry[-1]
    turn = pose[2] - last[2]
    place = (odometry[:, :2] - last[:2]) @ rotation(turn).T + pose[:2]
    return np.column_stack([place, odometry[:, 2] + turn])


def _bends(
    path: Floats, seconds: Floats, ways: Floats, lateral: Floats
) -> list[tuple[Floats, Floats]]:
    """How yaw `(n,)` and place `(n, 2)` change with each error of the odometry, per unit."""
    step = np.diff(path[:, :2], axis=0, prepend=path[:1, :2])
    still = np.zeros(len(path))

    def summed(rows: Floats) -> Floats:
        total = np.cumsum(rows, axis=0)
        return np.asarray(total - total[-1])

    def aside(angle: Floats) -> Floats:
        middle = np.concatenate([[0.0], 0.5 * (angle[1:] + angle[:-1])])
        return summed(middle[:, None] * _left_of(step))

    turned = path[:, 2] - path[-1, 2]
    return [
        (seconds, aside(seconds)),
        (ways, aside(ways)),
        (still, summed(step)),
        (turned, aside(turned)),
        (still, aside(-lateral)),
    ]
