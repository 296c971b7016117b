"""How well the mapped poles would allow to localize along the route, before any filter.

The Cramér–Rao bound of one look: every mapped pole within view adds p_D A' (R + S)^-1 A to the
information on (along, across, heading), A = [[-1, 0, y], [0, -1, -x]] for a pole at (x, y) in the
vehicle frame, R the measurement's and S the map's covariance. Source: S16 (7), (8) for the
likelihood; the bound is its curvature.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivelog.errors import ConfigError
from polemap.landmark_map import PoleMap
from tools.report.results import RouteResult
from tools.report.sweep_spec import settings_of
from tools.report.trajectory import Trajectory
from tools.settings import Settings

Floats = NDArray[np.float64]

STEP_M = 4.0
# What a car knows of its heading without any pole: a wide prior keeps the bound finite.
HEADING_PRIOR_RAD = 0.2
POSITION_PRIOR_M = 10.0
# focal length in pixels and baseline in metres, where the drive has no camera
DEFAULT_CAMERA = (800.0, 0.5)


@dataclass(frozen=True, slots=True)
class SensorModel:
    """Where poles are seen and how well: `along` grows with the square of the range.

    sd along the ray = `along_m` + `along_per_m2` r^2; across it = `across_m` + `across_rad` r.
    """

    range_m: float
    half_angle_rad: float
    p_detection: float
    along_m: float
    along_per_m2: float
    across_m: float
    across_rad: float


@dataclass(frozen=True, slots=True)
class Bound:
    """Along the driven line: `(n, 2)` points, `(n,)` distance, bounds and poles in view."""

    points_m: Floats
    distance_m: Floats
    lateral_sd_m: Floats
    longitudinal_sd_m: Floats
    in_view: NDArray[np.int64]


def stereo_sensor(settings: Settings, focal_px: float, baseline_m: float) -> SensorModel:
    """The error model of the detector's settings for a camera."""
    detection, localize = settings.polemap.detection, settings.localize
    return SensorModel(
        localize.view_range_m,
        localize.view_half_angle_rad,
        localize.p_detection,
        0.03,
        detection.disparity_sd_px / (focal_px * baseline_m),
        detection.across_sd_m,
        detection.column_sd_px / focal_px,
    )


def route_bound(result: RouteResult) -> tuple[Bound, SensorModel, bool] | None:
    """The bound along a route's first recording, its sensor, and whether that is the drive's own.

    None where there is no map, or the settings of the run are of another version.
    """
    recording, poles = result.route.recordings[0], result.route.pole_map
    if poles is None or len(poles) == 0:
        return None
    try:
        settings = settings_of(recording.main.config, ())
    except ConfigError:
        return None
    rig = recording.drive.rig if recording.drive else None
    focal_px, baseline_m = (rig.focal_px, rig.baseline_m) if rig else DEFAULT_CAMERA
    sensor = stereo_sensor(settings, focal_px, baseline_m)
    return localizability(recording.guide, poles, sensor), sensor, rig is not None


def localizability(track: Trajectory, pole_map: PoleMap, sensor: SensorModel) -> Bound:
    """The bound every `STEP_M` along a trajectory."""
    line = track.thinned(STEP_M)
    lateral, along = np.empty(len(line)), np.empty(len(line))
    count = np.zeros(len(line), dtype=np.int64)
    prior = np.diag([POSITION_PRIOR_M**-2, POSITION_PRIOR_M**-2, HEADING_PRIOR_RAD**-2])
    for row, (east, north, yaw) in enumerate(line.poses):
        rows = pole_map.within(np.array([east, north]), sensor.range_m)
        cos, sin = np.cos(yaw), np.sin(yaw)
        vehicle_from_map = np.array([[cos, sin], [-sin, cos]])
        points = (pole_map.points_m[rows] - (east, north)) @ vehicle_from_map.T
        distance = np.hypot(points[:, 0], points[:, 1])
        bearing = np.arctan2(points[:, 1], points[:, 0])
        seen = (np.abs(bearing) <= sensor.half_angle_rad) & (distance > 1.0)
        information = prior.copy()
        for (x, y), r, angle, pole in zip(
            points[seen], distance[seen], bearing[seen], rows[seen], strict=True
        ):
            ray = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
            sds = [sensor.along_m + sensor.along_per_m2 * r * r,
                   sensor.across_m + sensor.across_rad * r]  # fmt: skip
            noise = ray @ np.diag(np.square(sds)) @ ray.T
            noise += vehicle_from_map @ pole_map.covariance_m2[pole] @ vehicle_from_map.T
            jacobian = np.array([[-1.0, 0.0, y], [0.0, -1.0, -x]])
            weight = sensor.p_detection * float(pole_map.existence[pole])
            information += weight * jacobian.T @ np.linalg.solve(noise, jacobian)
        covariance = np.linalg.inv(information)
        along[row], lateral[row] = np.sqrt(covariance[0, 0]), np.sqrt(covariance[1, 1])
        count[row] = int(seen.sum())
    return Bound(line.poses[:, :2], line.travelled_m(), lateral, along, count)
