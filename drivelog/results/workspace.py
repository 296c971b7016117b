"""Folders in which results are made, beside their final place: locked, and swept when abandoned.

A workspace is `.NAME.part` (one process at a time writes NAME) or `.NAME.RANDOM.part` (several
may). Its file `lock` is held with `flock` as long as its process lives, so that a workspace whose
lock can be had was left behind by a process that was killed, on whatever machine that was.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import shutil
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from polemap.drivelog.errors import OutputError
from polemap.drivelog.results.exchange import REPLACED, finish_exchange
from polemap.drivelog.results.lock import CAN_LOCK, LOCK, SIGNATURE, is_ours, still_there, try_lock
from polemap.drivelog.results.marker import remove_listed

ENDING = ".part"
_LONGEST_NAME = 200

# workspaces that this process holds, by the target that they are for
_held: dict[Path, Path] = {}
_swept: set[Path] = set()


@contextmanager
def own_workspace(target: Path) -> Iterator[Path]:
    """The one workspace of `target`; within one process it may be taken again while it is held.

    Raises:
        OutputError: another process writes `target` now, or the place cannot be written to.
    """
    if target in _held:
        yield _held[target]
        return
    made = _make_parents(target)
    sweep(target.parent)
    place = target.parent / f".{_short(target.name)}{ENDING}"
    lock = -1
    try:
        lock = _take(place, target)
        _held[target] = place
        yield place
    finally:
        _held.pop(target, None)
        if lock >= 0:
            _give_back(place, lock)
        else:
            _leave(place)
        _remove_empty(made)


@contextmanager
def fresh_folder(target: Path) -> Iterator[Path]:
    """A new folder for one writing of `target`: in the workspace that is held, or one of its own.

    Raises:
        OutputError: the place cannot be written to.
    """
    if target in _held:
        place = Path(tempfile.mkdtemp(dir=_held[target]))
        try:
            yield place
        finally:
            empty(place, target.parent)
            shutil.rmtree(place, ignore_errors=True)
        return
    made = _make_parents(target)
    if target.parent not in _swept:
        _swept.add(target.parent)
        sweep(target.parent)
    place, lock = _take_random(target.parent, _short(target.name), target)
    try:
        yield place
    finally:
        _give_back(place, lock)
        _remove_empty(made)


@contextmanager
def scratch_folder() -> Iterator[Path]:
    """A folder for what is needed for a while, in the system's place for such.

    Raises:
        OutputError: that place cannot be written to.
    """
    parent = Path(tempfile.gettempdir())
    sweep(parent)
    place, lock = _take_random(parent, "polemap", parent)
    try:
        inner = place / "scratch"
        inner.mkdir()
        yield inner
    finally:
        _give_back(place, lock)


def sweep(parent: Path) -> None:
    """Remove the workspaces in a folder whose processes are dead, finishing what they began."""
    if not CAN_LOCK:
        return
    try:
        names = [
            entry.name
            for entry in os.scandir(parent)
            if entry.name.startswith(".") and entry.name.endswith(ENDING)
        ]
    except OSError:
        return
    for name in names:
        place = parent / name
        try:
            lock = os.open(place / LOCK, os.O_RDWR | os.O_NOFOLLOW | os.O_CLOEXEC)
        except OSError:
            continue
        if is_ours(place, lock) and try_lock(lock) and still_there(place, lock):
            _give_back(place, lock)
        else:
            os.close(lock)


def empty(place: Path, parent: Path) -> None:
    """Clear a folder of a workspace; what somebody else put into a replaced result is kept."""
    finish_exchange(place, parent)
    replaced = place / REPLACED
    if replaced.is_dir() and not _removed(replaced):
        kept = _unused(parent / f"{_target_name(place)}.kept")
        os.rename(replaced, kept)
        sys.stderr.write(
            f"polemap: note: files that polemap did not write were in the old result; they are in "
            f"{kept} now\n"
        )


def _removed(replaced: Path) -> bool:
    try:
        return remove_listed(replaced)
    except OSError:
        return False


def _target_name(place: Path) -> str:
    """The name that a workspace, or a folder in one, is for."""
    name = place.name if place.name.endswith(ENDING) else place.parent.name
    return name.removeprefix(".").removesuffix(ENDING)


def _unused(path: Path) -> Path:
    number, free = 2, path
    while os.path.lexists(free):
        number, free = number + 1, path.with_name(f"{path.name}{number}")
    return free


def _make_parents(target: Path) -> list[Path]:
    """The folders above `target`, made where they are missing; those that were, deepest last."""
    missing = []
    place = target.parent
    while not place.exists() and place != place.parent:
        missing.append(place)
        place = place.parent
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"{target}: cannot be written ({error.strerror})") from error
    return missing[::-1]


def _remove_empty(folders: list[Path]) -> None:
    """Remove folders that were made for a result that did not come."""
    for folder in reversed(folders):
        try:
            folder.rmdir()
        except OSError:
            return


def _short(name: str) -> str:
    """A name that leaves room for what is added to it."""
    if len(os.fsencode(name)) <= _LONGEST_NAME:
        return name
    return f"{name[:40]}-{hashlib.sha256(os.fsencode(name)).hexdigest()[:16]}"


def _take_random(parent: Path, name: str, target: Path) -> tuple[Path, int]:
    while True:
        try:
            place = Path(tempfile.mkdtemp(prefix=f".{name}.", suffix=ENDING, dir=parent))
        except OSError as error:
            raise OutputError(f"{target}: cannot be written ({error.strerror})") from error
        try:
            lock = _lock_in(place, target)
        except BaseException:
            _leave(place)
            raise
        if lock is not None:
            return place, lock


def _take(place: Path, target: Path) -> int:
    """Make a workspace, or take over an abandoned one; the descriptor that holds its lock."""
    while True:
        try:
            place.mkdir(mode=0o700)
        except FileExistsError:
            if place.is_symlink() or (not (place / LOCK).exists() and any(place.iterdir())):
                raise OutputError(
                    f"{place}: is in the way of writing {target.name}; move it away"
                ) from None
        except OSError as error:
            raise OutputError(f"{target}: cannot be written ({error.strerror})") from error
        lock = _lock_in(place, target)
        if lock is not None:
            return lock


def _leave(place: Path) -> None:
    """Go without a workspace that was made and is not held: a signal came between the two."""
    with contextlib.suppress(OSError):
        place.rmdir()
    sweep(place.parent)


def _lock_in(place: Path, target: Path) -> int | None:
    """The held lock of a workspace; None if another process swept it meanwhile.

    Raises:
        OutputError: another process holds it, or it cannot be written.
    """
    flags = os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC
    try:
        lock = os.open(place / LOCK, flags, 0o600)
    except FileNotFoundError:
        return None
    except OSError as error:
        raise OutputError(f"{target}: cannot be written ({error.strerror})") from error
    try:
        if not try_lock(lock):
            raise OutputError(
                f"{target}: another polemap is writing it now; wait for that, or choose another "
                "place"
            )
        if not still_there(place, lock):
            os.close(lock)
            return None
        if os.fstat(lock).st_size == 0:
            _sign(lock, target)
        _clear(place)
    except BaseException:
        os.close(lock)
        raise
    return lock


def _sign(lock: int, target: Path) -> None:
    """Mark a lock as ours: the first bytes of a result, which a full disk does not take.

    Raises:
        OutputError: they cannot be written.
    """
    try:
        os.write(lock, SIGNATURE)
    except OSError as error:
        raise OutputError(f"{target}: cannot be written ({error.strerror})") from error


def _clear(place: Path) -> None:
    """Empty a workspace but for its lock."""
    parent = place.parent
    empty(place, parent)
    for entry in list(os.scandir(place)):
        path = Path(entry.path)
        if entry.name == LOCK:
            continue
        if entry.is_dir(follow_symlinks=False):
            empty(path, parent)
            shutil.rmtree(path, ignore_errors=True)
        else:
            with contextlib.suppress(OSError):
                path.unlink()


def _give_back(place: Path, lock: int) -> None:
    """Remove a workspace and free its lock, in this order."""
    try:
        with contextlib.suppress(OSError):
            _clear(place)
            (place / LOCK).unlink()
            place.rmdir()
    finally:
        os.close(lock)
