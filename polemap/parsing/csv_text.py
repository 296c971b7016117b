"""What every CSV file must keep to before a library makes a table of it."""

from __future__ import annotations

import csv
import gzip
import zlib
from pathlib import Path
from typing import IO

from polemap.parsing.errors import ParsingError, short
from polemap.parsing.text import MEGABYTE, check_size

LONGEST_LINE_BYTES = MEGABYTE
MOST_COLUMNS = 1000
LONGEST_CELL = 10_000
LARGEST_BYTES = 20_000 * MEGABYTE
# of a table that is packed (.gz)
SMALL_BYTES = 256 * MEGABYTE
LARGEST_RATIO = 100


def check_csv(path: Path) -> None:
    """Look through a CSV file without making a table of it.

    Raises:
        ParsingError: a line, a cell or a number of columns beyond its limit, a NUL, or a damaged
            archive.
        OSError: it cannot be read.
    """
    check_size(path, LARGEST_BYTES)
    if Path(path).suffix != ".gz":
        with Path(path).open("rb") as file:
            _check_lines(file, LARGEST_BYTES)
        return
    try:
        with gzip.open(path) as unpacked:
            _check_lines(unpacked, SMALL_BYTES + LARGEST_RATIO * Path(path).stat().st_size)
    except (zlib.error, EOFError, gzip.BadGzipFile) as error:
        raise ParsingError(f"a damaged archive ({short(error)})") from error


def _check_lines(file: IO[bytes] | gzip.GzipFile, most_bytes: int) -> None:
    number, size = 0, 0
    while line := file.readline(LONGEST_LINE_BYTES + 1):
        number, size = number + 1, size + len(line)
        if size > most_bytes:
            raise ParsingError(f"line {number}: more than {most_bytes} bytes when unpacked")
        if len(line) > LONGEST_LINE_BYTES:
            raise ParsingError(f"line {number}: longer than {LONGEST_LINE_BYTES} bytes")
        if number == 1 and line.count(b",") >= MOST_COLUMNS:
            raise ParsingError(f"{line.count(b',') + 1} columns, a table may have {MOST_COLUMNS}")
        if b"\0" in line:
            raise ParsingError(f"not a UTF-8 CSV file (line {number} holds a NUL byte)")
        if len(line) > LONGEST_CELL and max(map(len, line.split(b","))) > LONGEST_CELL:
            raise ParsingError(f"line {number}: a cell of more than {LONGEST_CELL} bytes")


def read_rows(path: Path) -> list[list[str]]:
    """All rows of a CSV file as texts, the header first.

    Raises:
        ParsingError: no UTF-8, no CSV, or beyond a limit.
        OSError: it cannot be read.
    """
    check_csv(path)
    try:
        with Path(path).open(encoding="utf-8-sig", newline="") as stream:
            csv.field_size_limit(LONGEST_CELL)
            return list(csv.reader(stream))
    except UnicodeDecodeError as error:
        raise ParsingError("not a UTF-8 CSV file; save it as UTF-8") from error
    except csv.Error as error:
        raise ParsingError(f"no CSV ({short(error)})") from error
