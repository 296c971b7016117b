"""Checkpoints of condensed drives, as plain arrays; never pickled."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polemap.build.city.io import observation_arrays, observations_of, write_arrays
from polemap.build.slam.condense import Condensed
from polemap.build.slam.motion import Increments
from polemap.build.slam.motion import Path as Way
from polemap.drivelog.errors import InputError
from polemap.drivelog.frames import EarthFrame
from polemap.parsing.arrays import read_arrays
from polemap.parsing.errors import named
from polemap.parsing.json_text import parse_json

_VERSION = "condensed 1"
_OWN = (
    "stamp_s", "chain", "calibration", "calibration_s", "known", "information", "fix_s", "fix_m",
    "hdop", "antenna_m",
)  # fmt: skip
_WAY = ("stamp_s", "poses", "travelled_m", "variance")
_STEPS = ("motion", "jacobian", "covariance")


def write_condensed(part: Condensed, key: str, path: Path) -> None:
    """Write a condensed drive; `key` says from what it was computed."""
    head, arrays = observation_arrays(part.observed)
    head |= {"version": _VERSION, "key": key, "name": part.name}
    arrays["residual_m"] = np.array(part.residual_m)
    arrays |= {f"own.{name}": getattr(part, name) for name in _OWN}
    arrays |= {f"way.{name}": getattr(part.path, name) for name in _WAY}
    arrays |= {f"steps.{name}": getattr(part.steps, name) for name in _STEPS}
    write_arrays(head, arrays, path)


def read_condensed(path: Path, key: str) -> Condensed | None:
    """A condensed drive, or None if there is no checkpoint of exactly this computation."""
    if not path.is_file():
        return None
    try:
        with named(path, InputError, "checkpoint"):
            return _condensed(read_arrays(path), key)
    except InputError:
        # a checkpoint that cannot be read costs no more than computing it again
        return None


def _condensed(file: Mapping[str, NDArray[Any]], key: str) -> Condensed | None:
    head = parse_json(str(file["head"]))
    if head.get("version") != _VERSION or head.get("key") != key:
        return None
    return Condensed(
        name=str(head["name"]),
        frame=EarthFrame.from_dict(head["frame"]),
        path=Way(*(file[f"way.{name}"] for name in _WAY)),
        steps=Increments(*(file[f"steps.{name}"] for name in _STEPS)),
        residual_m=float(file["residual_m"]),
        observed=observations_of(head, file),
        **{name: file[f"own.{name}"] for name in _OWN},
    )
