"""How well the poles in view would locate a car, before anyone drives there.

At each pose the Fisher information of the poles that could be seen is

    J = J_0 + sum_i  w_i H_i^T (S_i + P_i)^-1 H_i,      H_i = d h_i / d (longitudinal, lateral, yaw)

with `h` the pole in the vehicle frame, `S` the detector's and `P` the map's covariance, `w` the
probability that the pole stands and is seen, and `J_0` what was known before. `J^-1` bounds the
covariance of a pose from a single look (Cramer-Rao); a filter with odometry does better.

Source: the likelihood is that of Spangenberg (2016), equations (7) and (8); the bound is its
curvature.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from polemap.detect.config import DetectionConfig
from polemap.detect.constants import ACROSS_SD_M, AXIS_SD_SHARE, COLUMN_SD_PX, DISPARITY_SD_PX
from polemap.detect.visibility import camera_sector
from polemap.drivelog.detections import Detections, VisibleRegion, pole_view
from polemap.drivelog.drive import Drive
from polemap.map.pole_map import PoleMap
from polemap.vehicle.pose import inverse_transform_points, rotate_covariance

Floats = NDArray[np.float64]

# information so small that one pole alone gives no finite bound but no failure
_WEAK = 1e-6
# of a pole: the share of its width by which its axis is uncertain is an error of the range
_WIDTH_M = 0.2


@dataclass(frozen=True, slots=True)
class SensorModel:
    """Where a sensor sees poles, how surely and how well.

    The variance of a detection at range r is `along_m`^2 + (`along_per_m2` r^2)^2 along its ray and
    `across_m`^2 + (`across_rad` r)^2 across it.
    """

    view: VisibleRegion
    p_detection: float
    along_m: float
    along_per_m2: float
    across_m: float
    across_rad: float

    def covariance(self, points_vehicle_m: Floats) -> Floats:
        """Covariance `(n, 2, 2)` of detections at `(n, 2)`, in the axes of the vehicle."""
        distance, ray, side = _rays(points_vehicle_m, self.view)
        along = self.along_m**2 + (self.along_per_m2 * distance**2) ** 2
        across = self.across_m**2 + (self.across_rad * distance) ** 2
        return np.asarray(
            along[:, None, None] * ray[:, :, None] * ray[:, None, :]
            + across[:, None, None] * side[:, :, None] * side[:, None, :]
        )


def camera_sensor(
    view: VisibleRegion,
    focal_px: float,
    baseline_m: float,
    p_detection: float,
) -> SensorModel:
    """The detector's own error model for a stereo camera."""
    return SensorModel(
        view,
        p_detection,
        AXIS_SD_SHARE * _WIDTH_M,
        DISPARITY_SD_PX / (focal_px * baseline_m),
        ACROSS_SD_M,
        COLUMN_SD_PX / focal_px,
    )


def scans_sensor(scans: tuple[Detections, ...], p_detection: float) -> SensorModel | None:
    """What a detector states of its detections, as a model; None without view or detections."""
    view = pole_view(scans)
    if view is None or not any(len(scan) for scan in scans):
        return None
    points = np.concatenate([scan.points_vehicle_m for scan in scans])
    covariance = np.concatenate([scan.covariance_m2 for scan in scans])
    distance, ray, side = _rays(points, view)

    def parts(direction: Floats, growth: Floats) -> tuple[float, float]:
        stated = np.einsum("ni,nij,nj->n", direction, covariance, direction)
        # relative to each value, or the far ones would decide alone
        terms = np.stack([np.ones_like(growth), growth**2], axis=1) / stated[:, None]
        constant, growing = np.sqrt(scipy.optimize.nnls(terms, np.ones(len(terms)))[0])
        return float(constant), float(growing)

    return SensorModel(view, p_detection, *parts(ray, distance**2), *parts(side, distance))


def drive_sensor(drive: Drive, config: DetectionConfig, p_detection: float) -> SensorModel | None:
    """The sensor that a drive was recorded with; None if the drive does not say.

    Its camera where the poles come from images, else what the poles beside it state.
    """
    rig = drive.rig
    if rig is not None and (drive.has_frames or not drive.scans):
        view = camera_sector(rig, config)
        return camera_sensor(view, rig.focal_px, rig.baseline_m, p_detection)
    return scans_sensor(drive.scans, p_detection)


@dataclass(frozen=True, slots=True)
class Localizability:
    """Bounds at each pose; every array `(n,)`, infinite where nothing tells.

    Attributes:
        poses: `(n, 3)`.
        distance_m: along the line through the poses, from the first.
        poles_in_view: expected number of detections, existence and detection included.
        lateral_sd_m, longitudinal_sd_m, yaw_sd_rad: of one look.
    """

    poses: Floats
    distance_m: Floats
    poles_in_view: Floats
    lateral_sd_m: Floats
    longitudinal_sd_m: Floats
    yaw_sd_rad: Floats


def localizability(
    pole_map: PoleMap,
    poses: Floats,
    sensor: SensorModel,
    *,
    step_m: float = 0.0,
    prior_sd: tuple[float, float] = (np.inf, np.inf),
) -> Localizability:
    """Bounds on the pose along a route.

    Args:
        pole_map: the map.
        poses: `(n, 3)` rear axle in the map's frame.
        sensor: what it sees of poles.
        step_m: keeps one pose in so many metres of the way; 0 keeps all.
        prior_sd: of the position (m) and of the heading (rad) before the look.
    """
    poses = np.asarray(poses, dtype=np.float64)
    distance = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(poses[:, :2], axis=0).T))])
    if step_m > 0.0:
        _, rows = np.unique(np.floor(distance / step_m), return_index=True)
        poses, distance = poses[rows], distance[rows]
    information = np.zeros((len(poses), 3, 3))
    expected = np.zeros(len(poses))
    for row, pose in enumerate(poses):
        seen = pole_map.in_view(pose, sensor.view)
        if not len(seen):
            continue
        weight = sensor.p_detection * pole_map.existence[seen]
        information[row] = _information(pole_map, seen, pose, weight, sensor)
        expected[row] = weight.sum()
    position_sd_m, yaw_sd_rad = prior_sd
    prior = np.array([position_sd_m, position_sd_m, yaw_sd_rad]) ** -2.0
    bound = np.linalg.inv(information + np.diag(np.maximum(prior, _WEAK)))
    sd = np.sqrt(np.diagonal(bound, axis1=1, axis2=2))
    sd = np.where(sd < 0.5 / np.sqrt(_WEAK), sd, np.inf)
    return Localizability(poses, distance, expected, sd[:, 1], sd[:, 0], sd[:, 2])


def _information(
    pole_map: PoleMap, rows: NDArray[np.int64], pose: Floats, weight: Floats, sensor: SensorModel
) -> Floats:
    local = inverse_transform_points(pose, pole_map.points_m[rows])
    own = rotate_covariance(pole_map.covariance_m2[rows], -pose[2])
    spread = own + sensor.covariance(local)
    jacobian = np.zeros((len(rows), 2, 3))
    jacobian[:, 0, 0] = jacobian[:, 1, 1] = -1.0
    jacobian[:, 0, 2], jacobian[:, 1, 2] = local[:, 1], -local[:, 0]
    weighted = np.linalg.solve(spread, jacobian) * weight[:, None, None]
    return np.asarray(np.einsum("nij,nik->jk", jacobian, weighted))


def _rays(points_vehicle_m: Floats, view: VisibleRegion) -> tuple[Floats, Floats, Floats]:
    """Distance `(n,)` from the sensor, unit vectors `(n, 2)` along and across the rays."""
    offset = points_vehicle_m - view.origin_vehicle_m
    distance = np.hypot(offset[:, 0], offset[:, 1])
    ray = offset / np.maximum(distance, 1e-9)[:, None]
    return distance, ray, np.stack([-ray[:, 1], ray[:, 0]], axis=1)
