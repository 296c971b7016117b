"""Where a result may be written: never on, above or below what it is made from."""

from __future__ import annotations

import os
import stat
from collections.abc import Iterable
from pathlib import Path

from polemap.drivelog.errors import OutputError
from polemap.drivelog.results.marker import read_marker

Identity = tuple[int, int]

# pictures of a drive lie a folder or two below it
_DEPTH = 4

_KINDS = (
    (stat.S_ISCHR, "a device"),
    (stat.S_ISBLK, "a device"),
    (stat.S_ISFIFO, "a pipe"),
    (stat.S_ISSOCK, "a socket"),
)


def real_target(path: Path, *, folder: bool) -> Path:
    """The place that a result is to stand at, links followed.

    Raises:
        OutputError: something stands there that is neither a file nor a folder, or a folder where
            a file is to be written, or a file where a folder is, or links that lead in a circle, or
            what it is to stand in is no folder.
    """
    try:
        state = os.stat(path)
    except (FileNotFoundError, NotADirectoryError):
        _check_above(path)
        return Path(os.path.realpath(path))
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise OutputError(f"{path}: cannot be written ({reason})") from error
    for is_kind, name in _KINDS:
        if is_kind(state.st_mode):
            raise OutputError(
                f"{path}: is {name}, and polemap replaces files only; name a file or folder"
            )
    if folder and not stat.S_ISDIR(state.st_mode):
        raise OutputError(f"{path}: is a file, a folder is to be written there")
    if not folder and stat.S_ISDIR(state.st_mode):
        raise OutputError(f"{path}: is a folder, a file is to be written there")
    return Path(os.path.realpath(path))


def check_own_kind(path: Path, endings: Iterable[str]) -> None:
    """Refuse a file that is there and is of another kind than the result, by its ending.

    Raises:
        OutputError: a GeoPackage where a TUM file is to be written, say.
    """
    endings = tuple(endings)
    if endings and path.suffix.lower() not in endings and _holds_something(path):
        raise OutputError(
            f"{path}: is there already and is no {' or '.join(endings)} file, which is to be "
            "written; name another, or delete it"
        )


def check_no_part(path: Path) -> None:
    """Refuse a file that belongs to a drive or to a finished result.

    Raises:
        OutputError: the folder of the file, or one above it, lists it as its own.
    """
    if not _holds_something(path):
        return
    real = Path(os.path.realpath(path))
    for folder in list(real.parents)[:_DEPTH]:
        listing = read_marker(folder)
        what = listing.kind or "result"
        own = real.relative_to(folder).as_posix() in listing.files
        if not own and (folder / "drive.yaml").is_file():
            what, own = "drive", True
        if own:
            raise OutputError(
                f"{path}: is a file of the {what} {folder}; choose another place, or delete it"
            )


def _holds_something(path: Path) -> bool:
    try:
        return path.is_file() and path.stat().st_size > 0
    except (OSError, ValueError):
        return False


def _check_above(path: Path) -> None:
    """The nearest thing above a path that exists must be a folder."""
    for parent in Path(path).parents:
        if os.path.lexists(parent):
            if not parent.is_dir():
                raise OutputError(f"{path}: cannot be written ({parent} is no folder)")
            return


def check_not_an_input(out: Path, inputs: Iterable[Path | str | None]) -> None:
    """Refuse a result on, above or below any of the inputs that exist; None is no input.

    Raises:
        OutputError: it would replace an input, or mix with one.
    """
    place = _identity(out)
    above_out = set(_identities_above(out))
    for given in inputs:
        if given is None:
            continue
        known = _identity(given)
        if known is None:
            continue
        if place == known:
            raise OutputError(f"{out}: is the input {given} itself; choose another place")
        if place is not None and place in _identities_above(given):
            raise OutputError(f"{out}: holds the input {given}; choose a place that does not")
        if known in above_out:
            raise OutputError(f"{out}: lies inside the input {given}; choose a place outside it")


def _identity(path: Path | str) -> Identity | None:
    try:
        state = os.stat(path)
    except (OSError, ValueError):
        return None
    return state.st_dev, state.st_ino


def _identities_above(path: Path | str) -> list[Identity]:
    """Of the folders above a path that exist, links followed: what it really lies in."""
    found = (_identity(folder) for folder in Path(os.path.realpath(path)).parents)
    return [one for one in found if one is not None]
