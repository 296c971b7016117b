"""The list of what polemap wrote into a folder: only what stands in it may ever be deleted.

`.polemap` is a JSON document: the kind of result, every folder, and every file with its size. A
file that is not listed, or whose size is another now, is somebody's own.
"""

from __future__ import annotations

import json
import os
import stat
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from typing import Any

MARKER = ".polemap"
_VERSION = 1
# a list of 500 000 files is 40 MB
_LARGEST_BYTES = 200_000_000


@dataclass(frozen=True, slots=True)
class Listing:
    """What polemap wrote into a folder; paths are relative, with `/`.

    Attributes:
        kind: of result, such as `drive` or `run`; empty where the marker says nothing.
        files: size in bytes by path.
        folders: paths.
    """

    kind: str = ""
    files: dict[str, int] = field(default_factory=dict)
    folders: frozenset[str] = frozenset()


NOTHING = Listing()


def write_marker(folder: Path, kind: str) -> None:
    """List all that stands in a folder that polemap filled."""
    files: dict[str, int] = {}
    folders: list[str] = []
    for path, name, is_folder in _walk(folder):
        if is_folder:
            folders.append(name)
        else:
            files[name] = path.lstat().st_size
    files.pop(MARKER, None)
    listing = Listing(kind, files, frozenset(folders))
    (folder / MARKER).write_text(marker_text(listing), encoding="utf-8")


def marker_text(listing: Listing) -> str:
    """The content of a marker."""
    document = {
        "polemap": _VERSION,
        "about": "polemap wrote what is listed here, and may replace it; nothing else",
        "kind": listing.kind,
        "folders": sorted(listing.folders),
        "files": dict(sorted(listing.files.items())),
    }
    return json.dumps(document, indent=0) + "\n"


def read_marker(folder: Path) -> Listing:
    """What the marker of a folder lists; nothing where it has none, or none that can be read."""
    path = folder / MARKER
    try:
        state = path.lstat()
        if not stat.S_ISREG(state.st_mode) or state.st_size > _LARGEST_BYTES:
            return NOTHING
        document: Any = json.loads(path.read_text(encoding="utf-8"))
        if document["polemap"] != _VERSION:
            return NOTHING
        files = {name: size for name, size in document["files"].items() if _inside(name)}
        folders = frozenset(name for name in document["folders"] if _inside(name))
        if not all(isinstance(size, int) for size in files.values()):
            return NOTHING
        return Listing(str(document["kind"]), files, folders)
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return NOTHING


def foreign_file(folder: Path, listing: Listing, carried: tuple[str, ...] = ()) -> str | None:
    """The first thing in a folder that polemap did not list, or that is another by now.

    Args:
        carried: folders on the first level that will be carried over, whatever is in them.
    """
    for path, name, is_folder in _walk(folder, carried):
        if name == MARKER and listing is not NOTHING:
            continue
        if is_folder:
            if name not in listing.folders:
                return name
        elif not _is_listed(path, name, listing):
            return name
    return None


def remove_listed(folder: Path) -> bool:
    """Delete what the marker lists, then the marker; True if the whole folder is gone.

    What is not listed stays where it is.
    """
    listing = read_marker(folder)
    entries = list(_walk(folder))
    for path, name, is_folder in entries:
        if not is_folder and _is_listed(path, name, listing):
            path.unlink(missing_ok=True)
    for path, name, is_folder in reversed(entries):
        if is_folder and name in listing.folders:
            _remove_empty(path)
    # a folder that was empty and never had a marker goes too
    rest = [entry.name for entry in os.scandir(folder)]
    if rest == [MARKER] and listing is not NOTHING:
        (folder / MARKER).unlink(missing_ok=True)
    return _remove_empty(folder)


def _remove_empty(folder: Path) -> bool:
    try:
        folder.rmdir()
    except OSError:
        return False
    return True


def _is_listed(path: Path, name: str, listing: Listing) -> bool:
    size = listing.files.get(name)
    if size is None:
        return False
    state = path.lstat()
    return stat.S_ISREG(state.st_mode) and state.st_size == size


def _inside(name: Any) -> bool:
    """Whether a name of a marker leads to a place below its folder."""
    path = PurePosixPath(name)
    return bool(path.parts) and not path.is_absolute() and ".." not in path.parts


def _walk(folder: Path, without: tuple[str, ...] = ()) -> Iterator[tuple[Path, str, bool]]:
    """Path, name and whether it is a folder, of all that is below; links are not followed."""
    stack = [("", folder)]
    while stack:
        prefix, place = stack.pop()
        for entry in sorted(os.scandir(place), key=lambda entry: entry.name):
            name = prefix + entry.name
            if name in without:
                continue
            is_folder = entry.is_dir(follow_symlinks=False)
            yield Path(entry.path), name, is_folder
            if is_folder:
                stack.append((name + "/", Path(entry.path)))
