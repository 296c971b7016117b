"""The pieces of lines that one drive saw, by the scan that saw them, and their place in the map.

They are kept in the vehicle frame: whatever moves the poses of a drive moves its lines along.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from polemap.build.georeference import ScanViews
from polemap.drivelog.columns import Columns
from polemap.drivelog.detections import Detections
from polemap.drivelog.line_detections import LineDetections
from polemap.drivelog.streams import ReferenceStream
from polemap.map.line_map import LineMap
from polemap.vehicle.pose import rotate

Floats = NDArray[np.float64]
Whole = NDArray[np.int64]


@dataclass(frozen=True, slots=True, kw_only=True)
class SeenLines(Columns):
    """Pieces of lines; every array has a row a piece, sorted by scan.

    Attributes:
        scan: row of the drive's `ScanViews`.
        reference_sd_m, reference_yaw_sd_rad: of the pose that it was seen from.
        kind, style, start_vehicle_m, end_vehicle_m, offset_sd_m, direction_sd_rad, probability:
            as in `LineDetections`.
    """

    scan: Whole
    reference_sd_m: Floats
    reference_yaw_sd_rad: Floats
    kind: NDArray[np.int8]
    style: NDArray[np.int8]
    start_vehicle_m: Floats
    end_vehicle_m: Floats
    offset_sd_m: Floats
    direction_sd_rad: Floats
    probability: Floats


@dataclass(frozen=True, slots=True, kw_only=True)
class MapPieces(Columns):
    """Pieces of lines of all drives in the map's frame.

    Attributes:
        drive: number of the drive; -1 of a map that is brought up to date.
        kind, style: as in `LineDetections`.
        start_m, end_m: `(n, 2)`.
        sd_m: `(n,)` across, of the detector alone.
        shared_sd_m: `(n,)` across, what all pieces of a drive share near a place.
        weight: `(n,)` how many looks a piece stands for, as probable as they are.
    """

    drive: Whole
    kind: NDArray[np.int8]
    style: NDArray[np.int8]
    start_m: Floats
    end_m: Floats
    sd_m: Floats
    shared_sd_m: Floats
    weight: Floats


def seen_lines(
    scans: Sequence[Detections],
    views: ScanViews,
    reference: ReferenceStream,
    reference_sd_m: float,
    reference_yaw_sd_rad: float,
) -> SeenLines | None:
    """The pieces of the scans that have a pose; None where the detector looks for no lines.

    Args:
        reference_sd_m: of poses that state none.
        reference_yaw_sd_rad: of all poses.
    """
    looked = [scan for scan in scans if scan.lines is not None]
    if not looked or not len(views):
        return None
    stamps = np.array([scan.stamp_s for scan in looked])
    rows = np.minimum(np.searchsorted(views.stamp_s, stamps), len(views) - 1)
    posed = views.stamp_s[rows] == stamps
    lines = [scan.lines for scan, has in zip(looked, posed, strict=True) if has]
    count = [len(one) for one in lines if one is not None]
    every = LineDetections.concatenate(
        [LineDetections.none(), *(one for one in lines if one is not None)]
    )
    scan = np.repeat(rows[posed], count).astype(np.int64)
    finite = np.isfinite(every.start_vehicle_m).all(axis=1)
    finite &= np.isfinite(every.end_vehicle_m).all(axis=1) & (every.length_m > 0.0)
    finite &= np.isfinite(every.offset_sd_m) & np.isfinite(every.direction_sd_rad)
    every, scan = every.take(finite), scan[finite]
    stated = reference.sd_at(views.stamp_s)[scan]
    return SeenLines(
        scan=scan,
        reference_sd_m=np.where(np.isfinite(stated), stated, reference_sd_m),
        reference_yaw_sd_rad=np.full(len(scan), reference_yaw_sd_rad),
        **every.arrays(),
    )


def pieces_in_map(drive: int, seen: SeenLines, poses: Floats) -> MapPieces:
    """A drive's pieces in the map's frame, by the poses `(m, 3)` of its scans."""
    pose = poses[seen.scan]
    middle = 0.5 * (seen.start_vehicle_m + seen.end_vehicle_m)
    away = np.hypot(middle[:, 0], middle[:, 1])
    return MapPieces(
        drive=np.full(len(seen), drive, dtype=np.int64),
        kind=seen.kind,
        style=seen.style,
        start_m=pose[:, :2] + rotate(seen.start_vehicle_m, pose[:, 2]),
        end_m=pose[:, :2] + rotate(seen.end_vehicle_m, pose[:, 2]),
        sd_m=seen.offset_sd_m,
        shared_sd_m=np.hypot(seen.reference_sd_m, away * seen.reference_yaw_sd_rad),
        weight=np.clip(seen.probability, 0.0, 1.0),
    )


def pieces_of_map(lines: LineMap) -> MapPieces:
    """The pieces of a map that is brought up to date, each worth all that was seen of it."""
    segments = lines.segments
    return MapPieces(
        drive=np.full(len(segments), -1, dtype=np.int64),
        kind=segments.kind,
        style=segments.style,
        start_m=segments.start_m,
        end_m=segments.end_m,
        sd_m=np.full(len(segments), 1e-3),
        shared_sd_m=segments.sd_m,
        weight=np.maximum(lines.observations[segments.line], 1).astype(np.float64),
    )
