"""What each departure from Spangenberg (2016) is worth: ours with one of them taken back at a time.

    python -m benchmarks.departures [--rows ROWS.jsonl] [--routes park_loop kitti_03 ...]
        [--seeds 2] [--first 0] [--cases "slip" "as printed" ...] [--table]

Three simulated routes (scans of a detector with stated errors, 11 Hz; a seed is a world and the
filter's), drives of points with faults in them (each seed another kind; `silent` is how long the
pose was wrong and called healthy, as `benchmarks.campaign` has it), Victoria Park and KITTI 03 (a
seed is the filter's and the simulated GNSS's). Rows that the file has already are not made again;
`--table` prints what it holds. A run that ends in an error is a row that says so. Not timed, so
`python -m benchmarks` leaves it out; the processor time an update is that of one run each.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from benchmarks.departures.cases import all_cases, case_names, concern_of, settings_of
from benchmarks.departures.judge import run_case
from benchmarks.departures.routes import ROUTES, Course
from benchmarks.departures.table import tables
from benchmarks.harness import append_row, command_line, rows_in

Key = tuple[str, int, str]


def new_rows(route: str, seed: int, cases: list[str], folder: Path) -> Iterator[dict[str, Any]]:
    """A row for each case; what its settings do not change is made once."""
    made: dict[bool, Course] = {}
    for case in cases:
        settings, seen = settings_of(case), bool({"eye", "tracks"} & set(concern_of(case)))
        if seen or seen not in made:
            made[seen] = ROUTES[route].course(seed, settings, folder)
        yield {
            "route": route, "seed": seed, "case": case,
            **run_case(made[seen], settings.localize, seed),
        }  # fmt: skip


def main() -> int:
    """Make what is asked for and print the tables."""
    asked = command_line(
        __doc__, rows=Path("departures.jsonl"), routes=list(ROUTES), seeds=2, first=0,
        cases=all_cases(), table=False,
    )  # fmt: skip
    rows = rows_in(asked.rows, "route", "seed", "case")
    with TemporaryDirectory() as name:
        for seed in () if asked.table else range(asked.first, asked.first + asked.seeds):
            for route in asked.routes:
                if ROUTES[route].missing is not None:
                    print(f"{route} is skipped: {ROUTES[route].missing} is not there")
                    continue
                cases = [
                    case
                    for case in case_names(ROUTES[route].concerns)
                    if case in asked.cases and (route, seed, case) not in rows
                ]
                for row in new_rows(route, seed, cases, Path(name)):
                    rows[route, seed, row["case"]] = row
                    append_row(asked.rows, row)
                    print(f"{route} {seed} {row['case']}: {row.get('failed', 'done')}", flush=True)
    print("\n\n".join(tables(list(rows.values()))))
    return 0


if __name__ == "__main__":
    sys.exit(main())
