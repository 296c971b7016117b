"""How a table is laid out in text: separator, decimal mark, header, units, comments.

What the text itself shows beyond doubt is taken and said in the summary; what it leaves open (is
1,234 more than a thousand?) is refused with the line that a mapping has to add.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from polemap.drivelog.errors import InputError
from polemap.drivelog.logs.format_part import FormatPart
from polemap.drivelog.logs.marks import cells_of, check_cells, find_marks, find_separator, is_number
from polemap.drivelog.logs.text import encoding_of, first_lines
from polemap.drivelog.logs.units import unit_named
from polemap.drivelog.problems import first_rows

NAMES = {",": "commas", ";": "semicolons", "\t": "tabs", "|": "bars", " ": "blanks"}
_SAMPLE_LINES = 400
_PREAMBLE_MOST = 50
_COMMENTS = ("#", "%", "//")
_EMPTY = frozenset({"", "nan", "null", "none", "n/a", "na", "-nan", "-nan(ind)", "inf", "-inf"})

Row = tuple[int, list[str]]
"""Number of a line, and its cells."""


@dataclass(frozen=True, slots=True)
class Layout:
    """How to read a log.

    Attributes:
        encoding: of the bytes.
        separator: one of `NAMES`; a blank stands for any run of blanks and tabs.
        decimal: `.` or `,`.
        thousands: mark between thousands, empty for none.
        columns: names of the header, empty where there is none.
        units: what a line of units says, empty where there is none.
        width: cells a row.
        first_line: number of the first line of data, from 1.
        comments: what a line begins with that is no data.
        skip_lines: numbers of lines that are no data.
        missing: cells that stand for no value, in lower case.
        drop_bad_lines: leave out lines of another width instead of refusing them.
        says: what was taken from the text, for the summary.
        rows: cells of the first lines of data.
    """

    encoding: str
    separator: str
    decimal: str
    thousands: str
    columns: tuple[str, ...]
    units: tuple[str, ...]
    width: int
    first_line: int
    comments: tuple[str, ...]
    skip_lines: frozenset[int]
    missing: frozenset[str]
    drop_bad_lines: bool
    says: str
    rows: tuple[tuple[str, ...], ...]


def find_layout(path: Path, given: FormatPart) -> Layout:
    """The layout of a log: what the mapping states, and what the text shows beyond doubt.

    Raises:
        InputError: no text, no table, or a layout that only the user knows; the message shows the
            first rows and the line to add to the mapping.
    """
    encoding = encoding_of(path, given.encoding)
    lines = first_lines(path, encoding, _SAMPLE_LINES)
    comments = (given.comment,) if given.comment else _COMMENTS
    first = given.header_number or 1
    usable = [
        (number, line)
        for number, line in enumerate(lines, start=1)
        if line.strip()
        and not line.lstrip().startswith(comments)
        and number not in given.skip_lines
        and number >= first
    ]
    if not usable:
        raise InputError(f"{path}: holds no rows; a log has a row a sample")
    check_cells(path, usable)
    separator = given.separator_mark() or find_separator(path, [line for _, line in usable])
    rows = [(n, cells_of(path, n, line, separator)) for n, line in usable]
    rows, width, preamble = _table(path, given, rows)
    # a header may hold commas in brackets and numbers; it does not tell the marks
    decimal, thousands = find_marks(path, given, separator, [cells for _, cells in rows[1:]])
    missing = _EMPTY | {text.strip().lower() for text in given.missing}
    says = [f"{encoding}, columns separated by {NAMES[separator]}"]
    says += ["decimal commas"] if decimal == "," else []
    columns: list[str] = []
    units: list[str] = []
    if _has_header(path, given, rows, decimal, missing):
        line, columns = rows.pop(0)
        says.append(f"header in line {line}")
    elif not given.no_header:
        columns = _commented_header(path, lines, comments, separator, width, rows)
        says.append("header in a comment" if columns else "no header: columns by number")
    if columns and rows and _is_units(path, given, rows, decimal, missing):
        line, units = rows.pop(0)
        says.append(f"units in line {line}")
    if preamble:
        says.append(f"{preamble} lines before the table left out")
    return Layout(
        encoding=encoding,
        separator=separator,
        decimal=decimal,
        thousands=thousands,
        columns=tuple(columns[:width]),
        units=tuple(units[:width]),
        width=width,
        first_line=rows[0][0] if rows else len(lines) + 1,
        comments=comments,
        skip_lines=frozenset(given.skip_lines),
        missing=missing,
        drop_bad_lines=given.bad_lines == "drop",
        says=", ".join(says),
        rows=tuple(tuple(cells) for _, cells in rows if len(cells) >= width)[:20],
    )


def _table(path: Path, given: FormatPart, rows: list[Row]) -> tuple[list[Row], int, int]:
    """Rows from the header on, their width, and the number of lines before the table.

    Raises:
        InputError: the names are more or fewer than the cells below them.
    """
    width = Counter(len(cells) for _, cells in rows).most_common(1)[0][0]
    body = [cells for _, cells in rows if len(cells) == width]
    if width > 1 and not any(cells[-1] for cells in body):
        width -= 1  # rows that end in a separator
        rows = [(n, c[:width] if len(c) == width + 1 else c) for n, c in rows]
    if given.header_number is not None:
        begin = 0
    else:
        begin = next(i for i, (_, cells) in enumerate(rows) if len(cells) == width)
        if begin and len(rows[begin - 1][1]) > 1 and _names(rows[begin - 1][1]):
            begin -= 1  # names above rows of another width: spoken of below
        elif 2 * sum(map(bool, rows[begin][1])) <= width:
            # lines of a preamble that a spreadsheet filled up with empty cells
            below = range(begin + 1, min(begin + _PREAMBLE_MOST, len(rows)))
            begin = next((i for i in below if _names(rows[i][1])), begin)
    line, cells = rows[begin]
    if len(cells) != width and (len(cells) < width or "".join(cells[width:])):
        shown = first_rows([",".join(c) for _, c in rows[begin:]])
        remedy = (
            "separate columns by a mark that is not in the numbers, or add to the mapping "
            f"`format: {{header_line: {line}}}`"
            if given.header_number is None
            else "name the line that has a name a column, or `header_line: none`"
        )
        raise InputError(
            f"{path}, line {line}: {len(cells)} names above rows of {width} cells; first rows "
            f"{shown}; {remedy}"
        )
    return rows[begin:], width, begin


def _names(cells: Sequence[str]) -> bool:
    return not any(is_number(cell) for cell in cells) and all(cells)


def _has_header(
    path: Path, given: FormatPart, rows: Sequence[Row], decimal: str, missing: frozenset[str]
) -> bool:
    """Whether the first row names the columns."""
    line, cells = rows[0]
    if given.no_header:
        return False
    if given.header_number is not None:
        if line != given.header_number:
            raise InputError(
                f"{path}: format: header_line is {given.header_number}, which is empty or a "
                f"comment; the next row stands in line {line}"
            )
        return True
    numbers = [is_number(cell, decimal) for cell in cells]
    if not any(numbers):
        return True
    values = [cell.lower() not in missing for cell in cells]
    if len(rows) == 1 or all(n or not v for n, v in zip(numbers, values, strict=True)):
        return False
    # the same columns hold numbers in the row below: both are values
    if numbers == [is_number(cell, decimal) for cell in rows[1][1]]:
        return False
    raise InputError(
        f"{path}: are the cells of line {line} names or values? first rows "
        f"{first_rows([','.join(c) for _, c in rows])}; add to the mapping "
        f"`format: {{header_line: {line}}}` or `format: {{header_line: none}}`"
    )


def _commented_header(
    path: Path,
    lines: Sequence[str],
    comments: tuple[str, ...],
    separator: str,
    width: int,
    rows: list[Row],
) -> list[str]:
    """Names in the comment just above the first row, as numpy.savetxt writes them."""
    above = rows[0][0] - 2
    if above < 0 or not lines[above].lstrip().startswith(comments):
        return []
    text = lines[above].strip()
    mark = next(mark for mark in comments if text.startswith(mark))
    cells = cells_of(path, above + 1, text[len(mark) :].strip(), separator)
    return cells if len(cells) == width and _names(cells) else []


def _is_units(
    path: Path, given: FormatPart, rows: Sequence[Row], decimal: str, missing: frozenset[str]
) -> bool:
    """Whether the row below the header holds units."""
    line, cells = rows[0]
    if given.units_line is not None:
        if line != given.units_line:
            raise InputError(
                f"{path}: format: units_line is {given.units_line}, the row below the header "
                f"stands in line {line}"
            )
        return True
    words = [cell for cell in cells if cell.lower() not in missing and cell not in ("-", "[-]")]
    if not words or any(is_number(cell, decimal) for cell in words):
        return False
    if 2 * sum(unit_named(cell) is not None for cell in words) >= len(words):
        return True
    below = rows[1][1] if len(rows) > 1 else []
    # text above numbers in most columns is no row of values
    if 2 * sum(is_number(cell, decimal) for cell in below) > len(below):
        raise InputError(
            f"{path}: line {line} below the header holds neither numbers nor units that are known; "
            f"first rows {first_rows([','.join(cells)])}; add to the mapping `format: "
            f"{{units_line: {line}}}` or `format: {{skip_lines: [{line}]}}`"
        )
    return False
