"""An old folder out, a new one in: at every instant one of the two is whole under the name.

Where the system can swap two names in one call (Linux `renameat2`), it does. Elsewhere two renames
stand behind a journal: whoever finds it later finishes what a killed process began.
"""

from __future__ import annotations

import contextlib
import ctypes
import errno
import os
import sys
from collections.abc import Callable
from pathlib import Path

READY = "ready"
REPLACED = "replaced"
JOURNAL = "journal"

_AT_FDCWD = -100
_RENAME_EXCHANGE = 2
# the kernel, the C library or this file system does not know the call
_UNKNOWN_CALL = (errno.ENOSYS, errno.EINVAL, errno.ENOTSUP, errno.EPERM, errno.EXDEV)


def _find_swap() -> Callable[[bytes, bytes], int] | None:
    """The system's call that swaps two names, giving 0 or an error number."""
    if not sys.platform.startswith("linux"):
        return None
    try:
        call = ctypes.CDLL(None, use_errno=True).renameat2
    except (OSError, AttributeError):
        return None
    call.argtypes = [ctypes.c_int, ctypes.c_char_p, ctypes.c_int, ctypes.c_char_p, ctypes.c_uint]

    def swap(first: bytes, second: bytes) -> int:
        done = call(_AT_FDCWD, first, _AT_FDCWD, second, _RENAME_EXCHANGE)
        return 0 if done == 0 else ctypes.get_errno()

    return swap


_swap = _find_swap()


def put_in_place(ready: Path, target: Path) -> None:
    """Make the folder `ready` stand at `target`; a folder that stood there is then beside it.

    Args:
        ready: `PLACE/ready`; the old folder becomes `PLACE/replaced`.
        target: an empty name or a folder.

    Raises:
        OSError: the system refuses; then the old folder stands as before.
    """
    place = ready.parent
    replaced = place / REPLACED
    if not os.path.lexists(target):
        os.rename(ready, target)
        return
    if _swap is not None:
        # under this name a cleaner deletes what the marker lists, and nothing else
        os.rename(ready, replaced)
        number = _swap(os.fsencode(replaced), os.fsencode(target))
        if number == 0:
            return
        os.rename(replaced, ready)
        if number not in _UNKNOWN_CALL:
            raise OSError(number, os.strerror(number), str(target))
    draft = place / f"{JOURNAL}.draft"
    draft.write_bytes(os.fsencode(target.name))
    os.rename(draft, place / JOURNAL)
    try:
        os.rename(target, replaced)
        os.rename(ready, target)
    finally:
        finish_exchange(place, target.parent)


def finish_exchange(place: Path, parent: Path) -> None:
    """Finish what stands in the journal of `place`, if anything does: the new folder goes in."""
    journal = place / JOURNAL
    try:
        target = parent / os.fsdecode(journal.read_bytes())
    except OSError:
        return
    for name in (READY, REPLACED):
        if not os.path.lexists(target) and (place / name).is_dir():
            os.rename(place / name, target)
    with contextlib.suppress(OSError):
        journal.unlink()
