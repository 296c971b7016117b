"""The source paper's whole evaluation on simulated routes, in one command.

    python -m benchmarks.report_routes --out evaluation

simulates three routes of seven laps, maps each from its first lap, localizes the other six with 50
seeds and writes `evaluation/report/report.html` with the frame-rate and particle sweeps. What is
there already is not made again, so that a stopped run goes on. `run()` (for `python -m benchmarks`)
only times the report's own work on synthetic runs.
"""

from __future__ import annotations

import argparse
import csv
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tools.report.laps import find_stretches
from tools.report.repeatability import deviations, guides_of, repeatability
from tools.report.trajectory import Trajectory

ROUTES = ("park_loop", "avenue", "suburb")
RATES = "frame_rate=full,half,third"
PARTICLES = "particles=50,100,200,500,1000,2000"


def run() -> dict[str, dict[str, float]]:
    """Time to find six laps in a track, and to measure one run's 100 Hz trajectory on them."""
    finding, measuring = [], []
    for seed in range(7):
        track = _circle_drive(np.random.default_rng(seed))
        begin = time.perf_counter()
        (stretch,) = find_stretches([track])
        guides = guides_of(stretch, [track])
        middle = time.perf_counter()
        repeatability([deviations(stretch, [track], guides)])
        finding.append(1e3 * (middle - begin))
        measuring.append(1e3 * (time.perf_counter() - middle))
    return {
        "report_find_six_laps_2_4_km": _figures(finding),
        "report_measure_one_run_2_4_km_100_hz": _figures(measuring),
    }


def main(arguments: list[str] | None = None) -> int:
    """Make the evaluation; prints the time of every step."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("evaluation"))
    parser.add_argument("--routes", nargs="+", default=list(ROUTES))
    parser.add_argument("--laps", type=int, default=6)
    parser.add_argument("--runs", type=int, default=50)
    parser.add_argument("--sweep-runs", type=int, default=10)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--workers", type=int, default=2)
    chosen = parser.parse_args(arguments)
    out: Path = chosen.out
    begin = time.monotonic()
    folders: list[Path] = []
    options: list[str] = []
    for route in chosen.routes:
        drive, pole_map, folder = out / route, out / f"{route}.gpkg", out / f"{route}_runs"
        seed = ["--seed", str(chosen.seed)]
        laps = str(chosen.laps + 1)
        _step(drive, ["simulate", route, "--out", drive, "--laps", laps, "--objects", *seed])
        _step(pole_map, ["map", drive, "--lap", "lap_1", "--out", pole_map])
        runs = ["--runs", str(chosen.runs), "--workers", str(chosen.workers)]
        words = ["localize", drive, "--map", pole_map, "--out", folder, *runs, *seed]
        _step(folder, words)
        folders.append(folder)
        # The lap that made the map is no test.
        options += ["--exclude", f"{route}_{chosen.seed}/0:{_end_of_first_lap(drive)}"]
    options += ["--sweep", RATES, "--sweep", PARTICLES, "--sweep-runs", str(chosen.sweep_runs)]
    options += ["--workers", str(chosen.workers), "--latex"]
    _step(None, ["report", *folders, "--out", out / "report", *options])
    print(f"everything: {time.monotonic() - begin:.0f} s; open {out / 'report' / 'report.html'}")
    return 0


def _end_of_first_lap(drive: Path) -> str:
    with (drive / "laps.csv").open(encoding="utf-8", newline="") as stream:
        return next(csv.DictReader(stream))["end_s"]


def _step(target: Path | None, words: list[object]) -> None:
    """One command of the tool, unless its result is there."""
    line = [str(word) for word in words]
    if target is not None and target.exists():
        print(f"polemap {line[0]}: {target} is there")
        return
    begin = time.monotonic()
    subprocess.run([sys.executable, "-c", "from tools.cli import main; main()", *line], check=True)
    print(f"polemap {' '.join(line)}: {time.monotonic() - begin:.0f} s", flush=True)


def _circle_drive(rng: np.random.Generator) -> Trajectory:
    """Six laps of a course of 395 m at 8 m/s, 100 Hz, 0.15 m of lateral noise."""
    angle = np.arange(0.0, 6.02 * 2.0 * np.pi, 8.0 / 100.0 / 63.0)
    knots = rng.normal(0.0, 0.15, len(angle) // 80 + 2)
    lateral = np.interp(np.arange(len(angle)) / 80.0, np.arange(len(knots)), knots)
    radius = 60.0 + 8.0 * np.cos(3.0 * angle) - lateral
    points = np.column_stack([radius * np.cos(angle), radius * np.sin(angle)])
    ahead = np.gradient(points, axis=0)
    heading = np.arctan2(ahead[:, 1], ahead[:, 0])
    return Trajectory(np.arange(len(angle)) / 100.0, np.column_stack([points, heading]))


def _figures(values_ms: list[float]) -> dict[str, float]:
    array: NDArray[np.float64] = np.array(values_ms)
    return {
        "median_ms": float(np.median(array)),
        "p95_ms": float(np.quantile(array, 0.95)),
    }


if __name__ == "__main__":
    sys.exit(main())
