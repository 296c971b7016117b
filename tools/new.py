"""`polemap new`: a drive folder to fill."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from polemap.drivelog.errors import ConfigError
from polemap.drivelog.frames import EarthFrame
from polemap.drivelog.problems import did_you_mean
from polemap.drivelog.readers.columns import FILES
from polemap.drivelog.writers.template import check_new, write_template


def command(
    drive: Annotated[Path, typer.Argument(help="Folder that appears.")],
    sensors: Annotated[
        str, typer.Option("--sensors", help="Files to write headers of, separated by commas.")
    ] = "odometry,gnss,reference",
    epsg: Annotated[
        int | None, typer.Option("--epsg", help="UTM zone of all coordinates, such as 32632.")
    ] = None,
    local: Annotated[
        str | None, typer.Option("--local", help="Or the name of a plane of your own.")
    ] = None,
    wheelbase_m: Annotated[
        float | None, typer.Option("--wheelbase", min=0.1, help="Of the car, metres.")
    ] = None,
    allow_links: Annotated[
        bool, typer.Option("--allow-links", help="Pictures may lie outside of the folder.")
    ] = False,
) -> None:
    """Write a drive folder to fill: drive.yaml with every key explained, and CSV headers.

    Examples:
        polemap new drives/tuesday
        polemap new drives/tuesday --epsg 32632 --wheelbase 2.71 --sensors frames,odometry,gnss
        polemap new drives/yard --local yard --sensors odometry,reference,poles,scans

    What only you know says CHOOSE. Nothing is overwritten. Logs of a recorder need no such folder:
    polemap convert makes one of them.
    """
    names = [name.strip() for name in sensors.split(",") if name.strip()]
    for name in names:
        if name not in FILES:
            known = list(FILES)
            raise ConfigError(
                f"new: --sensors {name} is unknown; known: {', '.join(known)}"
                f"{did_you_mean(name, known)}"
            )
    if epsg is not None and local is not None:
        raise ConfigError("new: --epsg and --local are two frames; give one of them")
    check_new(drive)
    frame = EarthFrame("utm", epsg) if epsg is not None else None
    if local is not None:
        frame = EarthFrame("local", name=local)
    write_template(
        drive,
        frame=frame,
        wheelbase_m=wheelbase_m,
        sensors=list(dict.fromkeys(names)),
        allow_links=allow_links,
    )
    typer.echo(f"{drive}: drive.yaml and {', '.join(f'{name}.csv' for name in names)}")
    typer.echo(f"next: fill them, then polemap info {drive}")
