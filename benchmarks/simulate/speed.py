"""Stereo pairs a second of the simulator at 768x480, with shadows off, from a map, and by rays.

One process on one core; `pairs_per_s_2_cores` is twice that, since pairs are independent and
`simulate_drive` renders them in as many processes as there are cores.
"""

from __future__ import annotations

from time import perf_counter

import cv2
import numpy as np

from benchmarks.harness import compared
from polemap.simulate.config import RenderConfig, SimulateConfig
from polemap.simulate.scenario import load_scenario
from polemap.simulate.studio import Studio, make_plan
from polemap.simulate.world import make_world

ROUNDS = 7
MODES = {
    "shadows_off": RenderConfig(shadows=False),
    "shadow_map": RenderConfig(),
    "shadow_rays": RenderConfig(shadow_rays=True),
}


def run() -> dict[str, dict[str, float]]:
    """Collected by `python -m benchmarks`."""
    scenario = load_scenario("park_loop")
    world = make_world(scenario, 3)
    cv2.setNumThreads(1)
    studios = {}
    for name, render in MODES.items():
        config = SimulateConfig(render=render)
        plan = make_plan(world.route, scenario, 1, 3, config)
        studios[name] = Studio(plan, world, 1)
    times: dict[str, list[float]] = {name: [] for name in MODES}
    numbers = np.linspace(10, len(plan.frame_stamps_s) - 10, ROUNDS).astype(int)
    for number in numbers:
        for name, studio in studios.items():
            begin = perf_counter()
            studio.shot(int(number))
            times[name].append(perf_counter() - begin)
    return {
        f"simulate_pair_{name}": {**row, "pairs_per_s_2_cores": 2e3 / row["median_ms"]}
        for name, row in compared(times, "shadows_off").items()
    }


if __name__ == "__main__":
    for name, values in run().items():
        print(name, {key: round(value, 2) for key, value in values.items()})
