"""The source paper's whole evaluation on simulated routes, in one command.

    python -m benchmarks.evaluate.report_routes --out evaluation

simulates three routes of seven laps at 5 pairs a second, maps each from its first lap, localizes
the other six with 50 seeds and writes `evaluation/report/report.html` with the frame-rate and
particle sweeps. What costs most is done once a lap and kept: pictures are rendered once, and looked
at once for all runs and sweeps. A stopped run goes on where it was. `run()` (for `python -m
benchmarks`) only times the report's own work on synthetic runs.
"""

from __future__ import annotations

import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import yaml

from benchmarks.harness import command_line, summary
from polemap.drivelog.atomic import atomic_file
from polemap.evaluation.laps import find_stretches
from polemap.evaluation.repeatability import deviations, guides_of, repeatability
from polemap.simulate.route import make_route
from polemap.simulate.scenario import Scenario, load_scenario
from polemap.vehicle.trajectory import Trajectory

# Street and laps of the worlds, on a shorter way round: a lap of 40 s keeps the whole in its time.
CORNERS_M: dict[str, list[tuple[float, float]] | None] = {
    "park_loop": None,
    "avenue": [(0, 0), (86, -4), (92, 50), (4, 56)],
    "suburb": [(0, 0), (70, 4), (76, 50), (-4, 54)],
}
# the worlds must not lie on top of each other: drives over the same ground are one route
SPACING_M = 2000.0
FRAME_RATE_HZ = 5.0
# at 5 pairs a second and one lap a pole is seen in few frames
MAPPING = "polemap.mapping.observations_min=5"
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
        finding.append(middle - begin)
        measuring.append(time.perf_counter() - middle)
    return {
        "report_find_six_laps_2_4_km": summary(finding),
        "report_measure_one_run_2_4_km_100_hz": summary(measuring),
    }


def main(arguments: list[str] | None = None) -> int:
    """Make the evaluation; prints the time of every step."""
    chosen = command_line(
        __doc__, arguments, out=Path("evaluation"), routes=list(CORNERS_M), laps=6, runs=50,
        sweep_runs=8, seed=0, workers=2,
    )  # fmt: skip
    out: Path = chosen.out
    begin = time.monotonic()
    seed, workers = ["--seed", chosen.seed], ["--workers", chosen.workers]
    for route in chosen.routes:
        world = out / f"{route}.yaml"
        with atomic_file(world) as part:
            part.write_text(yaml.safe_dump(short_world(route).model_dump(mode="json")))
        words = ["simulate", world, "--out", out / route, "--laps", chosen.laps + 1, "--objects"]
        render = ["--set", f"simulate.render.workers={chosen.workers}"]
        _step(out / route, [*words, *render, *seed])
    with ThreadPoolExecutor(chosen.workers) as pool:
        maps = [
            pool.submit(
                _step,
                out / f"{route}.gpkg",
                ["map", out / route, "--lap", "lap_1", "--out", out / f"{route}.gpkg",
                 "--set", MAPPING],
            )
            for route in chosen.routes
        ]  # fmt: skip
        for one in maps:
            one.result()
    cache = ["--cache", out / "cache"]
    for route in chosen.routes:
        # the lap that made the map is no test
        laps = ["--lap", f"lap_2:lap_{chosen.laps + 1}"] if chosen.laps > 1 else ["--lap", "lap_2"]
        words = ["localize", out / route, "--map", out / f"{route}.gpkg", *laps]
        words += ["--out", out / f"{route}_runs", "--runs", chosen.runs]
        _step(out / f"{route}_runs", [*words, *workers, *seed, *cache])
    words = ["report", *(out / f"{route}_runs" for route in chosen.routes), "--out", out / "report"]
    words += ["--sweep", RATES, "--sweep", PARTICLES, "--sweep-runs", chosen.sweep_runs]
    _step(None, [*words, "--latex", *workers, *seed, *cache])
    print(f"everything: {time.monotonic() - begin:.0f} s; open {out / 'report' / 'report.html'}")
    return 0


def short_world(route: str) -> Scenario:
    """A world of the simulator at 5 pairs a second, on a way round that fits the evaluation."""
    world = load_scenario(route)
    tree = world.model_dump(mode="json")
    tree["drive"] |= {"frame_rate_hz": FRAME_RATE_HZ, "standstill_s": 2.0}
    tree["origin_east_m"] += SPACING_M * list(CORNERS_M).index(route)
    corners_m = CORNERS_M[route]
    if corners_m is not None:
        length_m = make_route(corners_m, world.route.corner_radius_m, closed=True).length_m
        tree["route"]["corners_m"] = [list(corner) for corner in corners_m]
        tree["side_streets"] = [s for s in tree["side_streets"] if s["at_m"] < length_m - 30.0]
        section, drive = tree["section"], tree["drive"]
        section["paving"] = [one for one in section["paving"] if one["to_m"] < length_m]
        drive["stops_m"] = [stop for stop in drive["stops_m"] if stop < length_m - 30.0]
    return Scenario.model_validate(tree)


def _step(target: Path | None, words: list[object]) -> None:
    """One command of the tool, unless its result is there."""
    line = [str(word) for word in words]
    if target is not None and target.exists():
        print(f"polemap {line[0]}: {target} is there", flush=True)
        return
    begin = time.monotonic()
    command = [sys.executable, "-c", "from polemap.tools.cli import main; main()", *line]
    code = subprocess.run(command, check=False).returncode
    if code != 0:
        raise SystemExit(code)  # the command has said why
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


if __name__ == "__main__":
    sys.exit(main())
