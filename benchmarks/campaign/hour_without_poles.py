"""An hour without poles: how soon do the first ones bring the pose back?

`python -m benchmarks.campaign.hour_without_poles [SECONDS] [SEED...]`. A car in town, half a minute
of poles, then none for an hour of odometry and GNSS (2.5 m, Gauss-Markov), once with a detector
that looks and finds nothing (twice a second) and once with one that is off; then poles again. It
prints how far the output was off before, and after how long it is healthy and within half a metre.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from itertools import product

import numpy as np

from benchmarks.campaign.drives import TRUTH
from polemap.localize.config import LocalizeConfig
from polemap.localize.replay import replay
from polemap.simulate.config import DetectorConfig
from polemap.simulate.points.drive import PointScenario, gnss, simulate_points
from polemap.simulate.points.motion import CityTraffic, Slip

BEFORE_S, AFTER_S, RIGHT_M = 30.0, 40.0, 0.5
_NOTHING = np.empty(0, dtype=np.int64)


def one(seconds: float, seed: int, *, looks: bool) -> dict[str, float]:
    """One drive."""
    scenario = PointScenario(
        duration_s=BEFORE_S + seconds + AFTER_S,
        motion=CityTraffic(slip=Slip()),
        gnss=gnss(1.0),
        detector=DetectorConfig(rate_hz=11.0),
        reference=TRUTH,
    )
    points = simulate_points(scenario, np.random.default_rng([seed, 81]))
    end_s = BEFORE_S + seconds
    scans = []
    for number, scan in enumerate(points.scans):
        hidden = BEFORE_S <= scan.stamp_s < end_s
        if not hidden:
            scans.append(scan)
        elif looks and number % 5 == 0:
            scans.append(scan.take(_NOTHING))
    drive = replace(points.drive, scans=())
    run = replay(drive, points.pole_map, scans, LocalizeConfig(), seed=seed)
    reference = drive.reference
    assert reference is not None
    truth = reference.at(run.kf.stamp_s)
    error = np.hypot(*(run.kf.poses - truth)[:, :2].T)
    healthy = np.array([not why for why in run.distrust])
    stamps = run.kf.stamp_s
    blind = (stamps > end_s - min(600.0, 0.5 * seconds)) & (stamps < end_s)
    settled = healthy & (error <= RIGHT_M)
    rows = np.flatnonzero((stamps >= end_s) & (stamps < stamps[-1]) & settled)
    # from when on it is right for three seconds in a row
    back = next(
        (stamps[r] - end_s for r in rows if settled[r : r + 300].all() and r + 300 < len(stamps)),
        np.inf,
    )
    wrong = healthy & (error > 3.0)
    return {
        "before_p95_m": float(np.quantile(error[blind], 0.95)),
        "before_healthy": float(healthy[blind].mean()),
        "back_s": float(back),
        "wrong_and_healthy_s": float(wrong.sum() / 100.0),
    }


def main(seconds: float, seeds: list[int]) -> None:
    """Print a line a drive."""
    for seed, looks in product(seeds, (True, False)):
        row = one(seconds, seed, looks=looks)
        how = "looks" if looks else "is off"
        print(f"seed {seed}, the detector {how}:", row, flush=True)


if __name__ == "__main__":
    main(
        float(sys.argv[1]) if len(sys.argv) > 1 else 3600.0,
        [int(word) for word in sys.argv[2:]] or [0, 1, 2],
    )
