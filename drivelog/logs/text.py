"""Lines of a logger's text file, whatever its encoding."""

from __future__ import annotations

import codecs
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

from polemap.drivelog.errors import InputError
from polemap.parsing.csv_text import LARGEST_BYTES, LONGEST_LINE_BYTES
from polemap.parsing.errors import ParsingError, named
from polemap.parsing.text import check_size

_MARKS = (
    (codecs.BOM_UTF8, "utf-8-sig"),
    (codecs.BOM_UTF16_LE, "utf-16"),
    (codecs.BOM_UTF16_BE, "utf-16"),
)
_HEAD_BYTES = 65_536


def encoding_of(path: Path, stated: str | None = None) -> str:
    """The encoding of a text file: as stated, else by its byte-order mark, else UTF-8.

    Raises:
        InputError: no text, or text in an encoding that nothing tells.
    """
    if stated is not None:
        try:
            return codecs.lookup(stated).name
        except LookupError:
            raise InputError(
                f"{path}: encoding '{stated[:30]}' is unknown; known are utf-8, utf-16, latin-1"
            ) from None
    with named(path, InputError, "log"):
        check_size(path, LARGEST_BYTES)
        with path.open("rb") as file:
            head = file.read(_HEAD_BYTES)
    if not head:
        raise InputError(f"{path}: empty file; a log has a row a sample")
    for mark, name in _MARKS:
        if head.startswith(mark):
            return name
    if b"\0" in head:
        odd, even = (part.count(0) / max(len(part), 1) for part in (head[1::2], head[::2]))
        # without its mark: every second byte of western text is zero
        if max(odd, even) > 0.4 and min(odd, even) < 0.05:
            return "utf-16-le" if odd > even else "utf-16-be"
        raise InputError(f"{path}: holds NUL bytes and is no text; give a CSV, NMEA or GPX log")
    return "utf-8"


@contextmanager
def open_text(path: Path, encoding: str) -> Iterator[IO[str]]:
    """The file as text, line ends kept for the CSV module.

    Raises:
        InputError: it cannot be opened or decoded.
    """
    with named(path, InputError, "log"):
        try:
            with path.open(encoding=encoding, newline="") as file:
                yield file
        except UnicodeDecodeError as error:
            wrong = error.object[error.start : error.start + 1].hex()
            raise InputError(
                f"{path}: holds byte 0x{wrong}, which is not {encoding}; add to the mapping "
                "`format: {encoding: latin-1}` (western Windows) or the encoding of the logger"
            ) from error


def lines_of(file: IO[str]) -> Iterator[str]:
    """Lines with their ends.

    Raises:
        ParsingError: a line beyond the limit, or one with a NUL.
    """
    number = 0
    while line := file.readline(LONGEST_LINE_BYTES + 1):
        number += 1
        if len(line) > LONGEST_LINE_BYTES:
            raise ParsingError(f"line {number}: longer than {LONGEST_LINE_BYTES} characters")
        if "\0" in line:
            raise ParsingError(f"line {number}: holds a NUL character; restore the log")
        yield line


def first_lines(path: Path, encoding: str, count: int) -> list[str]:
    """The first lines of a log, without their ends.

    Raises:
        InputError: as `open_text`.
    """
    found: list[str] = []
    with open_text(path, encoding) as file:
        for line in lines_of(file):
            found.append(line.rstrip("\r\n"))
            if len(found) == count:
                break
    return found
