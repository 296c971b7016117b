"""Results appear whole or not at all, and cost nobody a file.

Everything that polemap writes goes through here:

- it is made in a workspace beside its final place, then put there by a rename, or by the swap of
  an old folder for the new one; whatever signal comes, the old or the new one stands there whole;
- a folder is replaced only if polemap wrote every file in it (`results.marker`) as the same kind
  of result; a result is never written on, above or below its inputs (`results.targets`);
- one process at a time writes a folder; what a killed one left behind is removed by the next
  (`results.workspace`).
"""

from __future__ import annotations

import errno
import os
import shutil
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from itertools import combinations
from pathlib import Path

from polemap.drivelog.errors import OutputError
from polemap.drivelog.results.exchange import READY, REPLACED, put_in_place
from polemap.drivelog.results.marker import (
    MARKER,
    Listing,
    foreign_file,
    marker_text,
    read_marker,
    write_marker,
)
from polemap.drivelog.results.signature import check_signature
from polemap.drivelog.results.targets import (
    check_no_part,
    check_not_an_input,
    check_own_kind,
    real_target,
)
from polemap.drivelog.results.workspace import (
    ENDING,
    fresh_folder,
    own_workspace,
    scratch_folder,
)

__all__ = [
    "MARKER",
    "atomic_file",
    "atomic_folder",
    "check_file",
    "check_files",
    "check_folder",
    "copy_folder",
    "own_folder",
    "reserved",
    "scratch_folder",
]

# what writing to an open file fails with when its disk is full, over quota or broken
_DISK_ERRORS = frozenset({errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO})
Inputs = Iterable[Path | str | None]


def check_file(path: Path, inputs: Inputs = (), endings: Iterable[str] = ()) -> None:
    """Refuse, before work begins, a place that a result must not have.

    Args:
        path: where it is to stand.
        inputs: what it is made from.
        endings: of such results; a file of another one that is there already is kept.

    Raises:
        OutputError: the place is no file, is on or below an input, holds a file of another kind
            or by another program, or one that belongs to a drive or to a finished result.
    """
    path = Path(path)
    real_target(path, folder=False)
    check_not_an_input(path, inputs)
    check_own_kind(path, endings)
    check_no_part(path)
    check_signature(path)


def check_files(paths: Sequence[Path | None], inputs: Inputs = ()) -> None:
    """`check_file` of all that a command writes; None is nothing.

    Raises:
        OutputError: as `check_file`, or two of them are one file.
    """
    given = [Path(path) for path in paths if path is not None]
    inputs = tuple(inputs)
    for path in given:
        check_file(path, inputs)
    for first, second in combinations(given, 2):
        if os.path.realpath(first) == os.path.realpath(second):
            raise OutputError(f"{second}: is asked for as two results; give each its own file")


def check_folder(path: Path, kind: str, inputs: Inputs = (), carried: tuple[str, ...] = ()) -> None:
    """Refuse, before work begins, what `atomic_folder` would refuse at its end.

    Raises:
        OutputError: as `atomic_folder`.
    """
    target = real_target(Path(path), folder=True)
    check_not_an_input(Path(path), inputs)
    check_replaceable(Path(path), target, kind, carried)


@contextmanager
def atomic_file(path: Path, inputs: Inputs = ()) -> Iterator[Path]:
    """A temporary path to write to; it becomes `path` when the block ends well, else it goes.

    Args:
        path: a link is followed: what it leads to is replaced.
        inputs: what the file is made from.

    Raises:
        OutputError: the place cannot be written to, is no file, or is an input.
    """
    path = Path(path)
    target = real_target(path, folder=False)
    check_not_an_input(path, inputs)
    with fresh_folder(target) as place, _place_of_full_disks(path):
        part = place / target.name
        yield part
        os.replace(part, target)


@contextmanager
def reserved(path: Path) -> Iterator[None]:
    """Keeps a place that long work leads to, so that one process at a time does it.

    Inside the block this process writes it as ever.

    Raises:
        OutputError: another process writes it now, or the place cannot be written to.
    """
    with own_workspace(Path(os.path.realpath(path))):
        yield


@contextmanager
def atomic_folder(
    path: Path, kind: str, inputs: Inputs = (), carried: tuple[str, ...] = ()
) -> Iterator[Path]:
    """A temporary folder to fill; it becomes `path` when the block ends well, else it goes.

    A folder of the same kind, in which polemap wrote every file, is replaced as a whole; any other
    that is not empty is left alone.

    Args:
        path: a link is followed: what it leads to is replaced.
        kind: of result: drive, run, report and the like.
        inputs: what the folder is made from.
        carried: folders directly in the old one that the new one gets too, such as a cache.

    Raises:
        OutputError: the place cannot be written to, is no folder, holds files that polemap did
            not write, is on, above or below an input, or another process writes it now.
    """
    path = Path(path)
    target = real_target(path, folder=True)
    check_not_an_input(path, inputs)
    with own_workspace(target):
        check_replaceable(path, target, kind, carried)
        with fresh_folder(target) as place, _place_of_full_disks(path):
            part = place / READY
            part.mkdir()
            yield part
            for name in carried:
                if (target / name).is_dir() and not (part / name).exists():
                    copy_folder(target / name, part / name)
            write_marker(part, kind)
            put_in_place(part, target)
            for name in carried:
                _move_missing(place / REPLACED / name, target / name)


@contextmanager
def _place_of_full_disks(path: Path) -> Iterator[None]:
    """Errors of a full disk name no file, or a temporary one: the result's name is put in."""
    try:
        yield
    except OSError as error:
        if error.errno in _DISK_ERRORS:
            error.filename = str(path)
        raise


def check_replaceable(path: Path, target: Path, kind: str, carried: tuple[str, ...]) -> None:
    """Refuse a folder that is not polemap's own, of this kind, in every file.

    Raises:
        OutputError: it holds something else; the message names the first such file.
    """
    if not target.is_dir():
        return
    listing = read_marker(target)
    if listing.kind and listing.kind != kind:
        raise OutputError(
            f"{path}: holds a {listing.kind}, and a {kind} is to be written there; choose another "
            "folder, or delete this one"
        )
    foreign = foreign_file(target, listing, carried)
    if foreign is not None:
        raise OutputError(
            f"{path}: holds files that polemap did not write and would replace (such as "
            f"{foreign[-80:]}); choose another folder, or empty this one"
        )


def copy_folder(source: Path, target: Path) -> None:
    """A folder of results once more; files are linked where that can be, since none changes."""
    shutil.copytree(source, target, symlinks=True, copy_function=_link)


def own_folder(path: Path, kind: str, parts: Sequence[Path]) -> None:
    """Make a folder in which each of `parts` will be written by itself, or take such a one again.

    Raises:
        OutputError: it holds anything else, or parts that no such call wrote.
    """
    target = real_target(Path(path), folder=True)
    names = {part.name for part in parts}
    try:
        target.mkdir(parents=True, exist_ok=True)
        there = sorted(entry.name for entry in os.scandir(target))
        is_own = read_marker(target).kind == kind
        foreign = [n for n in there if not is_own or n not in names | {MARKER}]
        foreign = [n for n in foreign if not (n.startswith(".") and n.endswith(ENDING))]
        if foreign:
            raise OutputError(
                f"{path}: holds files that polemap did not write (such as {foreign[0][-80:]}); "
                "choose another folder, or empty this one"
            )
        if not is_own:
            with atomic_file(target / MARKER) as part:
                part.write_text(marker_text(Listing(kind)), encoding="utf-8")
    except OSError as error:
        raise OutputError(f"{path}: cannot be written ({error.strerror})") from error


def _move_missing(old: Path, new: Path) -> None:
    """What came into a carried folder while it was carried follows; the rest is there twice."""
    if not old.is_dir():
        return
    for folder, _, names in os.walk(old):
        there = new / Path(folder).relative_to(old)
        there.mkdir(exist_ok=True)
        for name in names:
            if not os.path.lexists(there / name):
                os.rename(Path(folder) / name, there / name)
    shutil.rmtree(old, ignore_errors=True)


def _link(source: str, target: str) -> None:
    """The same file under a second name; a copy where that cannot be."""
    try:
        os.link(source, target, follow_symlinks=False)
    except OSError as error:
        if error.errno == errno.ENOSPC:
            raise
        shutil.copy2(source, target, follow_symlinks=False)
