"""`polemap demo`: the whole main job on an embedded simulated drive."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Annotated, Any

import typer

from polemap.drivelog.atomic import own_folder
from polemap.tools import localize, simulate
from polemap.tools import map as pole_maps
from polemap.tools.option_types import ConfigOption, SeedOption, SetOption
from polemap.tools.report import command as report

WORLD = "park_loop"
MAP_LAP = "lap_1"
TEST_LAPS = ("lap_2", "lap_3")
# the drive is filmed at 5 Hz to keep the demo short, so a pole is seen in few frames
MAPPING = "polemap.mapping.observations_min=5"


def command(
    out: Annotated[Path, typer.Option("--out", help="Folder for everything made.")] = Path("demo"),
    seed: SeedOption = 0,
    config: ConfigOption = None,
    set_values: SetOption = None,
) -> None:
    """Simulate a drive, map its poles, localize further laps in the map, report.

    Examples:
        polemap demo
        polemap demo --out /tmp/demo --seed 3
        polemap demo --set localize.particles=300

    Three laps of a small park are rendered with stereo images, odometry with a bias and a cheap
    GNSS. The map comes from lap 1; laps 2 and 3 are localized in it and held against the truth.
    Every step is a command that you can run on your own drives, and is shown before it runs.
    """
    drive, pole_map, page = out / "drive", out / "map.gpkg", out / "report"
    runs = [out / lap for lap in TEST_LAPS]
    shared: dict[str, Any] = {"seed": seed, "config": config, "set_values": set_values}
    begin = time.monotonic()

    own_folder(out, "demo", [drive, pole_map, page, *runs])
    laps = 1 + len(TEST_LAPS)
    _show(f"simulate {WORLD} --out {drive} --laps {laps} --objects", seed)
    simulate.command(WORLD, out=drive, laps=laps, objects=True, **shared)
    _show(f"map {drive} --lap {MAP_LAP} --out {pole_map} --set {MAPPING}", seed)
    mapping = {**shared, "set_values": [MAPPING, *(set_values or [])]}
    pole_maps.command([drive], out=pole_map, lap=MAP_LAP, **mapping)
    for lap, run in zip(TEST_LAPS, runs, strict=True):
        _show(f"localize {drive} --map {pole_map} --lap {lap} --out {run}", seed)
        localize.command(drive, out=run, map_file=pole_map, lap=lap, **shared)
    _show(f"report {' '.join(map(str, runs))} --out {page}", seed)
    report.command(runs, out=page, seed=seed)
    typer.echo(f"demo finished in {time.monotonic() - begin:.0f} s; open {page / 'report.html'}")


def _show(line: str, seed: int) -> None:
    typer.echo(f"\n$ polemap {line}" + (f" --seed {seed}" if seed else ""))
