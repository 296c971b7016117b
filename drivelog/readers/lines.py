"""lines.csv: straight pieces of markings, kerbs and facades that were detected elsewhere."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.detections import NOTHING_IN_VIEW, Detections, pole_detections
from polemap.drivelog.errors import InputError
from polemap.drivelog.findings import Finding
from polemap.drivelog.landmark_kind import LINE_KINDS, LandmarkKind, LineStyle
from polemap.drivelog.line_detections import LineDetections
from polemap.drivelog.readers.columns import FILES
from polemap.drivelog.readers.crowd import check_crowd
from polemap.drivelog.readers.given import is_given, row_findings
from polemap.drivelog.stamps import in_order
from polemap.drivelog.tables import Table, read_table

Floats = NDArray[np.float64]

_TEXTS = ("kind", "style")
# with fewer of its stamps among the scans, lines come from a detector that looked by itself
_SAME_DETECTOR = 0.5


def add_lines(
    folder: Path,
    scans: tuple[Detections, ...],
    problems: Counter[str],
    findings: list[Finding],
) -> tuple[Detections, ...]:
    """The scans with the lines of the same stamps, where the folder has lines.csv.

    Lines of a stamp without a scan become one in which no pole could have been seen. Where most
    stamps of lines are those of scans, a scan without lines is one that saw none.

    Raises:
        InputError: see `drivelog.tables`.
    """
    path = folder / "lines.csv"
    if not is_given(path):
        return scans
    table = _read_lines(path, problems, findings)
    pieces = _pieces(table)
    stamps, arrival = table["stamp_s"], _arrivals(table)
    of_scans = np.array([scan.stamp_s for scan in scans])
    own = np.unique(stamps)
    same = bool(np.isin(own, of_scans).mean() >= _SAME_DETECTOR) if len(own) else bool(len(scans))
    merged = {scan.stamp_s: scan for scan in scans}
    if same:
        merged = {t: replace(scan, lines=LineDetections.none()) for t, scan in merged.items()}
    first = np.searchsorted(stamps, own, side="left")
    last = np.searchsorted(stamps, own, side="right")
    for stamp, a, b in zip(own.tolist(), first, last, strict=True):
        scan = merged.get(stamp) or _without_poles(stamp)
        late = max(scan.arrival_s, float(arrival[a:b].max()))
        merged[stamp] = replace(scan, lines=pieces.take(slice(int(a), int(b))), arrival_s=late)
    return tuple(merged[stamp] for stamp in sorted(merged))


def _without_poles(stamp_s: float) -> Detections:
    return pole_detections(
        stamp_s, stamp_s, np.empty((0, 2)), np.empty((0, 2, 2)), view=NOTHING_IN_VIEW
    )


def _read_lines(path: Path, problems: Counter[str], findings: list[Finding]) -> Table:
    numbers = [name for name in FILES["lines"].required if name not in _TEXTS]
    table = read_table(
        path, numbers, optional=("arrival_s", "probability"), texts=("kind",),
        optional_texts=("style",),
    )  # fmt: skip
    table = in_order(table, findings, duplicates="allow")
    check_crowd(table, "lines", "keep the longest")
    if "arrival_s" in table and (early := table["arrival_s"] < table["stamp_s"]).any():
        problems["lines_arrival_before_stamp"] += int(np.count_nonzero(early))
    positive = (table["offset_sd_m"] > 0) & (table["direction_sd_rad"] > 0)
    table = table.keep(positive, "sd_not_positive")
    length = np.hypot(table["x1_m"] - table["x0_m"], table["y1_m"] - table["y0_m"])
    table = table.keep(length > 1e-3, "ends_in_one_point")
    findings += row_findings(table)
    for reason, count in table.dropped.items():
        problems[f"lines_{reason}"] += count
    return table


def _pieces(table: Table) -> LineDetections:
    n = len(table)
    style = np.full(n, LineStyle.UNKNOWN, dtype=np.int8)
    if "style" in table.texts:
        names = {style.name.lower(): int(style) for style in LineStyle}
        style = named_values(table, "style", names, empty=LineStyle.UNKNOWN)
    probability = table["probability"] if "probability" in table else np.ones(n)
    return LineDetections(
        kind=named_values(table, "kind", kind_names(LINE_KINDS)),
        style=style,
        start_vehicle_m=np.stack([table["x0_m"], table["y0_m"]], axis=1),
        end_vehicle_m=np.stack([table["x1_m"], table["y1_m"]], axis=1),
        offset_sd_m=table["offset_sd_m"],
        direction_sd_rad=table["direction_sd_rad"],
        probability=np.where(np.isfinite(probability), probability, 1.0),
    )


def _arrivals(table: Table) -> Floats:
    if "arrival_s" not in table:
        return table["stamp_s"]
    return np.fmax(table["arrival_s"], table["stamp_s"])


def kind_names(kinds: frozenset[LandmarkKind]) -> dict[str, int]:
    """How files name kinds of landmarks."""
    return {kind.name.lower(): int(kind) for kind in sorted(kinds)}


def named_values(
    table: Table, column: str, names: dict[str, int], empty: int | None = None
) -> NDArray[np.int8]:
    """Values `(n,)` of a text column that names them; `empty` is that of an empty cell.

    Raises:
        InputError: the first cell that is none of the names.
    """
    texts = table.texts[column]
    values = np.zeros(len(texts), dtype=np.int8)
    known = names if empty is None else {"": empty, **names}
    for text in np.unique(texts.astype(str)):
        rows = texts == text
        value = known.get(text.strip().lower())
        if value is None:
            line = table.lines[int(np.flatnonzero(rows)[0])]
            raise InputError(
                f"{table.path}, line {line}: {column} is '{text[:40]}'; write one of "
                f"{', '.join(names)}"
            )
        values[rows] = value
    return values
