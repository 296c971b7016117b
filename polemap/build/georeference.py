"""Scans and reference poses to detections in the map's frame: columns, one row a pole a scan."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from polemap.build.config import MappingConfig
from polemap.drivelog.columns import Columns
from polemap.drivelog.detections import Detections, VisibleRegion
from polemap.drivelog.errors import InputError
from polemap.drivelog.frames import EarthFrame, convergence_rad, transform_points
from polemap.drivelog.streams import ReferenceStream
from polemap.vehicle.pose import inverse_transform_points, rotate, rotate_covariance, wrap_angle

Floats = NDArray[np.float64]
Whole = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class ScanViews(Columns):
    """Every moment at which the detector looked, whether it saw a pole or not.

    Attributes:
        stamp_s: `(m,)` sorted.
        poses: `(m, 3)` rear axle in the map's frame.
        origin_vehicle_m: `(m, 2)` of the field of view; `bearing_min_rad`, `bearing_max_rad`,
            `range_min_m` `(m,)`; `free_range_m` `(m, k)`, zero where nothing is known.
    """

    stamp_s: Floats
    poses: Floats
    origin_vehicle_m: Floats
    bearing_min_rad: Floats
    bearing_max_rad: Floats
    range_min_m: Floats
    free_range_m: Floats

    def in_view_at(self, scan: Whole, points_m: Floats) -> tuple[NDArray[np.bool_], Floats, Floats]:
        """Which points `(k, 2)` of the map were in view in scans `(k,)`; range and bearing too.

        Range and bearing `(k,)` are those from the origin of the field of view.
        """
        pose = self.poses[scan]
        x, y = (inverse_transform_points(pose, points_m) - self.origin_vehicle_m[scan]).T
        distance, bearing = np.hypot(x, y), np.arctan2(y, x)
        low, high = self.bearing_min_rad[scan], self.bearing_max_rad[scan]
        bins = self.free_range_m.shape[1]
        column = np.floor((bearing - low) / np.maximum(high - low, 1e-9) * bins).astype(np.int64)
        free = self.free_range_m[scan, np.clip(column, 0, bins - 1)]
        inside = (column >= 0) & (column < bins) & (distance >= self.range_min_m[scan])
        return inside & (distance <= free), distance, bearing


@dataclass(frozen=True, slots=True)
class MapDetections(Columns):
    """What one drive saw; every array has a row a detection, sorted by scan.

    Attributes:
        drive: its name.
        start_s: stamp of its first scan, which puts drives in order.
        scan: row in `views`.
        kind: a `LandmarkKind`.
        points_m: `(n, 2)` in the map's frame.
        covariance_m2: `(n, 2, 2)` of the detector alone, in the map's frame.
        direction_rad: from the car to the pole, from grid east.
        facing_rad: of corners the direction of the free side, from grid east; NaN of other kinds.
        parts: stakes that it stands for, 1 of a single pole.
        reference_sd_m: of the pose it was seen from.
        gain_m_per_px: `(n, 2)` how far an error of one pixel of disparity moves it; zero where no
            stereo camera saw it.
    """

    HEADER: ClassVar[frozenset[str]] = frozenset({"drive", "frame", "views", "without_pose"})

    drive: str
    frame: EarthFrame
    views: ScanViews
    scan: Whole
    kind: NDArray[np.int8]
    points_m: Floats
    covariance_m2: Floats
    width_m: Floats
    height_m: Floats
    range_m: Floats
    direction_rad: Floats
    facing_rad: Floats
    parts: Whole
    reference_sd_m: Floats
    gain_m_per_px: Floats
    without_pose: int = 0

    @property
    def stamp_s(self) -> Floats:
        """Stamp `(n,)` of the scan of every detection."""
        return self.views.stamp_s[self.scan]

    @property
    def start_s(self) -> float:
        """Stamp of the first scan, 0 without any."""
        return float(self.views.stamp_s[0]) if len(self.views) else 0.0


def georeference_scans(
    drive: str,
    drive_frame: EarthFrame,
    scans: Iterable[Detections],
    reference: ReferenceStream,
    config: MappingConfig,
    frame: EarthFrame,
    focal_baseline_px_m: float | None = None,
) -> MapDetections:
    """Put the scans of a drive into the map's frame by the reference.

    Args:
        drive: name of the drive.
        drive_frame: its frame; poses of another UTM zone are transformed into `frame`.
        scans: in the order of their stamps.
        reference: rear-axle poses; scans outside of it are counted in `without_pose`.
        config: settings.
        frame: the map's frame.
        focal_baseline_px_m: focal length times baseline of the stereo camera that saw the poles.

    Raises:
        InputError: no scan has a reference pose.
        FrameError: no transformation leads from the drive's frame to the map's.
    """
    every = list(scans)
    stamps = np.array([scan.stamp_s for scan in every])
    poses = reference.at(stamps) if len(stamps) else np.empty((0, 3))
    known = np.asarray(np.isfinite(poses).all(axis=1), dtype=np.bool_)
    if not known.any():
        raise InputError(
            f"drive {drive}: none of its {len(every)} scans has a reference pose; a map needs a "
            "reference that covers them"
        )
    chosen = [scan for scan, usable in zip(every, known, strict=True) if usable]
    poses = _poses_in(poses[known], drive_frame, frame)
    views = _views(stamps[known], poses, chosen)
    detections = _rows(drive, frame, chosen, views, reference, config)
    detections = replace(detections, without_pose=int(np.count_nonzero(~known)))
    if focal_baseline_px_m is None:
        return detections
    return replace(detections, gain_m_per_px=_disparity_gain(detections, focal_baseline_px_m))


def _disparity_gain(detections: MapDetections, focal_baseline_px_m: float) -> Floats:
    """Displacement `(n, 2)` a pixel: along the ray from the camera, `r^2 / (f b)`."""
    views, row = detections.views, detections.scan
    pose, origin = views.poses[row], views.origin_vehicle_m[row]
    ray = detections.points_m - pose[:, :2] - rotate(origin, pose[:, 2])
    return np.asarray(ray * np.hypot(ray[:, 0], ray[:, 1])[:, None] / focal_baseline_px_m)


def take_scans(detections: MapDetections, chosen: NDArray[np.bool_]) -> tuple[MapDetections, Whole]:
    """The drive with some of its scans only, and the rows of the detections that are left."""
    taken = np.flatnonzero(chosen[detections.scan])
    number = np.cumsum(chosen) - 1
    kept = detections.take(taken).with_columns(scan=number[detections.scan[taken]])
    return replace(kept, views=detections.views.take(chosen)), taken


def _poses_in(poses: Floats, source: EarthFrame, target: EarthFrame) -> Floats:
    if source == target:
        return poses
    points = transform_points(poses[:, :2], source, target)
    turn = convergence_rad(target, points) - convergence_rad(source, poses[:, :2])
    return np.column_stack([points, wrap_angle(poses[:, 2] + turn)])


def _views(stamps: Floats, poses: Floats, scans: list[Detections]) -> ScanViews:
    regions = [scan.view for scan in scans]
    bins = max((len(view.free_range_m) for view in regions if view is not None), default=1)
    return ScanViews(
        stamp_s=stamps,
        poses=poses,
        origin_vehicle_m=np.array([v.origin_vehicle_m if v else (0.0, 0.0) for v in regions]),
        bearing_min_rad=np.array([v.bearing_min_rad if v else 0.0 for v in regions]),
        bearing_max_rad=np.array([v.bearing_max_rad if v else 0.0 for v in regions]),
        range_min_m=np.array([v.range_min_m if v else 0.0 for v in regions]),
        free_range_m=np.stack([_free(view, bins) for view in regions]),
    )


def _free(view: VisibleRegion | None, bins: int) -> Floats:
    """The free ranges of a view spread over `bins`; a view that is not known sees nothing."""
    if view is None:
        return np.zeros(bins)
    source = np.arange(bins) * len(view.free_range_m) // bins
    return np.asarray(view.free_range_m, dtype=np.float64)[source]


def _rows(
    drive: str,
    frame: EarthFrame,
    scans: list[Detections],
    views: ScanViews,
    reference: ReferenceStream,
    config: MappingConfig,
) -> MapDetections:
    scan = np.repeat(np.arange(len(scans)), [len(scan) for scan in scans]).astype(np.int64)
    seen = Detections.concatenate(scans)
    points, covariance = seen.points_vehicle_m, seen.covariance_m2
    distance = np.hypot(points[:, 0], points[:, 1])
    usable = np.isfinite(points).all(axis=1) & (distance <= config.range_max_m)
    usable &= np.isfinite(covariance).all(axis=(1, 2))
    scan, points, covariance = scan[usable], points[usable], covariance[usable]
    pose = views.poses[scan]
    in_map = rotate(points, pose[:, 2])
    sd = reference.sd_at(views.stamp_s)[scan]
    return MapDetections(
        drive=drive,
        frame=frame,
        views=views,
        scan=scan,
        kind=seen.kind[usable],
        points_m=in_map + pose[:, :2],
        covariance_m2=rotate_covariance(covariance, pose[:, 2]),
        width_m=seen.width_m[usable],
        height_m=seen.height_m[usable],
        range_m=distance[usable],
        direction_rad=np.arctan2(in_map[:, 1], in_map[:, 0]),
        facing_rad=seen.facing_rad[usable] + pose[:, 2],
        parts=seen.parts[usable],
        reference_sd_m=np.where(np.isfinite(sd), sd, config.reference_sd_m),
        gain_m_per_px=np.zeros((len(scan), 2)),
    )
