"""Command-line options that several verbs share, declared once; `set_option.py` reads `--set`."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from polemap.drivelog.errors import ConfigError
from polemap.extras import MissingExtraError, check_installed

ConfigOption = Annotated[
    Path | None,
    typer.Option("--config", help="YAML that overrides defaults, or papers/s16.yaml."),
]
SetOption = Annotated[
    list[str] | None,
    typer.Option("--set", help="Override one default, such as localize.particles=500."),
]
SeedOption = Annotated[
    int, typer.Option("--seed", min=0, help="Makes the run repeatable bit for bit.")
]
OdometryOption = Annotated[
    str,
    typer.Option(
        "--odometry",
        help="auto, wheels, camera, both; derived for KITTI odometry. auto: wheels, else camera.",
    ),
]
ForceOption = Annotated[
    bool, typer.Option("--force", help="Go on with inputs that cannot be right.")
]
TopicsOption = Annotated[
    Path | None,
    typer.Option("--topics", help="Mapping of a log's topics (info --write-mapping writes one)."),
]
PageOption = Annotated[
    bool, typer.Option("--page/--no-page", help="Write a page of pictures (HTML).")
]
BackgroundOption = Annotated[
    Path | None,
    typer.Option("--background", help="OpenStreetMap extract to draw under maps: .osm, .osm.pbf."),
]
LapOption = Annotated[
    str | None, typer.Option("--lap", help="Keep to a row of laps.csv, or to FIRST:LAST.")
]
WorkersOption = Annotated[
    int | None, typer.Option("--workers", min=1, help="Processes; default: cores.")
]


def frame_range(text: str, count: int) -> range:
    """Rows `A:B` of `--frames` of a drive with `count` frames.

    Raises:
        ConfigError: not two numbers, or none of the drive's rows.
    """
    first, colon, last = text.partition(":")
    try:
        start = int(first) if first else 0
        stop = int(last) if last else count
    except ValueError as error:
        raise ConfigError(f"--frames {text}: expected A:B, such as 0:50") from error
    if not colon or start < 0 or not start < stop:
        raise ConfigError(f"--frames {text}: expected A:B with 0 <= A < B")
    if start >= count:
        raise ConfigError(f"--frames {text}: the drive has {count} frames")
    return range(start, min(stop, count))


def page_possible() -> bool:
    """Whether pages can be drawn; one line says what is missing where they cannot."""
    try:
        for module in ("matplotlib", "jinja2"):
            check_installed(module)
    except MissingExtraError as error:
        sys.stderr.write(f"note: no page: {error}\n")
        return False
    return True
