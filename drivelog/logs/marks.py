"""Marks between columns and within numbers: taken where beyond doubt, else asked for."""

from __future__ import annotations

import csv
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

from polemap.drivelog.errors import InputError
from polemap.drivelog.logs.format_part import FormatPart
from polemap.drivelog.problems import first_rows
from polemap.parsing.csv_text import LONGEST_CELL
from polemap.parsing.errors import short

_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?")
_DECIMAL_COMMA = re.compile(r"[+-]?\d+,\d+([eE][+-]?\d+)?")
# 1,234 and 12,345,678; 0,123 and 1234,567 are no thousands
_THOUSANDS = re.compile(r"[+-]?[1-9]\d{0,2}(,\d{3})+")
_ANY_MARK = re.compile(r"[;\t|, ]")
_BOTH = re.compile(r"[+-]?\d{1,3}([.,' ]\d{3})+[.,]\d+")


def is_number(cell: str, decimal: str = ".") -> bool:
    """Whether a cell is a number, with that decimal mark."""
    return bool(_NUMBER.fullmatch(cell.strip().replace(decimal, ".")))


def split(lines: Iterable[str], separator: str) -> Iterator[list[str]]:
    """Cells of lines; quoted cells may hold the separator."""
    if separator == " ":
        return (line.split() for line in lines)
    # a limit of the whole module: Python's own holds until somebody sets it
    csv.field_size_limit(LONGEST_CELL)
    return csv.reader(lines, delimiter=separator, skipinitialspace=True)


def cells_of(path: Path, number: int, line: str, separator: str) -> list[str]:
    """Cells of one line, without the blanks around them.

    Raises:
        InputError: a cell beyond its limit.
    """
    try:
        return [cell.strip() for cell in next(split([line], separator), [])]
    except csv.Error as error:
        raise InputError(
            f"{path}, line {number}: no cells ({short(error)}); a quote that is never closed?"
        ) from error


def check_cells(path: Path, lines: Iterable[tuple[int, str]]) -> None:
    """Refuse numbered lines in which no mark parts what is longer than a cell may be.

    Raises:
        InputError: the first such line.
    """
    for number, line in lines:
        if len(line) > LONGEST_CELL and max(map(len, _ANY_MARK.split(line))) > LONGEST_CELL:
            raise InputError(
                f"{path}, line {number}: a cell of more than {LONGEST_CELL} characters; restore "
                "the log, or leave the column out"
            )


def find_separator(path: Path, lines: Sequence[str]) -> str:
    """The only mark that parts all lines (but for a preamble) into the same number of cells."""
    fitting, failed = {}, ""
    for mark in (";", "\t", "|", ",", " "):
        try:
            rows = [row for row in split(lines, mark) if row]
        except csv.Error as error:
            failed = failed or short(error)
            continue
        width, count = Counter(map(len, rows)).most_common(1)[0]
        if width < 2 or count < 0.6 * len(rows):
            continue
        others = {m for m in (";", "\t", "|") if m != mark}
        body = [row for row in rows if len(row) == width]
        if mark != " " and any(other in cell for row in body for cell in row for other in others):
            continue
        fitting[mark] = body
    # blanks stand inside of names and dates, commas inside of numbers
    strong = [mark for mark in (";", "\t", "|") if mark in fitting]
    if len(strong) == 1:
        return strong[0]
    if not strong and "," in fitting:
        if " " in fitting and _only_numbers(fitting[" "]):
            raise InputError(
                f"{path}: blanks or commas between the columns? first rows "
                f"{first_rows(lines)}; add to the mapping `format: {{separator: blanks, decimal: "
                "','}` or `format: {separator: ','}`"
            )
        return ","
    if not strong and " " in fitting:
        return " "
    if not failed and not fitting and all("," not in line and ";" not in line for line in lines):
        return ","  # one column
    if failed:
        raise InputError(f"{path}: no cells ({failed}); a quote that is never closed?")
    odd = any(line.count('"') % 2 for line in lines)
    quote = " (a quote is never closed)" if odd else ""
    raise InputError(
        f"{path}: what separates the columns cannot be told{quote}; first rows "
        f"{first_rows(lines)}; add to the mapping `format: {{separator: ','}}` "
        "(or ';', tab, '|', blanks), and `decimal: ','` where numbers have commas"
    )


def _only_numbers(rows: Sequence[Sequence[str]]) -> bool:
    return all(
        is_number(cell) or _DECIMAL_COMMA.fullmatch(cell) for row in rows[1:] for cell in row
    )


def find_marks(
    path: Path, given: FormatPart, separator: str, rows: Sequence[Sequence[str]]
) -> tuple[str, str]:
    """Decimal mark and thousands mark."""
    thousands = given.thousands or ""
    if given.decimal is not None:
        return given.decimal, thousands
    with_comma = [c for row in rows for c in row if "," in c and _DECIMAL_COMMA.fullmatch(c)]
    doubtful = [c for row in rows for c in row if _THOUSANDS.fullmatch(c)]
    shown = first_rows([separator.join(row) for row in rows])
    both = next((c for row in rows for c in row if _BOTH.fullmatch(c)), None)
    if both and not thousands:
        marks = sorted({m for m in both if m in ".,' "}, key=both.rindex)
        if len(marks) == 2:
            raise InputError(
                f"{path}: {both} has two marks; first rows {shown}; add to the mapping "
                f"`format: {{decimal: '{marks[1]}', thousands: '{marks[0]}'}}`"
            )
    if not with_comma and not doubtful:
        return ".", thousands
    points = any("." in cell and is_number(cell) for row in rows for cell in row)
    if thousands == ",":
        return ".", ","
    if set(with_comma) <= set(doubtful) or points:
        cell = doubtful[0] if doubtful else with_comma[0]
        raise InputError(
            f"{path}: is {cell} {cell.replace(',', '.', 1)} or {cell.replace(',', '')}? first rows "
            f"{shown}; add to the mapping `format: {{decimal: ','}}` or `format: {{decimal: '.', "
            "thousands: ','}`"
        )
    return ",", thousands
