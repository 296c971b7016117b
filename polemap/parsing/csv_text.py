"""What every CSV file must keep to before a library makes a table of it."""

from __future__ import annotations

import csv
from pathlib import Path

from polemap.parsing.errors import ParsingError, short
from polemap.parsing.text import MEGABYTE, check_size

LONGEST_LINE_BYTES = MEGABYTE
MOST_COLUMNS = 1000
LONGEST_CELL = 10_000
LARGEST_BYTES = 20_000 * MEGABYTE


def check_csv(path: Path) -> None:
    """Look through a CSV file without making a table of it.

    Raises:
        ParsingError: a line, a cell or a number of columns beyond its limit, or a NUL.
        OSError: it cannot be read.
    """
    check_size(path, LARGEST_BYTES)
    with Path(path).open("rb") as file:
        number = 0
        while line := file.readline(LONGEST_LINE_BYTES + 1):
            number += 1
            if len(line) > LONGEST_LINE_BYTES:
                raise ParsingError(f"line {number}: longer than {LONGEST_LINE_BYTES} bytes")
            if number == 1 and line.count(b",") >= MOST_COLUMNS:
                raise ParsingError(
                    f"{line.count(b',') + 1} columns, a table may have {MOST_COLUMNS}"
                )
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
            return list(csv.reader(stream))
    except UnicodeDecodeError as error:
        raise ParsingError("not a UTF-8 CSV file; save it as UTF-8") from error
    except csv.Error as error:
        raise ParsingError(f"no CSV ({short(error)})") from error
