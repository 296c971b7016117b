"""Files as text or bytes, up to a size."""

from __future__ import annotations

import stat
from importlib.resources import files
from pathlib import Path

from polemap.parsing.errors import ParsingError

MEGABYTE = 1_000_000


def check_size(path: Path, largest_bytes: int) -> None:
    """Look at a file before it is opened: a pipe would never end.

    Raises:
        ParsingError: larger than `largest_bytes`, or no regular file.
        OSError: it cannot be looked at.
    """
    state = Path(path).stat()
    if not stat.S_ISREG(state.st_mode):
        raise ParsingError("is no regular file")
    if state.st_size > largest_bytes:
        raise ParsingError(
            f"{state.st_size} bytes are more than the {largest_bytes} that such a file may have"
        )


def read_bytes(path: Path, largest_bytes: int) -> bytes:
    """All bytes of a file.

    Raises:
        ParsingError: larger than `largest_bytes`, or no regular file (a pipe would never end).
        OSError: it cannot be read.
    """
    check_size(path, largest_bytes)
    return Path(path).read_bytes()


def read_text(path: Path, largest_bytes: int) -> str:
    """All text of a UTF-8 file, a byte-order mark left out.

    Raises:
        ParsingError: larger than `largest_bytes`, no UTF-8, or no regular file.
        OSError: it cannot be read.
    """
    return decoded(read_bytes(path, largest_bytes))


def decoded(data: bytes) -> str:
    """UTF-8 bytes as text.

    Raises:
        ParsingError: they are not UTF-8.
    """
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise ParsingError(f"is not UTF-8 text (byte {error.start}); save it as UTF-8") from error


def packaged_files(package: str, folder: str) -> list[str]:
    """Names of the files that come with a package in one of its folders, sorted."""
    return sorted(file.name for file in (files(package) / folder).iterdir() if file.is_file())
