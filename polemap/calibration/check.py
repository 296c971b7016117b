"""All that a drive says of its calibration, on one screen: pictures in, quantities out."""

from __future__ import annotations

from collections.abc import Callable
from math import isfinite

import numpy as np
from numpy.typing import NDArray

from polemap.calibration.ground import GroundPlane, ground_mounting, ground_planes
from polemap.calibration.motion import CameraSteps, camera_steps, heading
from polemap.calibration.odometry import (
    OdometryErrors,
    odometry_errors,
    of_camera,
    of_reference_poses,
)
from polemap.calibration.result import MOUNT, Calibration, Quantity
from polemap.calibration.rows import check_rows
from polemap.drivelog.drive import Drive
from polemap.drivelog.errors import InputError
from polemap.drivelog.plausibility.odometer import of_odometry
from polemap.stereo.config import StereoConfig
from polemap.stereo.rig import Mounting

Floats = NDArray[np.float64]

_RUN = 30
# a standing car adds nothing, and parked it sees no road
_MOVING_MPS = 1.0
# a road that bends leaves the corridor in which it is looked for
_STRAIGHT_PER_M = 0.02
# beyond these it is another unit, the other sign or another drive's odometry, and no tyre
_SCALE_RANGE = (0.7, 1.4)


def calibrate(
    drive: Drive,
    config: StereoConfig,
    *,
    pairs: int = 40,
    frames: int = 240,
    seed: int = 0,
    advance: Callable[[int], None] = lambda _steps: None,
) -> Calibration:
    """Checks and estimates the calibration of a drive.

    Args:
        drive: with pictures, or with odometry and a reference.
        config: of the stereo matcher that finds the road.
        pairs: frames from all over the drive whose rows and road are looked at.
        frames: frames in runs of thirty through which the camera's motion is followed.
        seed: of the samples that robust fits draw.
        advance: called with the number of frames done.

    Raises:
        InputError: nothing to calibrate, a picture that cannot be read, or too few features.
    """
    quantities: list[Quantity] = []
    missing: list[str] = []
    rows = None
    planes: list[GroundPlane | None] = []
    chosen: list[int] = []
    steps = None
    drive_rig = drive.rig
    if drive.has_frames and drive_rig is not None:
        chosen = spread_rows(drive, pairs)
        rows = check_rows(drive, chosen)
        advance(len(chosen))
        chosen = spread_rows(drive, pairs, straight=True)
        for row in chosen:
            planes += ground_planes(drive, [row], config, seed)
            advance(1)
        mount = drive_rig.vehicle_from_camera
        quantities += _from_ground(drive, chosen, planes, mount, missing)
        level = Calibration(rows, tuple(quantities), (), (), (), (), None).mounting(mount)
        runs = _runs(drive, frames)
        parts = []
        for run in runs:
            parts.append(camera_steps(drive, [run]))
            advance(len(run))
        steps = CameraSteps.joined(parts)
        quantities += _from_motion(steps, level, mount, missing)
    errors = _odometry(drive, steps, quantities, missing)
    if not quantities and rows is None:
        raise InputError(
            f"drive {drive.name}: nothing to calibrate: it needs stereo pictures, or odometry with "
            f"a reference ({'; '.join(missing)})"
        )
    return Calibration(
        rows, tuple(quantities), tuple(missing), tuple(errors), tuple(planes), tuple(chosen), steps
    )


def spread_rows(drive: Drive, count: int, *, straight: bool = False) -> list[int]:
    """Rows from all over the drive, of a moving car (that goes straight) where odometry tells."""
    rows = np.arange(len(drive.frame_stamps_s))
    odometry = drive.odometry
    if odometry is not None and len(odometry) > 1:
        speed = np.interp(drive.frame_stamps_s, odometry.stamp_s, odometry.speed_mps)
        turn = np.interp(drive.frame_stamps_s, odometry.stamp_s, odometry.yaw_rate_radps)
        kept = np.abs(speed) > _MOVING_MPS
        if straight:
            kept &= np.abs(turn) < _STRAIGHT_PER_M * np.abs(speed)
        rows = rows[kept] if np.count_nonzero(kept) >= min(count, 10) else rows
    pick = np.unique(np.linspace(0, len(rows) - 1, min(count, len(rows))).astype(int))
    return [int(row) for row in rows[pick]]


def _pushed(drive: Drive, stamps_s: Floats) -> Floats | None:
    """Accelerations `(n, 2)` along and to the left, from half a second of odometry each."""
    if drive.odometry is None or len(drive.odometry) < 3:
        return None
    odometer = of_odometry(drive.odometry)
    before, _, known = odometer.spans(stamps_s - 0.5, stamps_s)
    after, turn, known_after = odometer.spans(stamps_s, stamps_s + 0.5)
    along = np.where(known & known_after, (after - before) / 0.25, 0.0)
    left = np.where(known_after, turn / 0.5 * after / 0.5, 0.0)
    return np.stack([along, left], axis=1)


def _runs(drive: Drive, frames: int) -> list[range]:
    """Runs of neighbouring rows from all over the drive."""
    count = len(drive.frame_stamps_s)
    if count <= frames:
        return [range(count)]
    runs = max(frames // _RUN, 1)
    starts = np.linspace(0, count - _RUN, runs).astype(int)
    return [range(start, min(start + _RUN, count)) for start in starts.tolist()]


def _from_ground(
    drive: Drive,
    rows: list[int],
    planes: list[GroundPlane | None],
    mount: Mounting,
    missing: list[str],
) -> list[Quantity]:
    stamps = drive.frame_stamps_s[rows]
    ground = ground_mounting(stamps, planes, _pushed(drive, stamps))
    if ground is None:
        seen = sum(plane is not None for plane in planes)
        missing.append(
            f"height, pitch and roll: a flat road fills the car's way in {seen} of {len(planes)} "
            "frames, 5 are needed"
        )
        return []
    source = f"road plane in {ground.frames[0]} of {ground.frames[1]} frames"
    return [
        Quantity(f"{MOUNT}z_m", mount.z_m, ground.height_m, ground.height_sd_m, source),
        Quantity(f"{MOUNT}pitch_rad", mount.pitch_rad, ground.pitch_rad, ground.pitch_sd_rad,
                 source),
        Quantity(f"{MOUNT}roll_rad", mount.roll_rad, ground.roll_rad, ground.roll_sd_rad, source),
    ]  # fmt: skip


def _from_motion(
    steps: CameraSteps, level: Mounting, mount: Mounting, missing: list[str]
) -> list[Quantity]:
    ahead = heading(steps, level)
    if ahead is None or not isfinite(ahead.yaw_sd_rad):
        missing.append(
            f"yaw: of {len(steps)} steps of the camera fewer than 10, or too short a time, are "
            "straight"
        )
        return []
    return [
        Quantity(f"{MOUNT}yaw_rad", mount.yaw_rad, ahead.yaw_rad, ahead.yaw_sd_rad,
                 f"direction of motion in {ahead.steps} straight steps")
    ]  # fmt: skip


def _odometry(
    drive: Drive, steps: CameraSteps | None, quantities: list[Quantity], missing: list[str]
) -> list[OdometryErrors]:
    """Against the reference first, and against the camera's motion."""
    if drive.odometry is None:
        missing.append("odometry: the drive has none")
        return []
    witnesses = [of_reference_poses(drive)]
    if steps is not None and drive.rig is not None:
        witnesses.append(of_camera(steps, drive.rig.vehicle_from_camera))
    errors = [odometry_errors(drive, witness) for witness in witnesses if witness is not None]
    told = [error for error in errors if error is not None and isfinite(error.speed_scale_sd)]
    known = [error for error in told if _SCALE_RANGE[0] < error.speed_scale < _SCALE_RANGE[1]]
    missing += [
        f"odometry: {error.speed_scale:.3f} of what {error.against} says is no wheel's scale; "
        "look at units, signs and clocks with polemap info"
        for error in told
        if error not in known
    ]
    if not told:
        missing.append("odometry: neither a reference nor the camera's motion lasts long enough")
    if not known:
        return []
    best = known[0]
    made = " of an odometry derived from it" if drive.odometry_is_derived else ""
    source = f"against {best.against}, {best.spans} spans{made}"
    # against the stream as it was recorded, which is what drive.yaml corrects
    applied = drive.odometry_correction
    stated, sd = applied.speed_scale, best.speed_scale_sd * applied.speed_scale
    quantities.append(
        Quantity("odometry.speed_scale", stated, best.speed_scale * stated, sd, source)
    )
    if isfinite(best.delay_s):
        delay = best.delay_s + applied.delay_s
        quantities.append(
            Quantity("odometry.delay_s", applied.delay_s, delay, best.delay_sd_s, source)
        )
    else:
        missing.append("odometry delay: speed and turn rate hardly change")
    return known
