"""Tables: written once as text cells, shown as HTML, CSV and LaTeX."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Sequence
from dataclasses import dataclass

_LATEX = {
    "\\": r"\textbackslash{}",
    "&": r"\&",
    "%": r"\%",
    "$": r"\$",
    "#": r"\#",
    "_": r"\_",
    "{": r"\{",
    "}": r"\}",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    "±": r"$\pm$",
    "–": "--",
    "−": "$-$",
    "·": r"$\cdot$",
    "σ": r"$\sigma$",
    "²": r"$^2$",
    "°": r"$^\circ$",
}


@dataclass(frozen=True, slots=True)
class Table:
    """A table of text; the first `text_columns` columns are words, the rest numbers."""

    key: str
    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    note: str = ""
    text_columns: int = 1

    def __post_init__(self) -> None:
        for row in self.rows:
            if len(row) != len(self.columns):
                raise ValueError(f"table {self.key}: row {row} has not {len(self.columns)} cells")


def number(value: float | None, digits: int = 3, unit: str = "") -> str:
    """A figure, or a dash where there is none."""
    if value is None or not math.isfinite(value):
        return "–"
    return f"{value:.{digits}f}{' ' + unit if unit else ''}"


def with_spread(mean: float, spread: float, digits: int = 3) -> str:
    """`mean ± spread`, the latter where there is one."""
    if not math.isfinite(spread):
        return number(mean, digits)
    return f"{number(mean, digits)} ± {number(spread, digits)}"


def span(low: float, high: float, digits: int = 3) -> str:
    """`low – high` of an interval."""
    if not (math.isfinite(low) and math.isfinite(high)):
        return "–"
    return f"{number(low, digits)} – {number(high, digits)}"


def csv_text(table: Table) -> str:
    """The table as CSV; a cell that a spreadsheet would take for a formula gets a quote mark."""
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(table.columns)
    for row in table.rows:
        writer.writerow([_no_formula(cell) for cell in row])
    return stream.getvalue()


def latex_text(tables: Sequence[Table]) -> str:
    """The tables as LaTeX floats for the booktabs package."""
    parts = ["% Made by polemap report; needs \\usepackage{booktabs}\n"]
    for table in tables:
        if not table.rows:
            continue
        columns = "l" * table.text_columns + "r" * (len(table.columns) - table.text_columns)
        body = [" & ".join(escape_latex(cell) for cell in row) + r" \\" for row in table.rows]
        parts.append(
            "\n".join(
                [
                    r"\begin{table}",
                    r"  \centering",
                    rf"  \caption{{{escape_latex(table.title)}}}",
                    rf"  \label{{tab:{''.join(c for c in table.key if c.isalnum() or c in '-:')}}}",
                    rf"  \begin{{tabular}}{{{columns}}}",
                    r"    \toprule",
                    "    " + " & ".join(escape_latex(name) for name in table.columns) + r" \\",
                    r"    \midrule",
                    *("    " + line for line in body),
                    r"    \bottomrule",
                    r"  \end{tabular}",
                    r"\end{table}",
                    "",
                ]
            )
        )
    return "\n".join(parts)


def escape_latex(text: str) -> str:
    """Text with every character that LaTeX would act on made harmless."""
    return "".join(_LATEX.get(letter, letter) for letter in text)


def _no_formula(cell: str) -> str:
    is_number = cell[1:2].isdigit() or cell[1:2] == "."
    return (
        f"'{cell}"
        if cell[:1] in ("=", "+", "@", "\t", "\r") or (cell[:1] == "-" and not is_number)
        else cell
    )
