"""`polemap map --diff` and `--convert`: maps against maps and into other formats."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import typer

from polemap.build.map_diff import CHANGE, DISTANCE, compare_maps, diff_map
from polemap.drivelog.errors import InputError
from polemap.drivelog.landmark_kind import kind_name
from polemap.drivelog.readers.registry import open_drive
from polemap.map.io import check_writable, export_map, read_map, write_map


def compare(maps: list[Path], out: Path | None, align: bool) -> None:
    if len(maps) != 2:
        raise InputError(f"--diff compares two maps, {len(maps)} are given: --diff OLD NEW")
    if out is not None:
        check_writable(out)
    before = read_map(maps[0], allow_empty=True)
    after = read_map(maps[1], before.frame, allow_empty=True)
    found = compare_maps(before, after, align=align)
    changes = diff_map(before, after, found)
    if found.shift.significant:
        east, north = found.shift.move_m
        remedy = "it was taken away" if align else "--align would take it away"
        typer.echo(
            f"note: {maps[1]} is off by {-east:+.2f} m east, {-north:+.2f} m north; {remedy}"
        )
    if out is not None:
        write_map(changes, out)
    typer.echo(
        f"{len(found.added)} added, {len(found.removed)} removed, {len(found.moved)} moved, "
        f"{len(found.same)} as before"
    )
    for row in range(len(changes)):
        east, north = changes.points_m[row]
        distance = changes.extra[DISTANCE][row]
        far = f" by {distance:.2f} m" if np.isfinite(distance) else ""
        change = changes.extra[CHANGE][row]
        name = kind_name(changes.kind[row])
        typer.echo(f"{change:<8} {name} {changes.ids[row]} at {east:.2f}, {north:.2f}{far}")
    if before.lines is not None or after.lines is not None:
        typer.echo(
            f"lines: {len(found.lines_added)} added, {len(found.lines_removed)} removed, "
            f"{found.lines_same} as before"
        )
    for lines, rows, change in (
        (before.lines, found.lines_removed, "removed"), (after.lines, found.lines_added, "added"),
    ):  # fmt: skip
        if lines is None:
            continue
        for row in rows.tolist():
            east, north = lines.polyline_m(row)[0]
            name = kind_name(lines.kind[row])
            typer.echo(f"{change:<8} {name} {lines.ids[row]} from {east:.2f}, {north:.2f}")


def convert_map(
    source: Path, drives: list[Path], out: Path | None, seed: int, topics: Path | None
) -> None:
    if out is None:
        raise InputError("--out is missing: its ending chooses the format to convert to")
    frame = open_drive(drives[0], seed=seed, topics=topics).frame if drives else None
    pole_map = read_map(source, frame)
    export_map(pole_map, out)
    for note in pole_map.notes:
        typer.echo(f"note: {note}")
    typer.echo(f"{out}: {pole_map.described} in {pole_map.frame}")
