"""What a recording of a run shows, before it is written for one viewer or another.

Viewers draw in single precision, so everything stands relative to an origin near the drive.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.detections import Detections
from polemap.drivelog.errors import InputError
from polemap.drivelog.frames import EarthFrame
from polemap.drivelog.samples import Image
from polemap.map.pole_map import PoleMap
from polemap.settings import Settings
from polemap.stereo.rig import StereoRig
from polemap.tools.drive_detection import Source, detect_drive
from polemap.tools.recording.opened import Columns, OpenedRun
from polemap.vehicle.pose import inverse_transform_points
from polemap.vehicle.trajectory import Trajectory

Floats = NDArray[np.float64]

# a grid of round hundreds keeps coordinates readable: drawn plus origin is the map's
ORIGIN_STEP_M = 100.0
_PATH_SPACING_M = 0.5
# poles beyond are thinner than a pixel
_DRAWN_TO_M = 45.0
_NEAREST_M = 2.0
# where a map does not say: a street lamp seen from a car
HEIGHT_M, WIDTH_M = 4.0, 0.2
_JPEG_QUALITY = 80


@dataclass(frozen=True, slots=True)
class Poles:
    """The mapped poles: points `(n, 2)` from the origin, the rest `(n,)`."""

    points_m: Floats
    width_m: Floats
    height_m: Floats
    existence: Floats


@dataclass(frozen=True, slots=True)
class Picture:
    """A left image with the poles in it.

    Attributes:
        jpeg: the image file.
        mapped_px, seen_px: `(k, 2, 2)` foot and top, column and row, of mapped and of seen poles.
    """

    stamp_s: float
    jpeg: bytes
    mapped_px: Floats
    seen_px: Floats


@dataclass(frozen=True, slots=True)
class Scene:
    """A run, ready to be drawn; every trajectory is relative to `origin_m`.

    Attributes:
        kf_beside, pf_beside: what is known of each pose.
        reference: of the drive, where it was given and has one.
        paths: trajectories by name, thinned to what a line needs.
        scans: poles as seen, in the vehicle frame.
        pictures: read and drawn on as they are asked for; None without images.
    """

    name: str
    frame: EarthFrame
    origin_m: Floats
    poles: Poles | None
    kf: Trajectory
    kf_beside: Columns
    pf: Trajectory
    pf_beside: Columns
    paths: Mapping[str, Trajectory]
    scans: tuple[Detections, ...]
    rig: StereoRig | None
    picture_count: int
    pictures: Callable[[], Iterator[Picture]] | None

    @property
    def is_geographic(self) -> bool:
        """Whether positions have latitude and longitude."""
        return self.frame.is_utm


def scene_of(
    opened: OpenedRun,
    settings: Settings | None,
    source: Source | None,
    workers: int,
    cache: Path | None,
    advance: Callable[[int], None],
) -> Scene:
    """The scene of a run; with a drive that has images, its poles are detected once more.

    Args:
        settings, source: those of the run and of its drive; None shows no seen poles.
        cache: keeps detections, as that of `polemap localize`.
        advance: called with the number of frames looked at.

    Raises:
        InputError: the run has no pose, or the drive's images cannot be read.
    """
    kf, kf_beside = opened.trajectory("kf")
    pf, pf_beside = opened.trajectory("pf")
    if not len(kf):
        raise InputError(f"{opened.name}: the run has no pose to show")
    origin = np.floor(kf.poses[0, :2] / ORIGIN_STEP_M) * ORIGIN_STEP_M
    origin = origin if opened.frame.is_utm else np.zeros(2)
    kf, pf = moved(kf, origin), moved(pf, origin)
    paths = {"kf": kf.thinned(_PATH_SPACING_M), "pf": pf.thinned(_PATH_SPACING_M)}
    drive, scans = opened.drive, tuple[Detections, ...]()
    if drive is not None and drive.reference is not None:
        whole = Trajectory(drive.reference.stamp_s, drive.reference.poses)
        inside = whole.between(float(kf.stamp_s[0]), float(kf.stamp_s[-1]))
        paths["reference"] = moved(inside, origin).thinned(_PATH_SPACING_M)
    looked_at = drive is not None and (drive.has_frames or bool(drive.scans))
    if drive is not None and looked_at and settings is not None and source is not None:
        scans = detect_drive(source, drive, settings, workers, cache, advance).scans
    has_pictures = drive is not None and drive.has_frames and drive.rig is not None
    bare = Scene(
        name=opened.name,
        frame=opened.frame,
        origin_m=origin,
        poles=poles_of(opened.pole_map, origin) if opened.pole_map is not None else None,
        kf=kf,
        kf_beside=kf_beside,
        pf=pf,
        pf_beside=pf_beside,
        paths={name: path for name, path in paths.items() if len(path)},
        scans=scans,
        rig=drive.rig if drive is not None else None,
        picture_count=len(drive.frame_stamps_s) if drive is not None and has_pictures else 0,
        pictures=None,
    )
    if not has_pictures:
        return bare
    return replace(bare, pictures=lambda: _pictures(opened, bare))


def moved(trajectory: Trajectory, origin_m: Floats) -> Trajectory:
    """The same poses, from the origin."""
    poses = trajectory.poses.copy()
    poses[:, :2] -= origin_m
    return Trajectory(trajectory.stamp_s, poses, trajectory.covariance)


def poles_of(known: PoleMap, origin_m: Floats) -> Poles:
    """The poles of a map from an origin; usual sizes where the map does not say them."""
    return Poles(
        known.points_m - origin_m,
        np.where(np.isfinite(known.width_m), known.width_m, WIDTH_M),
        np.where(np.isfinite(known.height_m), known.height_m, HEIGHT_M),
        known.existence,
    )


def _pictures(opened: OpenedRun, scene: Scene) -> Iterator[Picture]:
    """Left images with mapped poles, by the run's pose at the moment, and the poles seen."""
    drive, rig = opened.drive, scene.rig
    if drive is None or rig is None:
        return
    seen = {scan.stamp_s: scan for scan in scene.scans}
    for row in range(len(drive.frame_stamps_s)):
        frame = drive.read_frame(row)
        mapped = np.empty((0, 2, 2))
        pose = scene.kf.at([frame.stamp_s])[0]
        if scene.poles is not None and np.isfinite(pose).all():
            local = inverse_transform_points(pose, scene.poles.points_m)
            mapped = lines_px(rig, local, scene.poles.height_m)
        scan = seen.get(frame.stamp_s)
        found = np.empty((0, 2, 2))
        if scan is not None:
            height = np.where(np.isfinite(scan.height_m), scan.height_m, HEIGHT_M)
            found = lines_px(rig, scan.points_vehicle_m, height)
        yield Picture(frame.stamp_s, jpeg(frame.left), mapped, found)


def lines_px(rig: StereoRig, points_vehicle_m: Floats, height_m: Floats) -> Floats:
    """Poles `(n, 2)` in the vehicle frame as lines `(k, 2, 2)` in the left image, foot and top."""
    ahead = (points_vehicle_m[:, 0] > _NEAREST_M + rig.vehicle_from_camera.x_m) & (
        np.hypot(*points_vehicle_m.T) < _DRAWN_TO_M
    )
    points, heights = points_vehicle_m[ahead], height_m[ahead]
    feet = np.column_stack([points, np.zeros(len(points))])
    tops = np.column_stack([points, heights])
    lines = rig.project(np.stack([feet, tops], axis=1))[..., :2]
    inside = (
        np.isfinite(lines).all(axis=(1, 2)) & (lines[:, 0, 0] > 0) & (lines[:, 0, 0] < rig.width_px)
    )
    return np.asarray(lines[inside])


def jpeg(image: Image) -> bytes:
    """The image as JPEG; 16 bits are scaled to the brightest pixels.

    Raises:
        InputError: it cannot be encoded.
    """
    if image.dtype != np.uint8:
        top = max(float(np.percentile(image[::4, ::4], 99.5)), 1.0)
        image = np.clip(image * (255.0 / top), 0, 255).astype(np.uint8)
    done, data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
    if not done:
        raise InputError(f"image {image.shape} {image.dtype} cannot be encoded")
    return data.tobytes()
