"""Detections of a drive, found once and kept: what every run and value of a sweep starts from.

Kept are the poles of every frame before tracking, so that a lower frame rate is tracked anew, and
the time that finding them took.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polemap.config import PolemapConfig
from polemap.detect.detection import detect
from polemap.detect.models.io import read_classifier, read_corner_classifier
from polemap.drivelog.atomic import atomic_file
from polemap.drivelog.detections import Detections, VisibleRegion, pole_detections
from polemap.drivelog.drive import Drive
from polemap.drivelog.errors import InputError
from polemap.drivelog.landmark_kind import LandmarkKind
from polemap.parsing.arrays import read_arrays
from polemap.parsing.errors import named
from polemap.stereo.config import StereoConfig
from polemap.stereo.matching import make_matcher

Floats = NDArray[np.float64]

FORMAT = 4
STAGES = ("disparity", "detection")
_NO_POLES = pole_detections(0.0, 0.0, np.empty((0, 2)), np.empty((0, 2, 2)))


@dataclass(frozen=True, slots=True)
class RawScans:
    """Poles of some frames before tracking, and the seconds `(n, 2)` that each of `STAGES` took."""

    scans: tuple[Detections, ...]
    spent_s: Floats


def fingerprint(*parts: Any) -> str:
    """A short name for a combination of settings and inputs, the same on every machine."""
    text = json.dumps(parts, sort_keys=True, default=str)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def drive_fingerprint(drive: Drive) -> str:
    """What identifies the input of a replay: its streams and some pictures, not its place."""
    digest = hashlib.sha256()
    count = len(drive.frame_stamps_s) if drive.has_frames else 0
    for row in sorted({0, count // 2, count - 1}) if count else ():
        frame = drive.read_frame(row)
        for image in (frame.left, frame.right):
            digest.update(np.ascontiguousarray(image).tobytes())
    streams = [drive.frame_stamps_s]
    if drive.odometry is not None:
        streams += [drive.odometry.stamp_s, drive.odometry.speed_mps, drive.odometry.yaw_rate_radps]
    if drive.gnss is not None:
        streams += [drive.gnss.stamp_s, drive.gnss.east_m, drive.gnss.north_m]
    streams += [scan.points_vehicle_m for scan in drive.scans]
    for stream in streams:
        digest.update(np.ascontiguousarray(stream).tobytes())
    return digest.hexdigest()[:16]


def raw_scans(
    drive: Drive, polemap: PolemapConfig, stereo: StereoConfig, rows: Sequence[int]
) -> RawScans:
    """Poles of the frames `rows` of a drive, not tracked; a pole's existence is its probability.

    Raises:
        InputError: the drive has no camera, or the classifier cannot be read.
    """
    if drive.rig is None:
        raise InputError(
            f"drive {drive.name}: it has images, but {drive.names.head} describes no camera"
        )
    matcher = make_matcher(stereo, drive.rig)
    config = polemap.detection
    classifier, corners = read_classifier(config.model), None
    if LandmarkKind.CORNER in config.landmark_kinds:
        corners = read_corner_classifier(config.corner_model)
    scans: list[Detections] = []
    spent = np.zeros((len(rows), len(STAGES)))
    for number, row in enumerate(rows):
        frame = drive.read_frame(row)
        begin = perf_counter()
        disparity = matcher.match(frame.left, frame.right)
        middle = perf_counter()
        view = detect(frame, disparity, drive.rig, classifier, config, corners)
        spent[number] = middle - begin, perf_counter() - middle
        scans.append(view.landmarks)
    return RawScans(tuple(scans), spent)


def write_scans(path: Path, raw: RawScans) -> None:
    """Keep scans as plain arrays."""
    views = [scan.view for scan in raw.scans]
    poles: dict[str, Any] = Detections.concatenate([_NO_POLES, *raw.scans]).arrays()
    with atomic_file(path) as part, part.open("wb") as stream:
        np.savez_compressed(
            stream,
            format=np.array(FORMAT),
            spent=raw.spent_s,
            stamps=np.array([(scan.stamp_s, scan.arrival_s) for scan in raw.scans]).reshape(-1, 2),
            counts=np.array([len(scan) for scan in raw.scans], dtype=np.int64),
            bins=np.array([len(v.free_range_m) if v else -1 for v in views], dtype=np.int64),
            sector=np.array([_sector(v) for v in views]).reshape(-1, 5),
            free=np.concatenate([np.empty(0), *(v.free_range_m for v in views if v)]),
            **poles,
        )


def read_scans(path: Path) -> RawScans | None:
    """What `write_scans` kept; None if it is not there or cannot be read."""
    try:
        with named(path, InputError, "kept part of a drive"):
            return _scans(read_arrays(path))
    except InputError:
        return None


def _scans(data: Mapping[str, NDArray[Any]]) -> RawScans | None:
    if int(data.get("format", np.array(0))) != FORMAT:
        return None
    _check_rows(data)
    poles = Detections.from_arrays(data, stamp_s=0.0, arrival_s=0.0)
    ends = np.concatenate([[0], np.cumsum(data["counts"])])
    free_ends = np.concatenate([[0], np.cumsum(np.maximum(data["bins"], 0))])
    scans = []
    for i, (stamp_s, arrival_s) in enumerate(data["stamps"].tolist()):
        view = None
        if data["bins"][i] >= 0:
            x, y, left, right, nearest = data["sector"][i].tolist()
            free = data["free"][free_ends[i] : free_ends[i + 1]]
            view = VisibleRegion(np.array([x, y]), left, right, nearest, free)
        part = poles.take(slice(ends[i], ends[i + 1]))
        scans.append(replace(part, stamp_s=stamp_s, arrival_s=arrival_s, view=view))
    return RawScans(tuple(scans), data["spent"])


def _check_rows(data: Mapping[str, NDArray[Any]]) -> None:
    """Every array has the type and the rows that the counts promise.

    Raises:
        ValueError: one has not.
    """
    scans, poles = len(data["stamps"]), int(data["counts"].sum())
    shapes = {
        "stamps": (scans, 2), "counts": (scans,), "bins": (scans,), "sector": (scans, 5),
        "spent": (scans, len(STAGES)), "free": (int(np.maximum(data["bins"], 0).sum()),),
    }  # fmt: skip
    kinds = {name: np.dtype(np.int64 if name in ("counts", "bins") else float) for name in shapes}
    for name, column in _NO_POLES.arrays().items():
        shapes[name], kinds[name] = (poles, *column.shape[1:]), column.dtype
    for name, shape in shapes.items():
        if data[name].shape != shape or data[name].dtype != kinds[name]:
            raise ValueError(f"{name} is {data[name].dtype} {data[name].shape}, not {shape}")
    if (data["counts"] < 0).any() or not np.isfinite(data["stamps"]).all():
        raise ValueError("a scan without a stamp, or of less than no poles")


def _sector(view: VisibleRegion | None) -> list[float]:
    if view is None:
        return [0.0] * 5
    x, y = view.origin_vehicle_m.tolist()
    return [x, y, view.bearing_min_rad, view.bearing_max_rad, view.range_min_m]
