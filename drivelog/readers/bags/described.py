"""Recordings that `polemap convert` wrote: what no message holds is attached, topics are known."""

from __future__ import annotations

import struct
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from polemap.drivelog.atomic import scratch_folder
from polemap.drivelog.detections import Detections, VisibleRegion, pole_detections
from polemap.drivelog.drive import Drive
from polemap.drivelog.errors import InputError
from polemap.drivelog.readers import folder
from polemap.drivelog.readers.bags import mapping as m
from polemap.drivelog.readers.bags.container import SizedFile
from polemap.drivelog.readers.drive_yaml import read_drive_yaml
from polemap.drivelog.readers.poles import stated_view
from polemap.extras import need

TWIST, FIX, POSITION, REFERENCE, POLES = (
    "/vehicle/twist", "/gnss/fix", "/gnss/position", "/reference", "/poles",
)  # fmt: skip
SIDES = ("left", "right")
HEAD = "drive.yaml"
FILES = (HEAD, "laps.csv", "car.yaml")
# a description is some kB; a drive of ten thousand laps has half a megabyte of them
_LARGEST = 1 << 22


def image_topic(side: str) -> str:
    """Where the pictures of a side are."""
    return f"/stereo/{side}/image_rect/compressed"


def info_topic(side: str) -> str:
    """Where the calibration of a side is."""
    return f"/stereo/{side}/camera_info"


@dataclass(frozen=True, slots=True)
class Description:
    """A drive without samples, as its attached files say; `view` is that of its pole detector."""

    drive: Drive
    view: VisibleRegion | None


def attached_files(path: Path) -> dict[str, bytes]:
    """The attachments that describe a drive; none where the file is no MCAP or has no index."""
    if not path.is_file():
        return {}
    reader: Any = need("mcap.reader")
    records: Any = need("mcap.exceptions")
    with SizedFile(path) as file:
        try:
            index = reader.make_reader(file).get_summary()
            found = [] if index is None else index.attachment_indexes
            wanted = [one for one in found if one.name in FILES and one.data_size < _LARGEST]
            if not wanted:
                return {}
            file.seek(0)
            attachments = reader.make_reader(file).iter_attachments()
            return {one.name: bytes(one.data) for one in attachments if one.name in FILES}
        except (records.McapError, ValueError, OSError, KeyError, struct.error):
            return {}  # a recording that was cut off: its messages are read all the same


def describe(files: Mapping[str, bytes], place: str) -> Description:
    """What attached files say of a drive.

    Raises:
        InputError: one of them holds what a plain drive folder could not.
    """
    if HEAD not in files:
        raise InputError(f"{place}: has no {HEAD} attached")
    with scratch_folder() as scratch:
        for name in FILES:
            if name in files:
                (scratch / name).write_bytes(files[name])
        try:
            drive = folder.reader.read(scratch)
            detector = read_drive_yaml(scratch / HEAD).pole_detector
        except InputError as error:
            said = str(error).replace(f"{scratch}/", "")
            raise InputError(f"{place}: attached {said}") from error
    return Description(drive, stated_view(detector) if detector is not None else None)


def own_mapping(topics: Collection[str], described: Drive) -> m.Mapping:
    """The mapping of the topics that `polemap convert` writes, as far as they are there."""
    frame = described.frame
    parts: dict[str, Any] = {
        "frame": m.FramePart.model_validate({"kind": frame.kind, "epsg": frame.epsg,
                                             "name": frame.name}),
        "vehicle": m.VehiclePart(wheelbase_m=described.wheelbase_m, base_frame="base_link"),
        "camera": None, "odometry": None, "gnss": None, "reference": None,
        "laps": tuple(
            m.LapPart(name=lap.name, start_s=lap.start_s, end_s=lap.end_s)
            for lap in described.laps
        ),
    }  # fmt: skip
    if all(image_topic(side) in topics for side in SIDES):
        sides = {
            side: m.CameraSide(image=image_topic(side), info=info_topic(side)) for side in SIDES
        }
        parts["camera"] = m.CameraPart(**sides, rectified=True)
    if TWIST in topics:
        parts["odometry"] = m.OdometryPart(speed=m.Signal(topic=TWIST))
    fixes = next((name for name in (FIX, POSITION) if name in topics), None)
    if fixes is not None:
        ahead_m, left_m = (float(value) for value in described.gnss_antenna_m)
        antenna = m.Antenna(x_m=ahead_m, y_m=left_m)
        parts["gnss"] = m.GnssPart(topic=fixes, antenna=antenna)
    if REFERENCE in topics:
        parts["reference"] = m.ReferencePart(topic=REFERENCE)
    return m.Mapping(**parts)


def with_description(read: Drive, described: Drive) -> Drive:
    """The streams of a recording with the name, car, camera, laps and notes of the description."""
    return replace(
        described,
        path=read.path,
        rig=described.rig if read.has_frames else None,
        frame_stamps_s=read.frame_stamps_s,
        frame_arrivals_s=read.frame_arrivals_s,
        frame_numbers=read.frame_numbers,
        images=read.images,
        odometry=read.odometry,
        gnss=read.gnss,
        reference=read.reference,
        scans=read.scans,
        notes=(*described.notes, *read.notes),
        problems={**described.problems, **read.problems},
        findings=(*described.findings, *read.findings),
        names=replace(
            read.names,
            laps="laps.csv (attached)",
            head=f"{HEAD} (attached)",
            calibration=described.names.calibration,
        ),
    )


def pole_scan(decoded: Any, stamp_s: float, log_s: float, view: VisibleRegion | None) -> Detections:
    """A `polemap_msgs/PoleScan` as it was before it was written."""
    poles = decoded.poles
    variance = np.array([[p.var_x_m2, p.cov_xy_m2, p.cov_xy_m2, p.var_y_m2] for p in poles])
    return pole_detections(
        stamp_s,
        log_s,
        np.array([(p.x_m, p.y_m) for p in poles]).reshape(-1, 2),
        variance.reshape(-1, 2, 2),
        width_m=[p.width_m for p in poles],
        probability=[p.probability for p in poles],
        view=view,
    )
