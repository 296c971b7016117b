"""How well the poles in view would locate a car, before anyone drives there.

At each pose the Fisher information of the poles that could be seen is

    J = sum_i  w_i H_i^T (S_i + P_i)^-1 H_i,      H_i = d h_i / d (longitudinal, lateral, yaw)

with `h` the pole in the vehicle frame, `S` the detector's and `P` the map's covariance, and `w` the
probability that the pole stands and is seen. `J^-1` bounds the covariance of a pose from a single
look without any other sensor (Cramer-Rao); a filter with odometry does better.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivelog.samples import VisibleRegion
from polemap.landmark_map import PoleMap
from stereo.rig import StereoRig

Floats = NDArray[np.float64]

_DISPARITY_SD_PX = 0.5
_COLUMN_SD_PX = 1.0
_PLAIN_SD_M = 0.1
_WEAK = 1e-6  # information so small that one pole alone gives no finite bound but no failure


@dataclass(frozen=True, slots=True)
class Localizability:
    """Bounds at each pose; every array `(n,)`, infinite where the poles do not tell.

    Attributes:
        poses: `(n, 3)`.
        poles_in_view: expected number of sightings, existence and detection included.
        lateral_sd_m, longitudinal_sd_m, yaw_sd_rad: of one look.
    """

    poses: Floats
    poles_in_view: Floats
    lateral_sd_m: Floats
    longitudinal_sd_m: Floats
    yaw_sd_rad: Floats


def localizability(
    pole_map: PoleMap,
    poses: Floats,
    view: VisibleRegion,
    *,
    rig: StereoRig | None = None,
    detection: float = 0.7,
) -> Localizability:
    """Bounds on the pose along a route.

    Args:
        pole_map: the map.
        poses: `(n, 3)` rear axle in the map's frame.
        view: the sensor's field of view.
        rig: tells how range errors grow; without it 0.1 m an axis is taken.
        detection: probability that a pole in view is seen.
    """
    n = len(poses)
    information = np.zeros((n, 3, 3))
    expected = np.zeros(n)
    for row, pose in enumerate(poses):
        seen = pole_map.in_view(pose, view)
        if not len(seen):
            continue
        weight = detection * pole_map.existence[seen]
        information[row] = _information(pole_map, seen, pose, weight, view, rig)
        expected[row] = weight.sum()
    bound = np.linalg.inv(information + _WEAK * np.eye(3))
    sd = np.sqrt(np.diagonal(bound, axis1=1, axis2=2))
    sd = np.where(sd < 0.5 / np.sqrt(_WEAK), sd, np.inf)
    return Localizability(poses, expected, sd[:, 1], sd[:, 0], sd[:, 2])


def _information(
    pole_map: PoleMap,
    rows: NDArray[np.int64],
    pose: Floats,
    weight: Floats,
    view: VisibleRegion,
    rig: StereoRig | None,
) -> Floats:
    c, s = np.cos(pose[2]), np.sin(pose[2])
    vehicle_from_map = np.array([[c, s], [-s, c]])
    local = (pole_map.points_m[rows] - pose[:2]) @ vehicle_from_map.T
    own = vehicle_from_map @ pole_map.covariance_m2[rows] @ vehicle_from_map.T
    spread = own + sensor_covariance(local - view.origin_vehicle_m, rig)
    jacobian = np.zeros((len(rows), 2, 3))
    jacobian[:, 0, 0] = jacobian[:, 1, 1] = -1.0
    jacobian[:, 0, 2], jacobian[:, 1, 2] = local[:, 1], -local[:, 0]
    weighted = np.linalg.solve(spread, jacobian) * weight[:, None, None]
    return np.asarray(np.einsum("nij,nik->jk", jacobian, weighted))


def sensor_covariance(offset_m: Floats, rig: StereoRig | None) -> Floats:
    """Covariance `(n, 2, 2)` of a sighting at `offset_m` `(n, 2)` from the sensor.

    A stereo camera errs along the ray by `z^2 sd_d / (f b)` and across it by `z sd_u / f`.
    """
    n = len(offset_m)
    if rig is None:
        return np.tile(np.eye(2) * _PLAIN_SD_M**2, (n, 1, 1))
    distance = np.hypot(offset_m[:, 0], offset_m[:, 1])
    ray = offset_m / np.maximum(distance, 1e-9)[:, None]
    side = np.stack([-ray[:, 1], ray[:, 0]], axis=1)
    along = distance**2 * _DISPARITY_SD_PX / (rig.focal_px * rig.baseline_m)
    across = distance * _COLUMN_SD_PX / rig.focal_px
    return np.asarray(
        (along**2)[:, None, None] * ray[:, :, None] * ray[:, None, :]
        + (across**2)[:, None, None] * side[:, :, None] * side[:, None, :]
        + 0.02**2 * np.eye(2)
    )
