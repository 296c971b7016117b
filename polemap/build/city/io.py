"""Checkpoints: what one drive contributes to a map, as plain arrays; never pickled."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polemap.build.drive_observations import DriveObservations
from polemap.build.georeference import MapDetections, ScanViews
from polemap.build.traversals import TraversalLandmarks
from polemap.drivelog.atomic import atomic_file
from polemap.drivelog.errors import InputError
from polemap.drivelog.frames import EarthFrame
from polemap.parsing.arrays import read_arrays
from polemap.parsing.errors import named
from polemap.parsing.json_text import parse_json

_VERSION = 3
_SCALARS = ("drive", "frame", "views", "without_pose")
_KEY = re.compile("[0-9a-f]{32}")


def write_checkpoint(part: DriveObservations, key: str, path: Path) -> None:
    """Write what a drive contributed; `key` says from what it was computed."""
    head = {
        "version": _VERSION,
        "key": key,
        "drive": part.detections.drive,
        "frame": part.detections.frame.to_dict(),
        "without_pose": part.detections.without_pose,
    }
    arrays: dict[str, Any] = {"rows": part.rows, "cannot_link": part.cannot_link}
    for field in fields(ScanViews):
        arrays[f"views.{field.name}"] = getattr(part.detections.views, field.name)
    for field in fields(MapDetections):
        if field.name not in _SCALARS:
            arrays[f"detections.{field.name}"] = getattr(part.detections, field.name)
    for field in fields(TraversalLandmarks):
        arrays[f"landmarks.{field.name}"] = getattr(part.landmarks, field.name)
    with atomic_file(path) as target, target.open("wb") as stream:
        np.savez_compressed(stream, head=np.array(json.dumps(head)), **arrays)


def read_checkpoint(path: Path, key: str) -> DriveObservations | None:
    """What a drive contributed, or None if there is no checkpoint of exactly this computation."""
    if not path.is_file():
        return None
    try:
        with named(path, InputError, "checkpoint"):
            return _observations(read_arrays(path), key)
    except InputError:
        # a checkpoint that cannot be read costs no more than computing it again
        return None


def _observations(file: Mapping[str, NDArray[Any]], key: str) -> DriveObservations | None:
    head = parse_json(str(file["head"]))
    if head["version"] != _VERSION or head["key"] != key:
        return None
    views = ScanViews(**{f.name: file[f"views.{f.name}"] for f in fields(ScanViews)})
    columns = {
        f.name: file[f"detections.{f.name}"]
        for f in fields(MapDetections)
        if f.name not in _SCALARS
    }
    detections = MapDetections(
        drive=head["drive"],
        frame=EarthFrame.from_dict(head["frame"]),
        views=views,
        without_pose=int(head["without_pose"]),
        **columns,
    )
    landmarks = TraversalLandmarks(
        **{f.name: file[f"landmarks.{f.name}"] for f in fields(TraversalLandmarks)}
    )
    return DriveObservations(detections, landmarks, file["rows"], file["cannot_link"])


def clear(folder: Path) -> None:
    """Remove the checkpoints of a finished map, and their folder if nothing else is in it."""
    for path in folder.glob("*.npz"):
        # a key and nothing else: what somebody put there stays
        if _KEY.fullmatch(path.stem):
            path.unlink()
    with suppress(OSError):
        folder.rmdir()
