"""`polemap demo`: the whole main job on an embedded simulated drive."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Annotated, Any

import typer

from polemap.drivelog.atomic import atomic_file, own_folder
from polemap.extras import check_installed
from polemap.tools.option_types import ConfigOption, SeedOption, SetOption

WORLD = "park_loop"
MAP_LAP = "lap_1"
TEST_LAPS = ("lap_2", "lap_3")
# the drive is filmed at 5 Hz to keep the demo short, so a pole is seen in few frames
MAPPING = "polemap.mapping.observations_min=5"
README = "README.md"
_ABOUT = """# What the demo made

Open `report/report.html` in a browser: it needs no network and no other file.

| what | is |
|---|---|
| `drive/` | a simulated drive, three laps of a small park: stereo pictures ({pictures_mb:.0f} MB of the {all_mb:.0f} MB here), odometry, GNSS, the true motion (`truth.tum`) and the true poles |
| `map.gpkg` | the pole map of lap 1, for QGIS as well |
| `lap_2/`, `lap_3/` | those laps localized in the map: `kf.tum` is the pose 100 times a second, `health.csv` and `output.csv` say whether to trust it, `metrics.json` how far off it is |
| `report/` | the page, its figures as `report.json` and `tables/*.csv`, its pictures |

Try next:

```
polemap info {drive}
polemap detect {drive} --frames 0:20 --pictures --out found
polemap view {out}/lap_2 --drive {drive}
polemap convert {out}/lap_2 --out lap_2.tum
```

The pictures (`drive/left`, `drive/right`) are needed by `detect`, `map` and `localize` only; `view`
without `--drive` and `convert` do without them. Delete the whole folder when you are done.
"""  # noqa: E501


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
    # together slow to import
    from polemap.tools import localize, simulate
    from polemap.tools import map as pole_maps
    from polemap.tools.report import command as report

    drive, pole_map, page = out / "drive", out / "map.gpkg", out / "report"
    runs = [out / lap for lap in TEST_LAPS]
    shared: dict[str, Any] = {"seed": seed, "config": config, "set_values": set_values}
    begin = time.monotonic()

    for module in ("matplotlib", "jinja2", "open3d"):
        check_installed(module)
    own_folder(out, "demo", [drive, pole_map, page, out / README, *runs])
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
    _write_readme(out, drive)
    typer.echo(f"demo finished in {time.monotonic() - begin:.0f} s; open {page / 'report.html'}")


def _write_readme(out: Path, drive: Path) -> None:
    """Say what lies in the folder, and how large it is."""
    sizes = {path: path.stat().st_size for path in out.rglob("*") if path.is_file()}
    pictures = sum(n for path, n in sizes.items() if path.parent.name in ("left", "right"))
    text = _ABOUT.format(
        drive=drive, out=out, pictures_mb=pictures / 1e6, all_mb=sum(sizes.values()) / 1e6
    )
    with atomic_file(out / README) as part:
        part.write_text(text, encoding="utf-8")


def _show(line: str, seed: int) -> None:
    typer.echo(f"\n$ polemap {line}" + (f" --seed {seed}" if seed else ""))
