"""Accuracy over worlds that nothing was chosen on, once a release.

    python -m benchmarks.localize.set_aside [--rows ROWS.jsonl] [--routes park_loop ...]
        [--worlds 12] [--first 0] [--pictures] [--table]

A row is a world of a route: its streets, poles, driver, odometry and receiver; lap 2 at 22 Hz in
the map of lap 1, judged from `SETTLED_S` after the first pose on. The numbers of the worlds stand
in `set_aside_worlds.txt`; `--worlds 12 --first N` takes the numbers from N on in their place, to
look for causes in. Poles are those of the simulated detector; with `--pictures` they are seen in
rendered pictures, of lap 2 every second (11 Hz), which costs minutes a world. Rows that the file
has already are not made again. Not timed, so `python -m benchmarks` leaves it out.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from benchmarks.departures.judge import run_case
from benchmarks.departures.routes import SIMULATED, Course, simulated, truth_of
from benchmarks.harness import FOLDER, append_row, command_line, rows_in
from benchmarks.localize.worlds import MAP_EVERY, RATE_HZ, map_of, scenario_of, see
from polemap.drivelog.readers.registry import open_drive
from polemap.settings import Settings
from polemap.simulate.config import SimulateConfig
from polemap.simulate.drive import simulate_drive

LIST = FOLDER / "localize" / "set_aside_worlds.txt"
CONSISTENT = (0.6, 1.6)
"""A NEES over its degrees of freedom that is held right."""
_PICTURES_EVERY = 2
_COLUMNS = ("lateral_m", "along_m")
Row = dict[str, Any]
Key = tuple[str, int, bool]


def set_aside() -> list[int]:
    """The numbers of the list."""
    lines = LIST.read_text(encoding="utf-8").splitlines()
    return [int(line) for line in lines if line and not line.startswith("#")]


def row_of(route: str, world: int, folder: Path, *, pictures: bool) -> Row:
    """Figures of one world."""
    settings = Settings()
    if pictures:
        course = _seen(route, world, folder)
    else:
        course = simulated(route, world, settings, folder, RATE_HZ)
    row = run_case(course, settings.localize, world % 1000)
    head = {"route": route, "world": world, "pictures": pictures, "poles": len(course.pole_map)}
    return {**head, **row}


def _seen(route: str, world: int, folder: Path) -> Course:
    """Lap 2 in the map of lap 1, both by rendered pictures."""
    place = folder / f"{route}_{world}_seen"
    scenario, config = scenario_of(route), SimulateConfig()
    simulate_drive(scenario, place, 2, world, config, objects=True, images=False)
    drive = open_drive(place)
    pole_map = map_of(drive, see(route, world, drive, 0, MAP_EVERY))
    scans = see(route, world, drive, 1, _PICTURES_EVERY)
    return Course(drive.lap(drive.laps[1].name), pole_map, tuple(scans), truth_of(place))


def tables(rows: Sequence[Row]) -> Iterator[str]:
    """Mean, spread and worst world of every route, and how many worlds are consistent."""
    for pictures in (False, True):
        mine = [row for row in rows if row["pictures"] == pictures and "failed" not in row]
        if not mine:
            continue
        lines = [
            f"| {'pictures' if pictures else 'simulated detector'}: route | worlds | filter "
            "| lateral: mean, sd, worst | along: mean, sd, worst | NEES: mean, least, most "
            f"| in {CONSISTENT[0]} to {CONSISTENT[1]} |",
            "|---" * 7 + "|",
        ]
        for route in (*SIMULATED, "all"):
            chosen = [row for row in mine if route in (row["route"], "all")]
            lines += [_line(route, name, chosen) for name in ("pf", "kf") if chosen]
        yield "\n".join(lines)


def _line(route: str, name: str, rows: Sequence[Row]) -> str:
    cells = [route, str(len(rows)), {"pf": "particle", "kf": "output"}[name]]
    for key in _COLUMNS:
        values = np.array([row[name][key] for row in rows])
        spread = float(values.std(ddof=1)) if len(values) > 1 else float("nan")
        cells.append(f"{values.mean():.3f}, {spread:.3f}, {values.max():.3f} m")
    nees = np.array([row[name]["nees"] for row in rows])
    cells.append(f"{nees.mean():.2f}, {nees.min():.2f}, {nees.max():.2f}")
    cells.append(f"{consistent(nees)} of {len(nees)}, scaled {consistent(nees / nees.mean())}")
    return f"| {' | '.join(cells)} |"


def consistent(nees: np.ndarray) -> int:
    """How many lie within `CONSISTENT`."""
    return int(np.count_nonzero((nees >= CONSISTENT[0]) & (nees <= CONSISTENT[1])))


def main() -> int:
    """Make what is asked for and print the tables."""
    asked = command_line(
        __doc__, rows=Path("set_aside.jsonl"), routes=list(SIMULATED), worlds=12, first=0,
        pictures=False, table=False,
    )  # fmt: skip
    chosen = list(range(asked.first, asked.first + asked.worlds)) if asked.first else set_aside()
    rows = rows_in(asked.rows, "route", "world", "pictures")
    for world in () if asked.table else chosen[: asked.worlds]:
        for route in asked.routes:
            if (route, world, asked.pictures) in rows:
                continue
            with TemporaryDirectory() as name:
                row = row_of(route, world, Path(name), pictures=asked.pictures)
            rows[route, world, asked.pictures] = row
            append_row(asked.rows, row)
            print(f"{route} {world}: {row.get('failed', 'done')}", flush=True)
    print("\n\n".join(tables(list(rows.values()))))
    return 0


if __name__ == "__main__":
    sys.exit(main())
