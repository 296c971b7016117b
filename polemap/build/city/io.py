"""Checkpoints: what one drive contributes to a map, as plain arrays; never pickled."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polemap.build.drive_observations import DriveObservations
from polemap.build.georeference import MapDetections, ScanViews
from polemap.build.lines.seen_lines import SeenLines
from polemap.build.traversals import TraversalLandmarks
from polemap.drivelog.atomic import atomic_file
from polemap.drivelog.errors import InputError
from polemap.drivelog.frames import EarthFrame
from polemap.parsing.arrays import read_arrays
from polemap.parsing.errors import named
from polemap.parsing.json_text import parse_json

_VERSION = 7
_KEY = re.compile("[0-9a-f]{32}")


def write_checkpoint(part: DriveObservations, key: str, path: Path) -> None:
    """Write what a drive contributed; `key` says from what it was computed."""
    head, arrays = observation_arrays(part)
    write_arrays({"version": _VERSION, "key": key, **head}, arrays, path)


def write_arrays(head: Mapping[str, Any], arrays: Mapping[str, Any], path: Path) -> None:
    """Write arrays with a head of JSON."""
    with atomic_file(path) as target, target.open("wb") as stream:
        np.savez_compressed(stream, head=np.array(json.dumps(head)), **dict(arrays))


def observation_arrays(part: DriveObservations) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    """What a drive contributed as a head and arrays, the way `observations_of` takes them."""
    head = {
        "drive": part.detections.drive,
        "frame": part.detections.frame.to_dict(),
        "without_pose": part.detections.without_pose,
    }
    arrays: dict[str, Any] = {"rows": part.rows, "cannot_link": part.cannot_link}
    for name, table in (
        ("views", part.detections.views),
        ("detections", part.detections),
        ("landmarks", part.landmarks),
    ):
        arrays |= {f"{name}.{column}": values for column, values in table.arrays().items()}
    if part.lines is not None:
        arrays |= {f"lines.{name}": values for name, values in part.lines.arrays().items()}
    return head, arrays


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
    if head.get("version") != _VERSION or head.get("key") != key:
        return None
    return observations_of(head, file)


def observations_of(head: Mapping[str, Any], file: Mapping[str, NDArray[Any]]) -> DriveObservations:
    """The inverse of `observation_arrays`.

    Raises:
        KeyError: something is missing.
    """
    detections = MapDetections.from_arrays(
        _columns(file, "detections"),
        drive=head["drive"],
        frame=EarthFrame.from_dict(head["frame"]),
        views=ScanViews.from_arrays(_columns(file, "views")),
        without_pose=int(head["without_pose"]),
    )
    landmarks = TraversalLandmarks.from_arrays(_columns(file, "landmarks"))
    lines = _columns(file, "lines")
    return DriveObservations(
        detections,
        landmarks,
        file["rows"],
        file["cannot_link"],
        SeenLines.from_arrays(lines) if lines else None,
    )


def _columns(file: Mapping[str, NDArray[Any]], table: str) -> dict[str, NDArray[Any]]:
    """The columns of one of the tables."""
    return {key.partition(".")[2]: file[key] for key in file if key.startswith(f"{table}.")}


def clear(folder: Path) -> None:
    """Remove the checkpoints of a finished map, and their folder if nothing else is in it."""
    for path in folder.glob("*.npz"):
        # a key and nothing else: what somebody put there stays
        if _KEY.fullmatch(path.stem):
            path.unlink()
    with suppress(OSError):
        folder.rmdir()
