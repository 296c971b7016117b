"""Where a drive's motion comes from: its wheels, its camera, both, or the reference it has."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Literal, get_args

import numpy as np

from polemap.drivelog.camera_motion import CameraTrack, track_camera
from polemap.drivelog.drive import Drive
from polemap.drivelog.errors import ConfigError, InputError
from polemap.drivelog.odometry_fusion import fuse_odometry
from polemap.drivelog.readers.derived import ODOMETRY_NOTE
from polemap.drivelog.streams import OdometryStream

OdometryChoice = Literal["auto", "wheels", "camera", "both", "derived"]


def resolve(drive: Drive, choice: str) -> OdometryChoice:
    """What `choice` means for a drive; `auto` takes measured wheels, then the camera.

    Raises:
        ConfigError: a choice that is none.
        InputError: the drive lacks what is asked for.
    """
    if choice not in get_args(OdometryChoice):
        raise ConfigError(f"--odometry {choice}: choose {', '.join(get_args(OdometryChoice))}")
    measured = drive.odometry is not None and not drive.odometry_is_derived
    derived = drive.odometry is not None and drive.odometry_is_derived
    sees = drive.has_frames and drive.rig is not None
    if choice == "auto":
        if measured or not (sees or derived):
            return "wheels"
        return "camera" if sees else "derived"
    lacking = {
        "wheels": None if measured else "a measured odometry",
        "camera": None if sees else "stereo pictures",
        "both": "stereo pictures" if not sees else None if measured else "a measured odometry",
        "derived": None if derived else "an odometry derived from its reference",
    }[choice]
    if lacking is not None:
        raise InputError(f"drive {drive.name}: --odometry {choice} needs {lacking}: it has none")
    return choice  # type: ignore[return-value]


def with_odometry(
    drive: Drive,
    choice: str,
    follow: Callable[[Drive], CameraTrack] = lambda drive: track_camera(drive, lambda _: None),
) -> Drive:
    """The drive with its motion from where `choice` says; a note tells what was taken.

    Args:
        follow: gives the camera's way through the drive.

    Raises:
        ConfigError, InputError: see `resolve`; or no step of the camera is known.
    """
    source = resolve(drive, choice)
    if source in ("wheels", "derived"):
        return drive
    track = follow(drive)
    if not len(track.planar):
        raise InputError(
            f"drive {drive.name}: its camera tells no motion at all ({_unknown(track)}); "
            "look at a pair with polemap disparity"
        )
    unknown = f"; unknown: {_unknown(track)}" if track.unknown else ""
    steps = f"{len(track.planar)} of {len(track.stamp_s) - 1} steps"
    if source == "camera":
        note = f"odometry is the stereo camera's ({steps}{unknown})"
        notes = (*(n for n in drive.notes if n != ODOMETRY_NOTE), note)
        stream = _for_poles_of(drive, track.odometry())
        names = replace(drive.names, odometry="the camera's odometry")
        return replace(
            drive, odometry=stream, odometry_is_derived=False, odometry_is_cameras=True,
            notes=notes, names=names,
        )  # fmt: skip
    assert drive.odometry is not None  # resolve has seen to it
    fused = fuse_odometry(drive.odometry, track)
    note = (
        f"odometry is of wheels and camera ({steps}{unknown}): wheel speed x "
        f"{1.0 / fused.wheel_scale:.4f}, yaw rate {-fused.yaw_offset_radps:+.5f} rad/s, "
        f"{fused.replaced} steps where wheels contradict the camera, {fused.filled} holes filled"
        + (f", {fused.refused} steps of the camera refused" if fused.refused else "")
    )
    stream = _for_poles_of(drive, fused.stream)
    return replace(drive, odometry=stream, notes=(*drive.notes, note))


def _for_poles_of(drive: Drive, odometry: OdometryStream) -> OdometryStream:
    """The course that a camera sees says nothing of another detector, whose poles lie there."""
    if not drive.scans:
        return odometry
    return odometry.with_columns(lateral_mps=np.full(len(odometry), np.nan))


def _unknown(track: CameraTrack) -> str:
    return ", ".join(f"{count} x {kind}" for kind, count in sorted(track.unknown.items()))
