"""Every kind of fault of `fault_kinds.py` on many seeds: is the localizer right, or does it say so?

`python -m benchmarks.campaign.contradictions [--seeds N] [--first N] [--kinds WORD] [--out FILE]
[--workers N] [--held-out]` runs them and prints a line a kind. The rows go to FILE as they come;
what stands there already is not run again, so a campaign that was stopped goes on.
"""

from __future__ import annotations

import json
import warnings
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.campaign.fault_kinds import KINDS
from benchmarks.campaign.held_out import HELD_OUT
from benchmarks.campaign.judge import judge
from benchmarks.harness import FOLDER, command_line
from polemap.drivelog.jobs import LocalWorkers, in_order
from polemap.localize.config import LocalizeConfig
from polemap.localize.replay import replay

RESULTS = FOLDER / "contradictions.jsonl"


def one(job: tuple[str, int]) -> dict[str, Any]:
    """One kind with one seed; a crash is an outcome."""
    name, seed = job
    try:
        faulty = {**KINDS, **HELD_OUT}[name](seed)
        case = faulty.case
        run = replay(case.drive, case.pole_map, case.scans, LocalizeConfig(), seed=seed)
        verdicts = {key: asdict(verdict) for key, verdict in judge(run, faulty).items()}
    except Exception as error:  # the campaign counts crashes, and goes on
        verdicts = {
            key: {"silent_s": 0.0, "healthy": 0.0, "worst_m": 0.0,
                  "delay_s": float("nan"), "back_s": float("nan"),
                  "outcome": f"crash: {type(error).__name__}: {error}"}
            for key in ("pf", "kf")
        }  # fmt: skip
    return {"kind": name, "seed": seed, **verdicts}


def run_all(kinds: list[str], seeds: range, out: Path, workers: int = 2) -> list[dict[str, Any]]:
    """All rows; those that `out` holds already are not run again."""
    rows = [json.loads(line) for line in out.read_text().splitlines()] if out.exists() else []
    done = {(row["kind"], row["seed"]) for row in rows}
    jobs = [(k, s) for s in seeds for k in kinds if (k, s) not in done]
    with out.open("a") as file:
        for row in in_order(one, jobs, LocalWorkers(workers)):
            file.write(json.dumps(row) + "\n")
            file.flush()
            rows.append(row)
    return [row for row in rows if row["kind"] in kinds and row["seed"] in seeds]


def table(rows: list[dict[str, Any]]) -> Iterator[str]:
    """A line a kind."""
    yield (
        "kind | silent s pf, kf | runs silent | healthy pf, kf | worst m pf, kf | "
        "delay s pf, kf | back s pf, kf"
    )
    for kind in dict.fromkeys(row["kind"] for row in rows):
        of = [row for row in rows if row["kind"] == kind]
        cells = []
        for key, how in (("silent_s", np.sum), ("healthy", np.mean), ("worst_m", np.max)):
            pair = [how([row[f][key] for row in of]) for f in ("pf", "kf")]
            cells.append(", ".join(f"{value:.2f}" for value in pair))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            for key in ("delay_s", "back_s"):
                pair = [np.nanmedian([row[f].get(key, np.nan) for row in of]) for f in ("pf", "kf")]
                cells.append(", ".join(f"{value:.1f}" for value in pair))
        silent = sum(row["pf"]["silent_s"] + row["kf"]["silent_s"] > 0 for row in of)
        crashes = sum(row["kf"]["outcome"].startswith("crash") for row in of)
        yield (
            f"{kind} | {cells[0]} | {silent} of {len(of)} | "
            + " | ".join(cells[1:])
            + (f" | {crashes} CRASHES" if crashes else "")
        )


def main(words: list[str] | None = None) -> None:
    """Run what the words ask for, all kinds with ten seeds by default."""
    given = command_line(
        __doc__, words, seeds=10, first=0, kinds="", out=RESULTS, workers=2, held_out=False
    )
    kinds = [name for name in (HELD_OUT if given.held_out else KINDS) if given.kinds in name]
    seeds = range(given.first, given.first + given.seeds)
    for line in table(run_all(kinds, seeds, given.out, given.workers)):
        print(line, flush=True)


if __name__ == "__main__":
    main()
