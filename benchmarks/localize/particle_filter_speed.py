"""Time of a full particle-filter update, and of its assignment against a loop over scipy.

`run()` is collected by `python -m benchmarks`. The scene is that of the requirement: 1000
particles, 10 poles in the scan, 25 map poles around; an update is predict (two odometry steps),
weigh with optimal assignment, estimate, resample.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from benchmarks.harness import interleaved, summary
from polemap.drivelog.detections import Detections, VisibleRegion, pole_detections
from polemap.drivelog.frames import EarthFrame
from polemap.drivelog.samples import OdometrySample
from polemap.localize.config import LocalizeConfig
from polemap.localize.particle_filter.assignment import assign
from polemap.localize.particle_filter.filter import ParticleFilter
from polemap.localize.particle_filter.landmarks import Landmarks
from polemap.localize.particle_filter.sensor_model import (
    PoleModel,
    pair_gains,
    pole_log_likelihood,
)
from polemap.map.pole_map import PoleMap
from polemap.vehicle.pose import inverse_transform_points

Floats = NDArray[np.float64]

_SEEN, _IN_VIEW = 10, 25
_VIEW = VisibleRegion(np.array([1.5, 0.0]), -0.6, 0.6, 2.0, np.full(32, 40.0))


def _map(rng: np.random.Generator, count: int = _IN_VIEW) -> PoleMap:
    """Poles within the view from the origin."""
    bearing = rng.uniform(-0.5, 0.5, count)
    distance = rng.uniform(6.0, 36.0, count)
    points = np.stack([1.5 + distance * np.cos(bearing), distance * np.sin(bearing)], axis=1)
    return PoleMap(
        EarthFrame("local", name="benchmark"),
        np.arange(count),
        points,
        np.tile(np.eye(2) * 0.05**2, (count, 1, 1)),
        rng.uniform(0.1, 0.5, count),
        np.full(count, np.nan),
        np.ones(count, dtype=np.int64),
        np.ones(count, dtype=np.int64),
        np.ones(count),
    )


def _scan(
    stamp_s: float, world: PoleMap, pose: Floats, rng: np.random.Generator, seen: int = _SEEN
) -> Detections:
    rows = rng.choice(len(world), seen, replace=False)
    local = inverse_transform_points(pose, world.points_m[rows])
    return pole_detections(
        stamp_s,
        stamp_s,
        local + rng.normal(0, 0.1, local.shape),
        np.tile(np.eye(2) * 0.1**2, (seen, 1, 1)),
        width_m=world.width_m[rows] + rng.normal(0, 0.05, seen),
        probability=np.full(seen, 0.9),
        track_id=rows,
        view=_VIEW,
    )


def update_times(
    updates: int = 400,
    seed: int = 0,
    *,
    particles: int = 1000,
    seen: int = _SEEN,
    in_view: int = _IN_VIEW,
) -> list[float]:
    """Seconds of each full update at 22 Hz while creeping forward, so that the scene stays."""
    rng = np.random.default_rng(seed)
    world = _map(rng, in_view)
    config = LocalizeConfig(particles=particles)
    particle_filter = ParticleFilter(world, config, 2.7, np.random.default_rng(seed))
    particle_filter.set_pose(0.0, np.zeros(3), np.diag([0.2, 0.2, 0.001]))
    times, pose, interval, speed = [], np.zeros(3), 1.0 / 22.0, 0.3
    for k in range(1, updates + 1):
        stamp = k * interval
        pose[0] = speed * stamp
        scan = _scan(stamp, world, pose, rng, seen)
        begin = time.perf_counter()
        for step in (stamp - 0.5 * interval, stamp):
            particle_filter.add_odometry(OdometrySample(step, step, speed, 0.0))
        particle_filter.process_scan(scan)
        times.append(time.perf_counter() - begin)
    return times[50:]


def assignment_times(rounds: int = 15) -> dict[str, list[float]]:
    """Seconds for 1000 particles, in turn: the whole likelihood by the kernel; only the 1000
    assignments by the kernel; only these by a loop over scipy, which gets its costs for nothing.
    """
    rng = np.random.default_rng(1)
    world = _map(rng)
    landmarks, model = Landmarks.of(world, 0.7), PoleModel.of(LocalizeConfig())
    poses = rng.normal(0, [0.2, 0.2, 0.01], (1000, 3))
    scan = _scan(0.0, world, np.zeros(3), rng)
    costs = np.stack([-pair_gains(pose, scan, landmarks, model, _VIEW)[0] for pose in poses])
    work: dict[str, Callable[[], object]] = {
        "likelihood": lambda: pole_log_likelihood(poses, scan, landmarks, model, view=_VIEW),
        "assignment": lambda: assign(costs, 0.0),
        "assignment_scipy_loop": lambda: assign(costs, 0.0, backend="scipy"),
    }
    return interleaved(work, rounds)


def run() -> dict[str, dict[str, float]]:
    """Median, p95 and p99 of the update and of the assignment, the latter as a ratio too."""
    result = {
        f"particle_filter.{name}": summary(times, 99) for name, times in assignment_times().items()
    }
    loop = result["particle_filter.assignment_scipy_loop"]["median_ms"]
    for name in ("likelihood", "assignment"):
        figures = result[f"particle_filter.{name}"]
        figures["ratio_to_scipy_loop"] = figures["median_ms"] / loop
    result["particle_filter.update_1000"] = summary(update_times(), 99)
    return result


if __name__ == "__main__":
    print(json.dumps(run(), indent=2))
