"""How well the landmarks in view would locate a car, before anyone drives there.

At each pose the Fisher information of the poles and corners that could be seen is

    J = J_0 + sum_i  w_i H_i^T (S_i + P_i)^-1 H_i,      H_i = d h_i / d (longitudinal, lateral, yaw)

with `h` the pole in the vehicle frame, `S` the detector's and `P` the map's covariance, `w` the
probability that the pole stands and is seen, and `J_0` what was known before. A line beside the car
adds the same of its offset and of its direction (`line_information.py`), which say nothing along
it. `J^-1` bounds the covariance of a pose from a single look (Cramer-Rao); a filter with odometry
does better.

Source: the likelihood is that of Spangenberg (2016), equations (7) and (8); the bound is its
curvature.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import scipy
from numpy.typing import NDArray

from polemap.detect.config import DetectionConfig
from polemap.detect.constants import ACROSS_SD_M, AXIS_SD_SHARE, COLUMN_SD_PX, DISPARITY_SD_PX
from polemap.detect.visibility import camera_sector
from polemap.drivelog.detections import Detections, VisibleRegion, pole_view
from polemap.drivelog.drive import Drive
from polemap.drivelog.landmark_kind import POINT_KINDS, LandmarkKind, kind_name
from polemap.evaluation.line_information import LineSds, line_information, stated_sds
from polemap.localize.particle_filter.corner_sides import CORNER_DETECTION
from polemap.map.pole_map import PoleMap
from polemap.vehicle.pose import inverse_transform_points, rotate_covariance

Floats = NDArray[np.float64]

# information so small that one pole alone gives no finite bound but no failure
_WEAK = 1e-6
# of a pole: the share of its width by which its axis is uncertain is an error of the range
_WIDTH_M = 0.2
HELD_SD_M = 0.5
"""A kind that allows this much in one look holds the pose."""
PLACE_SD_M, HEADING_SD_RAD = 5.0, 0.02
"""Of place and heading before the look, where one kind is asked for alone: as odometry keeps them.
"""


@dataclass(frozen=True, slots=True)
class SensorModel:
    """Where a sensor sees poles, how surely and how well.

    The variance of a detection at range r is `along_m`^2 + (`along_per_m2` r^2)^2 along its ray and
    `across_m`^2 + (`across_rad` r)^2 across it. `line_sd` holds by kind what the pieces of lines
    state, across (m) and of their direction (rad).
    """

    view: VisibleRegion
    p_detection: float
    along_m: float
    along_per_m2: float
    across_m: float
    across_rad: float
    line_sd: LineSds = field(default_factory=dict)

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
    sensor = scans_sensor(drive.scans, p_detection)
    if rig is not None and (drive.has_frames or not drive.scans):
        view = camera_sector(rig, config)
        sensor = camera_sensor(view, rig.focal_px, rig.baseline_m, p_detection)
    return None if sensor is None else replace(sensor, line_sd=stated_sds(drive.scans))


@dataclass(frozen=True, slots=True)
class KindBound:
    """What one kind of landmarks allows alone, `(n,)` each, place and heading being known to
    `PLACE_SD_M` and `HEADING_SD_RAD` before.

    Attributes:
        expected: number of detections (of lines: of lines, not pieces).
        lateral_sd_m, longitudinal_sd_m: of one look.
    """

    expected: Floats
    lateral_sd_m: Floats
    longitudinal_sd_m: Floats


@dataclass(frozen=True, slots=True)
class Localizability:
    """Bounds at each pose; every array `(n,)`, infinite where nothing tells.

    Attributes:
        poses: `(n, 3)`.
        distance_m: along the line through the poses, from the first.
        poles_in_view: expected number of detections, existence and detection included.
        lateral_sd_m, longitudinal_sd_m, yaw_sd_rad: of one look.
        by_kind: of every kind that the map holds.
    """

    poses: Floats
    distance_m: Floats
    poles_in_view: Floats
    lateral_sd_m: Floats
    longitudinal_sd_m: Floats
    yaw_sd_rad: Floats
    by_kind: Mapping[LandmarkKind, KindBound] = field(default_factory=dict)

    def holding(self, kind: LandmarkKind) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Where `(n,)` a kind alone holds the pose aside, and along the street."""
        one = self.by_kind[kind]
        return one.lateral_sd_m <= HELD_SD_M, one.longitudinal_sd_m <= HELD_SD_M


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
    kinds = map_kinds(pole_map)
    information = {kind: np.zeros((len(poses), 3, 3)) for kind in kinds}
    expected = {kind: np.zeros(len(poses)) for kind in kinds}
    for row, pose in enumerate(poses):
        seen = pole_map.in_view(pose, sensor.view)
        for kind in POINT_KINDS.intersection(kinds):
            mine = seen[pole_map.kind[seen] == kind]
            if not len(mine):
                continue
            weight = sensor.p_detection * pole_map.existence[mine]
            weight = weight * (CORNER_DETECTION if kind == LandmarkKind.CORNER else 1.0)
            information[kind][row] = _information(pole_map, mine, pose, weight, sensor)
            expected[kind][row] = weight.sum()
        if pole_map.lines is not None:
            for kind, told in line_information(pole_map.lines, pose, sensor.line_sd).items():
                information[kind][row], expected[kind][row] = told
    total = np.sum([*information.values(), np.zeros((len(poses), 3, 3))], axis=0)
    sd = _bounds(total, *prior_sd)
    by_kind = {}
    for kind in kinds:
        alone = _bounds(information[kind], PLACE_SD_M, HEADING_SD_RAD)
        by_kind[kind] = KindBound(expected[kind], alone[:, 1], alone[:, 0])
    poles = expected.get(LandmarkKind.POLE, np.zeros(len(poses)))
    return Localizability(poses, distance, poles, sd[:, 1], sd[:, 0], sd[:, 2], by_kind)


def map_kinds(pole_map: PoleMap) -> list[LandmarkKind]:
    """Kinds of landmarks that a map holds, in the order of their numbers."""
    held = set(pole_map.kind.tolist())
    if pole_map.lines is not None:
        held.update(pole_map.lines.kind.tolist())
    return sorted(kind for kind in LandmarkKind if kind in held)


def held_shares(parts: Sequence[Localizability]) -> list[tuple[str, float, float]]:
    """Of each kind the shares of the poses that it alone holds aside and along, and last of
    those that none does."""
    kinds = sorted({kind for part in parts for kind in part.by_kind})
    count = sum(len(part.poses) for part in parts)
    free = [np.ones((2, len(part.poses)), dtype=np.bool_) for part in parts]
    rows = []
    for kind in kinds:
        total = np.zeros(2)
        for part, left in zip(parts, free, strict=True):
            if kind in part.by_kind:
                held = np.array(part.holding(kind))
                left &= ~held
                total += held.sum(axis=1)
        name = kind_name(kind)
        rows.append((name, *(total / max(count, 1)).tolist()))
    none = np.sum([left.sum(axis=1) for left in free], axis=0) / max(count, 1)
    return [*rows, ("none", *none.tolist())]


def _bounds(information: Floats, position_sd_m: float, yaw_sd_rad: float) -> Floats:
    """Deviations `(n, 3)` along, aside and of the yaw; infinite where nothing tells."""
    prior = np.array([position_sd_m, position_sd_m, yaw_sd_rad]) ** -2.0
    bound = np.linalg.inv(information + np.diag(np.maximum(prior, _WEAK)))
    sd = np.sqrt(np.diagonal(bound, axis1=1, axis2=2))
    return np.where(sd < 0.5 / np.sqrt(_WEAK), sd, np.inf)


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
