"""The files that a map consists of, and what they are like: one file, or a folder of them."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from polemap.drivelog.errors import InputError

ENDINGS = (".gpkg", ".parquet")
"""Of the files of a folder that is opened as one map."""
_HASHED_AT_ONCE = 2**22

State = dict[str, dict[str, int]]


def map_files(path: Path) -> list[Path]:
    """The map files of a folder, by name; none of one that holds a drive or other folders."""
    if not path.is_dir() or (path / "drive.yaml").exists():
        return []
    inside = [one for one in path.iterdir() if not one.name.startswith(".")]
    if any(one.is_dir() for one in inside):
        return []
    return sorted(one for one in inside if one.suffix.lower() in ENDINGS)


def require_map(path: Path) -> None:
    """Refuse what is neither a file nor a folder of maps.

    Raises:
        InputError: it is not.
    """
    if not path.exists():
        raise InputError(f"{path}: no such map")
    if path.is_dir() and not map_files(path):
        raise InputError(f"{path}: no such map; a folder of maps holds .gpkg or .parquet files")


def map_state(path: Path) -> State:
    """Size and time of change of every file of a map, by its name; of a single file by ""."""
    files = map_files(path) if path.is_dir() else [path]
    state: State = {}
    for file in files:
        known = file.stat()
        state[_name(file, path)] = {"size": known.st_size, "modified_ns": known.st_mtime_ns}
    return state


def map_digests(path: Path) -> dict[str, str]:
    """SHA-256 of the bytes of every file of a map, named as by `map_state`."""
    files = map_files(path) if path.is_dir() else [path]
    return {_name(file, path): _digest(file) for file in files}


def is_of(kept: Mapping[str, Any], path: Path) -> bool:
    """Whether a map is as it was: by sizes and times, by the bytes of files that were copied.

    Args:
        kept: `size`, `modified_ns` and `sha256` by file.
    """
    state = map_state(path)
    if state.keys() != kept.keys():
        return False
    if any(state[name]["size"] != kept[name]["size"] for name in state):
        return False
    return all(
        now["modified_ns"] == kept[name]["modified_ns"]
        or _digest(path / name if name else path) == kept[name]["sha256"]
        for name, now in state.items()
    )


def _name(file: Path, path: Path) -> str:
    return "" if file == path else file.name


def _digest(file: Path) -> str:
    digest = hashlib.sha256()
    with file.open("rb") as stream:
        while block := stream.read(_HASHED_AT_ONCE):
            digest.update(block)
    return digest.hexdigest()
