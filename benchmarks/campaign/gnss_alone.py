"""Hours on GNSS and odometry alone: circle, figure-eight, town route.

`python -m benchmarks.campaign.gnss_alone [HOURS] [SEED...]` prints position errors and the NEES per
degree of freedom of the output at 1 Hz, from the second minute on.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.jobs import LocalWorkers, in_order
from polemap.drivelog.samples import GnssFix, OdometrySample
from polemap.evaluation.errors import nees
from polemap.localize.config import LocalizeConfig
from polemap.localize.localizer import Localizer
from polemap.simulate.sensors import gauss_markov
from polemap.vehicle.pose import wrap_angle

Floats = NDArray[np.float64]

STEP_S = 0.02
ROUTES = ("circle", "figure-eight", "town")


@dataclass(frozen=True, slots=True)
class Way:
    """Truth every `STEP_S`: speed and yaw rate `(n,)`, poses `(n, 3)`."""

    speed_mps: Floats
    yaw_rate_radps: Floats
    poses: Floats


def way(route: str, hours: float, rng: np.random.Generator) -> Way:
    """A circle of 100 m at 10 m/s, two of them as an eight, or a town's blocks with stops."""
    count = round(hours * 3600.0 / STEP_S)
    if route == "town":
        speed, curvature = _town(count, rng)
    else:
        speed = np.full(count, 10.0)
        lap = 2.0 * np.pi * 100.0 / 10.0
        side = np.where((np.arange(count) * STEP_S // lap) % 2 == 0, 1.0, -1.0)
        curvature = 0.01 * (side if route == "figure-eight" else np.ones(count))
    rate = speed * curvature
    yaw = np.concatenate([[0.3], 0.3 + np.cumsum(rate[:-1]) * STEP_S])
    middle = yaw + 0.5 * rate * STEP_S
    steps = STEP_S * speed[:, None] * np.stack([np.cos(middle), np.sin(middle)], axis=1)
    place = np.concatenate([np.zeros((1, 2)), np.cumsum(steps[:-1], axis=0)])
    return Way(speed, rate, np.column_stack([place, wrap_angle(yaw)]))


def _town(count: int, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Blocks of 80 to 250 m, corners of 10 to 25 m radius, a stop of up to 30 s at every third."""
    speed, curvature = np.empty(count), np.zeros(count)
    row, v = 0, 0.0
    while row < count:
        cruise, rest = rng.uniform(8.0, 15.0), rng.uniform(80.0, 250.0)
        stop = rng.uniform() < 0.33
        bend = rng.choice([-1.0, 1.0, 0.0]) / rng.uniform(10.0, 25.0)
        slow = 0.0 if stop else 6.0
        while rest > 0.0 and row < count:
            limit = np.sqrt(slow**2 + 2.0 * 1.5 * rest)
            v = min(v + 1.5 * STEP_S, cruise, max(limit, 0.3))
            speed[row], rest, row = v, rest - v * STEP_S, row + 1
        if stop:
            wait = min(round(rng.uniform(2.0, 30.0) / STEP_S), count - row)
            speed[row : row + wait], v, row = 0.0, 0.0, row + wait
        turn = 0.5 * np.pi
        while bend and turn > 0.0 and row < count:
            v = min(v + 1.5 * STEP_S, 6.0)
            speed[row], curvature[row] = v, bend
            turn, row = turn - abs(bend) * v * STEP_S, row + 1
    return speed, curvature


def samples(
    true: Way, rng: np.random.Generator, sd_m: float = 2.5, time_s: float = 60.0
) -> list[tuple[float, int, OdometrySample | GnssFix]]:
    """Odometry at 50 Hz and fixes at 1 Hz, in time order."""
    count = len(true.speed_mps)
    scale, bias = 1.0 + 0.01 * rng.standard_normal(), 0.001 * rng.standard_normal()
    moving = true.speed_mps > 0.0
    speed = true.speed_mps * scale + 0.05 * rng.standard_normal(count) * moving
    rate = true.yaw_rate_radps + bias + 0.002 * rng.standard_normal(count)
    stamps: Floats = np.asarray(STEP_S * np.arange(count), dtype=np.float64)
    rows: list[tuple[float, int, OdometrySample | GnssFix]] = [
        (t, 0, OdometrySample(t, t, v, w))
        for t, v, w in zip(stamps.tolist(), speed.tolist(), rate.tolist(), strict=True)
    ]
    every = round(1.0 / STEP_S)
    at = true.poses[::every, :2]
    fixes = np.asarray(at, dtype=np.float64) + gauss_markov(stamps[::every], sd_m, time_s, rng, 2)
    rows += [
        (t, 1, GnssFix(t, t, x, y, 1.0))
        for t, (x, y) in zip(stamps[::every].tolist(), fixes.tolist(), strict=True)
    ]
    rows.sort(key=lambda row: row[:2])
    return rows


def alone(job: tuple[str, int, float, float]) -> dict[str, float]:
    """One route with one seed, through the live interface."""
    route, seed, hours, time_s = job
    rng = np.random.default_rng([seed, 79])
    true = way(route, hours, rng)
    localizer = Localizer(None, LocalizeConfig(), 2.7, np.random.default_rng(seed))
    stamps, poses, covariance, healthy, states = [], [], [], [], []
    due = 1.0
    for stamp, _, sample in samples(true, rng, time_s=time_s):
        if stamp >= due:
            answer = localizer.pose_at(due)
            due += 1.0
            if answer is not None:
                stamps.append(answer.stamp_s)
                poses.append(answer.pose)
                covariance.append(answer.covariance)
                healthy.append(answer.healthy)
                states.append(localizer._filter.newest.mean[3:])
        localizer.add_sample(sample)
    t, p, c = np.array(stamps), np.array(poses), np.array(covariance)
    keep = t > 120.0
    truth = true.poses[np.round(t / STEP_S).astype(int)]
    error = np.hypot(*(p - truth)[keep, :2].T)
    consistency = nees(p[keep], truth[keep], c[keep]) / 3.0
    sd = np.sqrt(np.linalg.eigvalsh(c[keep][:, :2, :2])[:, 1])
    yaw = np.degrees(np.abs(wrap_angle((p - truth)[keep, 2])))
    return {
        "seed": seed, "p50_m": float(np.median(error)), "p95_m": float(np.quantile(error, 0.95)),
        "max_m": float(error.max()), "nees": float(consistency.mean()), "sd_m": float(sd.mean()),
        "yaw_p95_deg": float(np.quantile(yaw, 0.95)),
        "yaw_sd_deg": float(np.degrees(np.sqrt(c[keep][:, 2, 2])).mean()),
        "healthy": float(np.mean(healthy)),
        "scale": float(np.array(states)[-1, 2]), "offset": float(np.array(states)[-1, 3]),
    }  # fmt: skip


def main(hours: float, seeds: list[int], time_s: float = 60.0) -> None:
    jobs = [(route, seed, hours, time_s) for route, seed in product(ROUTES, seeds)]
    for job, row in zip(jobs, in_order(alone, jobs, LocalWorkers(2)), strict=True):
        print(job[0], {k: round(v, 4) for k, v in row.items()}, flush=True)


if __name__ == "__main__":
    words = sys.argv[1:]
    main(
        float(words[0]) if words else 4.0,
        [int(w) for w in words[1:] if "tau" not in w] or [0],
        next((float(w[4:]) for w in words if w.startswith("tau=")), 60.0),
    )
