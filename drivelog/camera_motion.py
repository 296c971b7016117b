"""How the car moved, from its stereo camera: a whole drive, planar for the filters and in space."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.columns import Columns
from polemap.drivelog.drive import Drive
from polemap.drivelog.errors import InputError
from polemap.drivelog.streams import OdometryStream
from polemap.stereo.odometry.camera_odometry import CameraMotion, CameraOdometry
from polemap.stereo.odometry.motion import vehicle_step
from polemap.stereo.rig import StereoRig
from polemap.vehicle.pose import rotate_back

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class PlanarMotion(Columns):
    """Rear-axle motion between neighbouring pairs; every array `(n,)`.

    Attributes:
        stamp_s: middle between the two pairs.
        arrival_s: arrival of the second pair.
        speed_mps, yaw_rate_radps: mean over the step; along the car's axis halfway, and
            counter-clockwise.
        lateral_mps: to the left, what the rear axle slips.
        speed_sd_mps, yaw_rate_sd_radps: as the corners determine them; an error of the
            calibration (scale) is not in them.
    """

    stamp_s: Floats
    arrival_s: Floats
    speed_mps: Floats
    yaw_rate_radps: Floats
    lateral_mps: Floats
    speed_sd_mps: Floats
    yaw_rate_sd_radps: Floats


@dataclass(frozen=True, slots=True)
class CameraTrack:
    """The camera's way through a drive.

    Attributes:
        stamp_s: `(n,)` of the pairs.
        poses: `(n, 4, 4)` of the left camera in the axes of the first one (x right, y down,
            z forward). Over steps that are unknown the last motion is taken to go on.
        planar: one row for each step that is known.
        unknown: what stood against the other steps, counted.
        disparity_offset_px: error of the disparities in the middle of the picture, as learned by
            the end.
    """

    stamp_s: Floats
    poses: Floats
    planar: PlanarMotion
    unknown: dict[str, int]
    disparity_offset_px: float

    def odometry(self) -> OdometryStream:
        """The known steps as a drive's odometry."""
        rows = self.planar
        return OdometryStream(
            rows.stamp_s, rows.arrival_s, rows.speed_mps, rows.yaw_rate_radps, rows.lateral_mps
        )


def track_camera(drive: Drive, advance: Callable[[int], None]) -> CameraTrack:
    """Follow the camera through all pairs of a drive.

    Args:
        advance: called with 1 after every pair.

    Raises:
        InputError: the drive has no stereo pairs, or one cannot be read.
    """
    if drive.rig is None or not drive.has_frames:
        raise InputError(
            f"drive {drive.name}: camera odometry needs stereo pictures, and it has none"
        )
    odometry = CameraOdometry(drive.rig)
    poses = np.tile(np.eye(4), (len(drive.frame_stamps_s), 1, 1))
    rows: list[tuple[float, ...]] = []
    unknown: Counter[str] = Counter()
    going_on: Floats = np.eye(4)
    for row in range(len(poses)):
        frame = drive.read_frame(row)
        motion = odometry.advance(frame.stamp_s, frame.left, frame.right)
        advance(1)
        if not row:
            continue
        step_s = frame.stamp_s - float(drive.frame_stamps_s[row - 1])
        if motion.known:
            going_on = np.asarray(np.linalg.inv(motion.current_from_previous), dtype=np.float64)
            stamp_s = frame.stamp_s - 0.5 * step_s
            rows.append((stamp_s, frame.arrival_s, *planar_step(drive.rig, motion, step_s)))
        else:
            unknown[motion.kind] += 1
        poses[row] = poses[row - 1] @ going_on
    table = np.array(rows).reshape(-1, 7)
    offset = float(odometry.disparity_error.coefficients_px[0])
    stamps = np.array(drive.frame_stamps_s)
    return CameraTrack(stamps, poses, PlanarMotion(*table.T), dict(unknown), offset)


def planar_step(rig: StereoRig, motion: CameraMotion, step_s: float) -> tuple[float, ...]:
    """Speed, yaw rate and lateral speed of the rear axle over a step, and the first two's sd.

    The displacement is that of an arc: its chord, seen from the heading halfway, is shorter than
    the way by `sin(a) / a` with half the turn `a`.
    """
    step = vehicle_step(rig, motion.current_from_previous)
    yaw, moved = float(np.arctan2(step[1, 0], step[0, 0])), step[:2, 3]
    half = 0.5 * yaw
    along, across = rotate_back(moved, half)
    arc = 1.0 / np.sinc(half / np.pi)
    # axes of the vehicle in those of the camera; the lever arm of the yaw acts across, not along
    mount = rig.vehicle_from_camera
    ahead, _, up = mount.rotation()
    by_speed = np.concatenate([ahead, -mount.y_m * up])
    speed_sd = float(np.sqrt(by_speed @ motion.covariance @ by_speed))
    yaw_sd = float(np.sqrt(up @ motion.covariance[3:, 3:] @ up))
    return (
        float(along * arc) / step_s,
        yaw / step_s,
        float(across * arc) / step_s,
        speed_sd / step_s,
        yaw_sd / step_s,
    )
