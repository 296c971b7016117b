"""One drive as the graph sees it: keyframes, calibration in time, fixes, scans at keyframes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from polemap.build.slam.constants import CALIBRATION_S, CAMERA_CALIBRATION_SD, KEYFRAME_M
from polemap.build.slam.motion import (
    CALIBRATION,
    Increments,
    MotionNoise,
    Path,
    dead_reckon,
    increments,
    keyframe_stamps,
)
from polemap.drivelog.detections import Detections
from polemap.drivelog.drive import Drive
from polemap.drivelog.errors import InputError
from polemap.drivelog.frames import EarthFrame, transform_points
from polemap.drivelog.streams import OdometryStream, ReferenceStream
from polemap.vehicle.pose import compose, relative, wrap_angle

Floats = NDArray[np.float64]
Whole = NDArray[np.int64]

_HDOP_FLOOR = 0.5
_FIX_EVERY_S = 2.0  # of fixes that wander together no more are needed


@dataclass(frozen=True, slots=True)
class Route:
    """A drive between its keyframes.

    Attributes:
        name: of the drive in the map.
        odometry: its odometry.
        noise: of the odometry.
        stamp_s: `(n,)` of the keyframes.
        poses: `(n, 3)` of them, as solved so far, in the shifted frame of the graph.
        calibration: `(k, 6)` in successive times; calibration_s: `(k,)` where each begins.
        path, steps: dead reckoning and increments with that calibration.
        fix_s, fix_m, hdop: `(c,)`, `(c, 2)`, `(c,)` of the fixes that are used.
        antenna_m: `(2,)`.
        by_camera: whether the odometry is a camera's, whose calibration is known better.
    """

    name: str
    odometry: OdometryStream
    noise: MotionNoise
    stamp_s: Floats
    poses: Floats
    calibration: Floats
    calibration_s: Floats
    path: Path
    steps: Increments
    fix_s: Floats
    fix_m: Floats
    hdop: Floats
    antenna_m: Floats
    by_camera: bool

    def __len__(self) -> int:
        return len(self.stamp_s)

    def keyframe_of(self, stamps_s: Floats) -> Whole:
        """The keyframe nearest on the way to each stamp, `(m,)`."""
        way = np.interp(stamps_s, self.path.stamp_s, self.path.travelled_m)
        own = np.interp(self.stamp_s, self.path.stamp_s, self.path.travelled_m)
        high = np.clip(np.searchsorted(own, way), 1, len(own) - 1) if len(own) > 1 else 0
        low = np.maximum(np.asarray(high) - 1, 0)
        nearer = np.abs(own[high] - way) < np.abs(way - own[low])
        return np.where(nearer, high, low).astype(np.int64) * np.ones(len(way), dtype=np.int64)

    def from_keyframe(self, keyframe: Whole, stamps_s: Floats) -> Floats:
        """The pose at each stamp in the axes of its keyframe, `(m, 3)`, by odometry."""
        return relative(self.path.at(self.stamp_s[keyframe]), self.path.at(stamps_s))

    def poses_at(self, stamps_s: Floats) -> Floats:
        """Poses at stamps, by odometry from the nearest keyframes; yaw wrapped.

        From the keyframe before and the one after, weighted by the way, so that it does not jump.
        """
        before = np.clip(
            np.searchsorted(self.stamp_s, stamps_s, side="right") - 1, 0, len(self) - 1
        )
        after = np.minimum(before + 1, len(self) - 1)
        one = compose(self.poses[before], self.from_keyframe(before, stamps_s))
        two = compose(self.poses[after], self.from_keyframe(after, stamps_s))
        way = np.interp(stamps_s, self.path.stamp_s, self.path.travelled_m)
        ends = np.interp(self.stamp_s, self.path.stamp_s, self.path.travelled_m)
        length = ends[after] - ends[before]
        share = np.clip((way - ends[before]) / np.where(length > 0, length, 1.0), 0.0, 1.0)
        off = two - one
        off[:, 2] = wrap_angle(off[:, 2])
        mixed = one + share[:, None] * off
        mixed[:, 2] = wrap_angle(mixed[:, 2])
        return mixed

    def calibration_of(self, stamps_s: Floats) -> Whole:
        """Row of the calibration that holds at stamps, `(m,)`."""
        row = np.searchsorted(self.calibration_s, stamps_s, side="right") - 1
        return np.clip(row, 0, len(self.calibration) - 1).astype(np.int64)

    def with_calibration(self, calibration: Floats) -> Route:
        """The route with its increments taken about another calibration `(k, 6)`."""
        rows = calibration[self.calibration_of(self.odometry.stamp_s)]
        path, steps = increments(self.odometry, rows, self.noise, self.stamp_s)
        return replace(self, calibration=calibration, path=path, steps=steps)

    def calibration_knowledge(self) -> tuple[Floats, Floats]:
        """What is known of the calibration beside its prior: `(k, 6)`, and information."""
        count, size = self.calibration.shape
        information = np.zeros((count, size, size))
        if self.by_camera:
            known = np.arange(len(CAMERA_CALIBRATION_SD))
            information[:, known, known] = 1.0 / np.square(CAMERA_CALIBRATION_SD)
        return np.zeros((count, size)), information

    def reckoned(self) -> Route:
        """The route by dead reckoning from its first pose, with the calibration that it has."""
        way = self.path.at(self.stamp_s)
        return replace(self, poses=compose(self.poses[0], relative(way[0], way)))

    def between(self, first: int, count: int) -> Route:
        """The keyframes from `first` on to the `count`-th, and the fixes along them."""
        fixes = self.fix_s <= self.stamp_s[count - 1]
        if first > 0:
            fixes &= self.fix_s >= self.stamp_s[first]
        steps = self.steps
        mine = slice(first, count - 1)
        return replace(
            self,
            stamp_s=self.stamp_s[first:count],
            poses=self.poses[first:count],
            steps=Increments(steps.motion[mine], steps.jacobian[mine], steps.covariance[mine]),
            fix_s=self.fix_s[fixes],
            fix_m=self.fix_m[fixes],
            hdop=self.hdop[fixes],
        )


def open_route(
    name: str,
    drive: Drive,
    frame: EarthFrame,
    shift_m: Floats,
    noise: MotionNoise,
) -> Route:
    """A drive's route by dead reckoning alone, in `frame` less `shift_m`.

    Raises:
        InputError: it has no odometry, or one of fewer than two samples.
        FrameError: no transformation leads from its frame to `frame`.
    """
    odometry = drive.odometry
    if odometry is None or len(odometry) < 2:
        raise InputError(
            f"drive {drive.name}: it has no odometry; without a reference a map needs the motion "
            f"of the car: add {drive.names.odometry}, or frames for --odometry camera"
        )
    nominal = dead_reckon(odometry, np.zeros(len(CALIBRATION)), noise)
    stamps = keyframe_stamps(nominal, KEYFRAME_M)
    times = int(max(1, round((stamps[-1] - stamps[0]) / CALIBRATION_S)))
    starts = np.linspace(stamps[0], stamps[-1], times + 1)[:-1]
    fix_s, fix_m, hdop = _fixes(drive, frame, shift_m, stamps)
    zero = np.zeros((times, len(CALIBRATION)))
    path, steps = increments(odometry, np.zeros(len(CALIBRATION)), noise, stamps)
    return Route(
        name, odometry, noise, stamps, path.at(stamps), zero, starts, path, steps,
        fix_s, fix_m, hdop, np.asarray(drive.gnss_antenna_m, dtype=np.float64),
        drive.odometry_is_cameras,
    )  # fmt: skip


def check_route(route: Route, scans: Sequence[Detections]) -> None:
    """Refuse a drive of which nothing can be made.

    Raises:
        InputError: it has no scan, or the car stood still.
    """
    if not len(scans):
        raise InputError(f"drive {route.name}: it has no scan; a map needs poles that were seen")
    if route.path.travelled_m[-1] < KEYFRAME_M:
        raise InputError(
            f"drive {route.name}: its odometry says that the car stood still; without a "
            "reference a map needs a car that moves"
        )


def _fixes(
    drive: Drive, frame: EarthFrame, shift_m: Floats, stamps: Floats
) -> tuple[Floats, Floats, Floats]:
    gnss = drive.gnss
    if gnss is None or not len(gnss):
        return np.empty(0), np.empty((0, 2)), np.empty(0)
    inside = (gnss.stamp_s >= stamps[0] - 1.0) & (gnss.stamp_s <= stamps[-1] + 1.0)
    rows = np.flatnonzero(inside)
    if len(rows):
        tick = np.floor((gnss.stamp_s[rows] - gnss.stamp_s[rows[0]]) / _FIX_EVERY_S + 1e-6)
        rows = rows[np.concatenate([[True], np.diff(tick) > 0])]
    points = np.column_stack([gnss.east_m[rows], gnss.north_m[rows]])
    if drive.frame != frame and len(points):
        points = transform_points(points, drive.frame, frame)
    return gnss.stamp_s[rows], points - shift_m, np.maximum(gnss.hdop[rows], _HDOP_FLOOR)


def as_reference(route: Route, stamps_s: Floats, shift_m: Floats, sd_m: Floats) -> ReferenceStream:
    """The solved poses at stamps as a reference; `sd_m` `(n,)` of the keyframes."""
    poses = route.poses_at(stamps_s) + np.array([*shift_m, 0.0])
    return ReferenceStream(stamps_s, poses, np.interp(stamps_s, route.stamp_s, sd_m))
