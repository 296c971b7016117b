"""Whether the stated probability of a wrong place comes true, where cities repeat themselves.

    python -m benchmarks.localize.reliability [--poles 60000] [--starts 60] [--first 30000]
        [--seed 13] [--cities 2] [--kinds avenues mirrored car_parks mixed estates lattice orchard]
        [--out ROWS.jsonl]

Every search of every start up to the claim is one row: what it stated, and whether its first place
was another than the car's (3 m). Half as many starts are made in another city of the same kind, and
counted so that they are one in ten. Not timed, so `python -m benchmarks` leaves it out.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path

import numpy as np

from benchmarks.harness import command_line
from benchmarks.localize.cities import City, make_city
from benchmarks.localize.places import MAP_SD_M, drive_through
from benchmarks.localize.structures import estates, lattice, orchard
from polemap.localize.place.along import searches_along
from polemap.localize.place.finder import WRONG_MOST
from polemap.localize.place.regularity import chance_density
from polemap.map.pattern_index.build import build_index
from polemap.map.pattern_index.index import PatternIndex

KINDS: dict[str, Callable[[int, int], City]] = {
    "avenues": partial(make_city, avenues=0.9, planned=0.0),
    "mirrored": partial(make_city, avenues=0.1, planned=0.9),
    "car_parks": partial(make_city, avenues=0.5, planned=0.2, car_parks=0.8),
    "mixed": make_city,
    "estates": estates,
    "lattice": lattice,
    "orchard": orchard,
}
ELSEWHERE = 0.1
OTHER = 100  # is added to the seed of another city
SAME_M = 3.0
STREWN_PER_M2 = 0.02
BOUNDS = (1.01, 0.9, 0.7, 0.5, 0.3, 0.1, 0.03, 0.01, 1e-3, 0.0)


@dataclass(frozen=True, slots=True)
class Row:
    """One search: city, start, what was stated, what was true, and what both follow from.

    Attributes:
        mapped: whether the car is in the map's city.
        stated, bound: of its first place, see `Search`.
        off_m: of its first place from the car, infinite in another city.
        after_m: way since the begin.
        poles: how many were seen.
        matched: of these, by each place.
        evidence: log evidence of each place.
        by_chance: see `Search`.
        foretold: mean log of how much more often than strewn poles those matched stand by chance.
    """

    kind: str
    seed: int
    start: int
    mapped: bool
    stated: float
    bound: float
    off_m: float | None
    after_m: float
    poles: int
    matched: list[int]
    evidence: list[float]
    by_chance: float | None
    foretold: float

    @property
    def wrong(self) -> bool:
        """Whether the car is elsewhere."""
        return self.off_m is None or self.off_m > SAME_M


def rows_of(
    kind: str, seed: int, index: PatternIndex, city: City, starts: range, mapped: bool
) -> Iterator[Row]:
    """All searches up to the claims, of a car in `city` with the index of its map or another."""
    for start in starts:
        scans, odometry, motion = drive_through(city, start)
        for one in searches_along(scans, odometry, index):
            search = one.search
            if search is None or not len(search.poses):
                continue
            off = search.poses[0, :2] - motion.at(one.stamp_s)[0, :2]
            chance = chance_density(search.local.points_m, STREWN_PER_M2) / STREWN_PER_M2
            chance = chance[search.rows[0] >= 0]
            yield Row(
                kind, seed, start, mapped, search.wrong, search.wrong_at_most,
                float(np.hypot(*off)) if mapped else None, round(one.after_m, 1),
                search.poles, search.matched.tolist(), np.round(search.log_evidence, 3).tolist(),
                round(search.by_chance, 3) if np.isfinite(search.by_chance) else None,
                round(float(np.log(chance).mean()), 3) if len(chance) else 0.0,
            )  # fmt: skip
            if search.wrong_at_most <= WRONG_MOST:
                break


def keep(rows: list[Row], path: Path) -> None:
    """Add rows to a file of JSON lines, where one is asked for."""
    if path != Path(""):
        with path.open("a", encoding="utf-8") as stream:
            stream.writelines(json.dumps(asdict(row)) + "\n" for row in rows)


def table(name: str, rows: list[Row]) -> None:
    """Print what was stated, and how often it was so."""
    stated = np.array([row.stated for row in rows])
    wrong = np.array([row.wrong for row in rows])
    mapped = np.array([row.mapped for row in rows])
    weight = np.where(mapped, 1.0, _weight(rows))
    claimed = np.array([row.bound <= WRONG_MOST for row in rows])
    print(f"{name}: {len(rows)} searches; {claimed.sum()} claims, {(claimed & wrong).sum()} wrong")
    for low, high in zip(BOUNDS[1:], BOUNDS[:-1], strict=True):
        some = (stated >= low) & (stated < high)
        if some.any():
            total = weight[some].sum()
            share = float(np.average(wrong[some], weights=weight[some]))
            print(
                f"  {low:g} to {min(high, 1):g}: {np.count_nonzero(some & mapped)} and "
                f"{np.count_nonzero(some & ~mapped)} elsewhere, stated "
                f"{np.average(stated[some], weights=weight[some]):.2g}, wrong {share:.2g} "
                f"+- {np.sqrt(max(share * (1.0 - share), 1.0 / total) / total):.1g}"
            )
    sys.stdout.flush()


def _weight(rows: list[Row]) -> float:
    """Of a start elsewhere, so that these are one in ten."""
    here, there = (
        len({(row.kind, row.seed, row.start) for row in rows if row.mapped is mapped})
        for mapped in (True, False)
    )
    return here * ELSEWHERE / (1.0 - ELSEWHERE) / max(there, 1)


def main() -> int:
    """Make the starts and print the tables."""
    asked = command_line(
        __doc__, kinds=list(KINDS), poles=60_000, starts=60, first=30_000, seed=13, cities=2,
        out=Path(""),
    )  # fmt: skip
    starts = range(asked.first, asked.first + asked.starts)
    rows: list[Row] = []
    for kind in asked.kinds:
        for seed in range(asked.seed, asked.seed + asked.cities):
            city, other = (KINDS[kind](asked.poles, number) for number in (seed, seed + OTHER))
            index, _ = build_index(city.surveyed(MAP_SD_M, seed))
            made = list(rows_of(kind, seed, index, city, starts, True))
            made += rows_of(kind, seed, index, other, starts[::2], False)
            keep(made, asked.out)
            rows += made
        table(kind, [row for row in rows if row.kind == kind])
    table("all", rows)
    return 0


if __name__ == "__main__":
    sys.exit(main())
