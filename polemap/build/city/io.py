"""Checkpoints: what one drive contributes to a map, as plain arrays; never pickled."""

from __future__ import annotations

import json
import zipfile
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from polemap.build.observe import DriveObservations
from polemap.build.passes import PassLandmarks
from polemap.build.sightings import Looks, Sightings
from polemap.drivelog.atomic import atomic_file
from polemap.drivelog.frames import EarthFrame

_VERSION = 3
_SCALARS = ("drive", "frame", "looks", "without_pose")


def write_checkpoint(part: DriveObservations, key: str, path: Path) -> None:
    """Write what a drive contributed; `key` says from what it was computed."""
    head = {
        "version": _VERSION,
        "key": key,
        "drive": part.sightings.drive,
        "frame": part.sightings.frame.to_dict(),
        "without_pose": part.sightings.without_pose,
    }
    arrays: dict[str, Any] = {"rows": part.rows, "apart": part.apart}
    for field in fields(Looks):
        arrays[f"looks.{field.name}"] = getattr(part.sightings.looks, field.name)
    for field in fields(Sightings):
        if field.name not in _SCALARS:
            arrays[f"sightings.{field.name}"] = getattr(part.sightings, field.name)
    for field in fields(PassLandmarks):
        arrays[f"landmarks.{field.name}"] = getattr(part.landmarks, field.name)
    with atomic_file(path) as target, target.open("wb") as stream:
        np.savez_compressed(stream, head=np.array(json.dumps(head)), **arrays)


def read_checkpoint(path: Path, key: str) -> DriveObservations | None:
    """What a drive contributed, or None if there is no checkpoint of exactly this computation."""
    if not path.is_file():
        return None
    try:
        with np.load(path, allow_pickle=False) as file:
            head = json.loads(str(file["head"]))
            if head["version"] != _VERSION or head["key"] != key:
                return None
            looks = Looks(**{f.name: file[f"looks.{f.name}"] for f in fields(Looks)})
            columns = {
                f.name: file[f"sightings.{f.name}"]
                for f in fields(Sightings)
                if f.name not in _SCALARS
            }
            sightings = Sightings(
                drive=head["drive"],
                frame=EarthFrame.from_dict(head["frame"]),
                looks=looks,
                without_pose=int(head["without_pose"]),
                **columns,
            )
            landmarks = PassLandmarks(
                **{f.name: file[f"landmarks.{f.name}"] for f in fields(PassLandmarks)}
            )
            return DriveObservations(sightings, landmarks, file["rows"], file["apart"])
    except (OSError, ValueError, KeyError, zipfile.BadZipFile):
        # a checkpoint that cannot be read costs no more than computing it again
        return None


def clear(folder: Path) -> None:
    """Remove the checkpoints of a finished map, and their folder if nothing else is in it."""
    for path in folder.glob("*.npz"):
        path.unlink()
    if not any(folder.iterdir()):
        folder.rmdir()
