"""`polemap view`: a run in the viewer, or as the recording that viewers open."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Annotated

import typer

from polemap.tools.option_types import WorkersOption
from polemap.tools.recording.record import record_run


def command(
    run_folder: Annotated[Path, typer.Argument(metavar="RUN", help="Run folder of localize.")],
    out: Annotated[
        Path | None,
        typer.Option("--out", help="Write X.rrd (rerun) or X.mcap (Foxglove), open nothing."),
    ] = None,
    drive: Annotated[
        Path | None, typer.Option("--drive", help="The drive, for its pictures and seen poles.")
    ] = None,
    map_file: Annotated[
        Path | None, typer.Option("--map", help="The map, where it is not where it was.")
    ] = None,
    run: Annotated[
        int, typer.Option("--run", min=0, help="Which run of a folder with several.")
    ] = 0,
    cache: Annotated[
        Path | None, typer.Option("--cache", help="Detections kept by localize --cache.")
    ] = None,
    workers: WorkersOption = None,
) -> None:
    """Show a run: car, paths, poles, pictures and health over time.

    Examples:
        polemap view runs/lap_2
        polemap view runs/lap_2 --drive drives/monday
        polemap view runs/lap_2 --drive drives/monday --out lap_2.mcap
        polemap view runs/lap_2 --out lap_2.rrd

    Opens rerun's viewer; on a computer without a display it writes RUN.rrd to the working folder.
    With --drive the left pictures are shown with the mapped poles (orange) and the poles that were
    seen (green). Beside X.mcap goes X.layout.json, which arranges Foxglove's panels.
    """
    if out is None and not has_display():
        out = Path(f"{Path(os.path.realpath(run_folder)).name}.rrd")
        typer.echo(f"no display on this computer: writing {out} instead of opening the viewer")
    inputs = (run_folder, drive, map_file, cache)
    for line in record_run(run_folder, out, drive, map_file, run, cache, inputs, workers):
        typer.echo(line)


def has_display() -> bool:
    """Whether a window can be opened here."""
    if sys.platform in ("win32", "darwin"):
        return True
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
