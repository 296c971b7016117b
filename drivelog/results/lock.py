"""The lock of a workspace: held as long as its process lives, on whatever machine that is."""

from __future__ import annotations

import errno
import os
import stat
from pathlib import Path

try:
    import fcntl
except ImportError:  # no such locks on this system: nothing is swept there, only written
    fcntl = None  # type: ignore[assignment]

CAN_LOCK = fcntl is not None
LOCK = "lock"
"""Name of the file in the workspace."""
SIGNATURE = b"a workspace of polemap\n"
_BUSY = (errno.EWOULDBLOCK, errno.EACCES, errno.EAGAIN)


def try_lock(lock: int) -> bool:
    """Take the lock of an open file, or say that another process has it."""
    if fcntl is None:
        return True
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        # a file system without locks lets everybody in
        return error.errno not in _BUSY and error.errno != errno.EINTR
    return True


def still_there(place: Path, lock: int) -> bool:
    """Whether the lock is still that of the workspace: another process may have swept it."""
    try:
        there = (place / LOCK).stat()
    except OSError:
        return False
    own = os.fstat(lock)
    return (there.st_dev, there.st_ino) == (own.st_dev, own.st_ino)


def is_ours(place: Path, lock: int) -> bool:
    """Whether polemap made the workspace."""
    state = os.fstat(lock)
    if not stat.S_ISREG(state.st_mode) or state.st_size > len(SIGNATURE):
        return False
    if state.st_size == 0:
        # a process that was killed before its first write left an empty lock and nothing else
        return [entry.name for entry in os.scandir(place)] == [LOCK]
    return os.pread(lock, len(SIGNATURE), 0) == SIGNATURE
