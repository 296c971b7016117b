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

from polemap.vehicle.pose import rotation

Floats = NDArray[np.float64]

# sd before the stretch is seen: place of it, m, and heading, rad; of the odometry the yaw rate's
# offset, rad/s, and that of the curvature, 1/m (a steering that is not in its middle), the scales
# of speed and turn, and the side-slip for a lateral acceleration, rad per m/s^2
_PLACE_SD = (3.0, 3.0, 0.1)
_ODOMETRY_SD = (0.004, 0.002, 0.03, 0.04, 0.005)
# of the calibration: turn, rad, scale of the ranges, stamps, s
_CALIBRATION_SD = (0.012, 0.02, 0.1)
# a map pole is known no better, and a detection, m
_POLE_SD_M, _DETECTION_SD_M = 0.05, 0.03
# of Huber's loss, in standard deviations of a detection; rounds of reweighting
_HUBER, _ROUNDS = 2.5, 3
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
        self._travelled_m = np.array([look.travelled_m for look in looks])[k]
        self._share = np.array([look.share for look in looks])[k]
        path = _path_to(pose, np.array([look.odometry_pose for look in looks]))
        speed = np.array([look.speed_mps for look in looks])
        turn_rate = np.array([look.yaw_rate_radps for look in looks])
        seconds = np.array([look.stamp_s for look in looks]) - looks[-1].stamp_s

        map_to_car = np.swapaxes(rotation(path[:, 2]), 1, 2)[k]
        expected = np.einsum("nij,nj->ni", map_to_car, mapped - path[k, :2])
        aside = _left_of(expected)
        design = np.zeros((len(k), 2, _COMMON + 2 * len(poles)))
        design[:, :, :2] = -map_to_car
        design[:, :, 2] = -np.einsum("nij,nj->ni", map_to_car, _left_of(mapped - pose[:2]))
        ways = np.array([look.travelled_m for look in looks]) - looks[-1].travelled_m
        for j, (yaw, moved) in enumerate(_bends(path, seconds, ways, speed * turn_rate)):
            design[:, :, len(_PLACE_SD) + j] = (
                -np.einsum("nij,nj->ni", map_to_car, moved[k]) - yaw[k, None] * aside
            )
        design[:, :, _FIRST] = aside
        design[:, :, _FIRST + 1] = expected
        design[:, :, _FIRST + 2] = -turn_rate[k, None] * aside
        design[:, 0, _FIRST + 2] -= speed[k]
        rows = np.arange(len(k))
        for axis in (0, 1):
            design[rows, :, _COMMON + 2 * column + axis] = map_to_car[:, :, axis]
        seen = np.concatenate([look.points_vehicle_m for look in looks])
        covariance = np.concatenate([look.covariance_m2 for look in looks])
        white = np.linalg.inv(np.linalg.cholesky(covariance + _DETECTION_SD_M**2 * np.eye(2)))
        self._design = white @ design
        self._target = np.einsum("nij,nj->ni", white, seen - expected)
        pole_var = np.zeros(len(poles))
        pole_var[column] = np.concatenate([look.map_var_m2 for look in looks])
        sd = np.array(_PLACE_SD + _ODOMETRY_SD + _CALIBRATION_SD)
        self._prior = np.concatenate(
            [1.0 / sd**2, np.repeat(1.0 / np.maximum(pole_var, _POLE_SD_M**2), 2)]
        )

    def fit(self, since_m: float) -> StretchFit:
        """Fit what was seen from a way driven on; meaningless where that is nothing.

        Source: Huber, Robust Statistics, chapter 7; the scatter's factor as Birge (1932).
        """
        kept = self._travelled_m >= since_m
        design, target = self._design[kept], self._target[kept]
        share = self._share[kept]
        weight = np.ones(len(target))
        flat = design.reshape(-1, design.shape[2])
        scatter = 1.0
        for _ in range(_ROUNDS):
            weighted = design * (share * weight)[:, None, None]
            covariance = np.linalg.inv(weighted.reshape(flat.shape).T @ flat + np.diag(self._prior))
            values = covariance @ (weighted.reshape(flat.shape).T @ target.ravel())
            rest = np.hypot(*(target - design @ values).T)
            weight = np.minimum(1.0, _HUBER / np.maximum(rest, 1e-9))
            scatter = float(np.sqrt(0.5 * np.mean(np.minimum(rest, 2.0 * _HUBER) ** 2)))
        chosen = slice(_FIRST, _COMMON)
        variance = np.diag(covariance)[chosen]
        # what the prior alone knows of each is taken out again
        alone = 1.0 / np.maximum(1.0 / variance - self._prior[chosen], 1e-12)
        return StretchFit(
            alone * values[chosen] / variance, np.sqrt(alone) * max(1.0, scatter), len(target)
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
