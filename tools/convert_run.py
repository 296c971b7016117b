"""Runs as trajectories and recordings for other programs; see `tools/convert.py`."""

from __future__ import annotations

from polemap.drivelog.atomic import check_file
from polemap.drivelog.errors import ConfigError, InputError
from polemap.drivelog.readers.registry import open_drive
from polemap.drivelog.writers.trajectory import check_trajectory_file, write_trajectory
from polemap.tools.convert import Request
from polemap.tools.recording.opened import open_run
from polemap.tools.recording.record import record_run
from polemap.vehicle.trajectory import Trajectory


def to_trajectory(request: Request) -> list[str]:
    """The poses of a run in the format of the ending."""
    check_file(request.out, (*request.inputs, request.map_file, request.drive, request.topics))
    opened = open_run(request.input, request.run, request.map_file, request.drive, request.topics)
    check_trajectory_file(request.out, opened.frame)
    which = request.trajectory or "kf"
    if which not in ("kf", "pf"):
        raise ConfigError(f"convert: --trajectory {which}: a run has kf (100 Hz) and pf")
    trajectory, beside = opened.trajectory(which)
    notes = write_trajectory(
        request.out, trajectory, opened.frame, f"{opened.name} {which}", beside
    )
    return [f"note: {note}" for note in notes] + [
        f"{len(trajectory)} poses of {which} written to {request.out}"
    ]


def to_recording(request: Request) -> list[str]:
    """A run as .mcap for Foxglove or .rrd for rerun."""
    inputs = (*request.inputs, request.map_file, request.drive)
    return record_run(
        request.input, request.out, request.drive, request.map_file, request.run, None, inputs
    )


def reference_to_trajectory(request: Request) -> list[str]:
    """The reference poses of a drive in the format of the ending."""
    check_file(request.out, request.inputs)
    drive = open_drive(request.input, seed=request.seed, topics=request.topics)
    if drive.reference is None:
        raise InputError(f"drive {drive.name}: it has no reference poses to write")
    check_trajectory_file(request.out, drive.frame)
    reference = drive.reference
    notes = write_trajectory(
        request.out,
        Trajectory(reference.stamp_s, reference.poses),
        drive.frame,
        f"{drive.name} reference",
        {"sd_m": reference.sd_m},
    )
    return [f"note: {note}" for note in notes] + [
        f"{len(reference)} reference poses written to {request.out}"
    ]
