"""Drives in the middle of a city's map, for what a localizer costs there."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.detections import Detections, VisibleRegion, pole_detections
from polemap.drivelog.samples import GnssFix, OdometrySample
from polemap.map.city.city_map import CityMap
from polemap.map.city.io import open_map
from polemap.map.pole_map import PoleMap
from polemap.vehicle.pose import inverse_transform_points

Floats = NDArray[np.float64]
Samples = list[OdometrySample | GnssFix | Detections]

_FEW = 200
_VIEW = VisibleRegion(np.array([1.5, 0.0]), -0.7, 0.7, 2.0, np.full(32, 40.0))
_SEEN_SHARE, _SD_M = 0.8, 0.1
# a circle that stays among the 200 poles, and a way that needs several windows
_CIRCLE_M, _SPEED_MPS, _DURATION_S = 15.0, 6.0, 60.0
_WAY_MPS, _SCANS_HZ, _ODOMETRY_HZ = 14.0, 10, 50


def circle(stamp_s: float, middle: Floats) -> Floats:
    """Pose `(3,)` on the circle."""
    angle = _SPEED_MPS / _CIRCLE_M * stamp_s
    place = middle + _CIRCLE_M * np.array([np.cos(angle), np.sin(angle)])
    return np.array([*place, angle + np.pi / 2])


def way(stamp_s: float, start: Floats) -> Floats:
    """Pose `(3,)` on a straight way to the north-east."""
    return np.array([*(start + _WAY_MPS * stamp_s / np.sqrt(2.0)), np.pi / 4])


def drive(path: Path, straight: bool) -> tuple[Samples, Floats]:
    """Samples of a drive in a map, and its first pose."""
    pole_map = open_map(path)
    middle = _middle(pole_map)
    rng = np.random.default_rng(0)
    pose_at = way if straight else circle
    speed, rate = (_WAY_MPS, 0.0) if straight else (_SPEED_MPS, _SPEED_MPS / _CIRCLE_M)
    samples: Samples = []
    for tick in range(round(_DURATION_S * _ODOMETRY_HZ)):
        stamp = tick / _ODOMETRY_HZ
        noise = rng.standard_normal(2) * (0.05, 0.002)
        samples.append(OdometrySample(stamp, stamp, speed + noise[0], rate + noise[1]))
        pose = pose_at(stamp, middle)
        if tick % _ODOMETRY_HZ == 0:
            east, north = (pose[:2] + rng.standard_normal(2)).tolist()
            samples.append(GnssFix(stamp, stamp, east, north, 1.0))
        if tick % (_ODOMETRY_HZ // _SCANS_HZ) == 0:
            samples.append(scan_from(stamp, pose, pole_map, rng))
    return samples, pose_at(0.0, middle)


def _middle(pole_map: PoleMap | CityMap) -> Floats:
    points = pole_map.points_m if isinstance(pole_map, PoleMap) else None
    extent = (
        np.array(pole_map.statistics.extent_m).reshape(2, 2)
        if isinstance(pole_map, CityMap)
        else np.stack([points.min(axis=0), points.max(axis=0)])  # type: ignore[union-attr]
    )
    return np.asarray(extent.mean(axis=0))


def _around(pole_map: PoleMap | CityMap, place: Floats, radius_m: float) -> PoleMap:
    if isinstance(pole_map, CityMap):
        return pole_map.poles_within(place, radius_m)
    return pole_map.rows(pole_map.within(place, radius_m))


def scan_from(
    stamp_s: float, pose: Floats, pole_map: PoleMap | CityMap, rng: np.random.Generator
) -> Detections:
    around = _around(pole_map, pose[:2], 45.0)
    local = inverse_transform_points(pose, around.points_m)
    seen = _VIEW.contains(local) & (rng.random(len(local)) < _SEEN_SHARE)
    points = local[seen] + _SD_M * rng.standard_normal((int(seen.sum()), 2))
    return pole_detections(
        stamp_s, stamp_s, points, np.tile(np.eye(2) * _SD_M**2, (len(points), 1, 1)),
        width_m=around.width_m[seen], view=_VIEW,
    )  # fmt: skip


def few(pole_map: PoleMap | CityMap, start: Floats) -> PoleMap:
    """The 200 poles around the circle."""
    around = _around(pole_map, start[:2], 400.0)
    order = np.argsort(np.hypot(*(around.points_m - start[:2]).T), kind="stable")
    return around.rows(np.sort(order[:_FEW]))
