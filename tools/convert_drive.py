"""Drives written in other forms; see `tools/convert.py`."""

from __future__ import annotations

import numpy as np

from polemap.drivelog.atomic import check_file, check_folder
from polemap.drivelog.drive import Drive
from polemap.drivelog.landmark_kind import LandmarkKind, kind_counts
from polemap.drivelog.readers.registry import open_drive
from polemap.drivelog.writers.folder import write_drive
from polemap.drivelog.writers.kitti_odometry import kept_rows, write_kitti_odometry
from polemap.extras import check_installed
from polemap.tools.convert import Request
from polemap.tools.progress import progress


def to_folder(request: Request) -> list[str]:
    """A plain drive folder of any drive, images included."""
    check_folder(request.out, "drive", request.inputs)
    drive = open_drive(request.input, seed=request.seed, topics=request.topics)
    with progress(len(drive.frame_stamps_s), f"writing {drive.name}") as advance:
        write_drive(drive, request.out, advance)
    return [f"drive {drive.name} written to {request.out}"]


def to_kitti(request: Request) -> list[str]:
    """The layout of the KITTI odometry benchmark, with poses where there is a reference."""
    check_folder(request.out, "drive", request.inputs)
    drive = open_drive(request.input, seed=request.seed, topics=request.topics)
    with progress(len(drive.frame_stamps_s), f"writing {drive.name}") as advance:
        sequence = write_kitti_odometry(drive, request.out, advance=advance)
    return [
        *(f"note: {line}" for line in _lost_in_kitti(drive)),
        f"drive {drive.name} written; its sequence is {sequence}",
    ]


def _lost_in_kitti(drive: Drive) -> list[str]:
    """What the layout has no place for."""
    lost = [
        name
        for name, stream in (("odometry", drive.odometry), ("GNSS", drive.gnss))
        if stream is not None
    ]
    lost += ["poles"] if drive.scans else []
    lost += ["laps"] if drive.laps else []
    lines = ["the KITTI layout has no earth frame and no mounting of the camera: readers take "
             "KITTI's own car (1.03 m ahead of the rear axle, 1.65 m above the road)"]  # fmt: skip
    if lost:
        lines.append(f"the KITTI layout has no place for {', '.join(lost)}: left out")
    pairs, kept = len(drive.frame_stamps_s), len(kept_rows(drive))
    if kept < pairs:
        lines.append(
            f"the reference knows no pose at {pairs - kept} of {pairs} pictures: left out, "
            "since KITTI has a pose for each"
        )
    if drive.reference is None:
        lines.append("the drive has no reference: no poses beside the sequence")
    return lines


def to_mcap(request: Request) -> list[str]:
    """One MCAP file of ROS 2 messages with all streams."""
    check_file(request.out, request.inputs)
    check_installed("mcap")
    from polemap.drivelog.writers.ros.drive import write_drive_mcap

    drive = open_drive(request.input, seed=request.seed, topics=request.topics)
    with progress(len(drive.frame_stamps_s), f"writing {drive.name}") as advance:
        counts = write_drive_mcap(drive, request.out, advance)
    return [
        *(f"note: {line}" for line in _lost_in_mcap(drive)),
        *(f"{count:8}  {topic}" for topic, count in sorted(counts.items())),
        f"drive {drive.name} written to {request.out}; polemap, ROS 2 and Foxglove read it",
    ]


def _lost_in_mcap(drive: Drive) -> list[str]:
    """Landmarks that the messages have no place for."""
    kinds = [scan.kind[scan.kind != LandmarkKind.POLE] for scan in drive.scans]
    kinds += [scan.lines.kind for scan in drive.scans if scan.lines is not None]
    lost = kind_counts(np.concatenate([np.empty(0, dtype=np.int8), *kinds]))
    if not lost:
        return []
    return [f"an MCAP of polemap holds poles alone: {lost} are left out; a folder keeps them"]
