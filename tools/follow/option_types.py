"""Command-line options of `polemap localize --follow`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

FollowOption = Annotated[
    str | None,
    typer.Option("--follow", help="Live: a growing MCAP file, or - for standard input."),
]
CarOption = Annotated[
    Path | None, typer.Option("--car", help="With --follow: a drive of the same car.")
]
ServeOption = Annotated[
    str | None,
    typer.Option("--serve", help="With --follow: [HOST:]PORT of a Foxglove WebSocket."),
]
DelayOption = Annotated[
    float | None,
    typer.Option(
        "--delay",
        min=0.0,
        max=10.0,
        metavar="SECONDS",
        help="Poses are so old, and what comes in chunks of up to that length is in time.",
    ),
]
IdleOption = Annotated[
    float | None,
    typer.Option("--idle", min=0.1, help="With --follow: end if a file rests for SECONDS."),
]
