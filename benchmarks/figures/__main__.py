"""Tables I to III and Figures 5 to 8 of Spangenberg (2016), by both configurations.

    python -m benchmarks.figures [--out FIGURES] [--runs 50] [--laps 6] [--routes park_loop ...]
        [--sweep-runs 50] [--draw]

Simulated routes, poles of a detector with stated errors at the paper's 22 Hz; lap 1 makes the map,
the laps after it are localized by our settings and by the method as printed (`--config
papers/s16.yaml`). Frame rates and numbers of particles are swept on the first route, made harder;
as it is simulated only the ends are run. Rows that `FIGURES/rows.jsonl` has are not made again, so
a stopped run goes on, and more runs add to them; `--draw` only draws what there is. The paper has
50 runs of six to eight laps, here hours on one core. Not timed, so `python -m benchmarks` leaves
it out.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from benchmarks.evaluate.report_routes import CORNERS_M
from benchmarks.figures.laps import CONFIGURATIONS, EASY, HARD, Laps, drive_of, laps_of
from benchmarks.figures.measure import (
    EVERY,
    PARTICLES,
    PRINTED_PARTICLES,
    measured,
    scans_of,
    track_figures,
)
from benchmarks.figures.plots import draw
from benchmarks.figures.tables import tables
from benchmarks.harness import append_row, command_line, rows_in

Key = tuple[str, str, str, int, int, int]
Row = dict[str, Any]
_KEY = ("route", "condition", "configuration", "every", "particles", "seed")


def wanted(routes: list[str], runs: int, sweep_runs: int) -> Iterator[Key]:
    """Every run, all figures growing together seed by seed."""
    swept = routes[0]
    for seed in range(max(runs, sweep_runs)):
        for configuration in CONFIGURATIONS:
            for route in routes if seed < runs else ():
                yield route, EASY, configuration, 1, PRINTED_PARTICLES, seed
            # where nothing is lost the ends say it all
            for condition, rates, counts in (
                ((HARD, EVERY, PARTICLES), (EASY, EVERY[-1:], PARTICLES[:1]))
                if seed < sweep_runs
                else ()
            ):
                for every in rates:
                    yield swept, condition, configuration, every, PRINTED_PARTICLES, seed
                for particles in counts:
                    yield swept, condition, configuration, 1, particles, seed


class Courses:
    """Laps and scans, kept while they are asked for again."""

    def __init__(self, folder: Path, laps: int) -> None:
        self._folder, self._count = folder, laps
        self._laps: dict[tuple[str, str, str], Laps] = {}
        self._scans: dict[tuple[str, str, str, int], Any] = {}

    def laps(self, route: str, condition: str, configuration: str) -> Laps:
        """The laps of a route under a condition, with the map of a configuration."""
        key = route, condition, configuration
        if key not in self._laps:
            easy = drive_of(route, EASY, self._count, self._folder)
            hard = drive_of(route, condition, self._count, self._folder)
            settings = CONFIGURATIONS[configuration]()
            self._laps[key] = laps_of(route, condition, self._count, settings, easy, hard)
        return self._laps[key]

    def row(self, key: Key) -> Row:
        """One run."""
        _, _, configuration, every, particles, seed = key
        laps, settings = self.laps(*key[:3]), CONFIGURATIONS[configuration]()
        if key[:4] not in self._scans:
            self._scans[key[:4]] = scans_of(laps, settings, every)
        found = measured(laps, settings, self._scans[key[:4]], particles, seed)
        truth, reference = (track_figures(laps, t) for t in (laps.truth, laps.reference))
        head = dict(zip(_KEY, key, strict=True))
        return {**head, "poles": len(laps.pole_map), "laps": len(laps.stretch.passes),
                "length_m": laps.stretch.path.length_m,
                "truth_m": truth["repeatability_m"],
                "reference_m": reference["repeatability_m"], **found}  # fmt: skip


def main() -> int:
    """Make the rows, draw the figures, print the tables."""
    asked = command_line(
        __doc__, out=Path("figures"), routes=list(CORNERS_M), runs=2, laps=2, sweep_runs=2,
        draw=False,
    )  # fmt: skip
    asked.out.mkdir(parents=True, exist_ok=True)
    file = asked.out / "rows.jsonl"
    rows, courses = rows_in(file, *_KEY), Courses(asked.out / "drives", asked.laps)
    (asked.out / "drives").mkdir(exist_ok=True)
    for key in () if asked.draw else wanted(asked.routes, asked.runs, asked.sweep_runs):
        if key in rows:
            continue
        rows[key] = courses.row(key)
        append_row(file, rows[key])
        print(*key, rows[key].get("failed", "done"), flush=True)
    draw(list(rows.values()), courses, asked.routes, asked.out)
    text = "\n\n".join(tables(list(rows.values()), courses, asked.routes))
    (asked.out / "tables.md").write_text(text + "\n", encoding="utf-8")
    print(text)
    return 0


if __name__ == "__main__":
    sys.exit(main())
