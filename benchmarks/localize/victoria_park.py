"""Victoria Park, all real: how well the filter keeps to its trees, and to the road without them.

    python -m benchmarks.localize.victoria_park [SEEDS] [CASE,CASE...]

The map comes from lap `map`, the drive is lap `test`. Errors are those of positions against the
recording's reference, whose own standard deviation is 0.07 m, from 5 s after the start on. "Near"
is where at least three mapped trees stand within 30 m of the reference, "elsewhere" the rest, and
"lost" the longest time in a row more than 1 m off. Not timed, so `python -m benchmarks` leaves it
out.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from benchmarks.harness import RECORDINGS
from benchmarks.localize.particle_filter_recovery import A_THIRD_OF_THE_NOISE
from polemap.build.build_map import build_map
from polemap.config import PolemapConfig
from polemap.drivelog.detections import Detections
from polemap.drivelog.drive import Drive
from polemap.drivelog.jobs import LocalWorkers, in_order
from polemap.drivelog.readers.registry import open_drive
from polemap.localize.config import LocalizeConfig
from polemap.localize.replay import Run, replay
from polemap.map.pole_map import PoleMap
from polemap.perception import scan_drive
from polemap.vehicle.trajectory import Trajectory

Floats = NDArray[np.float64]

DRIVE = RECORDINGS / "victoria_park" / "drive"
NEAR_M, NEAR_TREES = 30.0, 3
SETTLED_S = 5.0
OFF_M = 1.0


@cache
def scans_of(lap: str) -> tuple[Detections, ...]:
    """The tracked trunks of a lap; they are recorded, so no seed changes them."""
    return tuple(scan_drive(open_drive(DRIVE).lap(lap), PolemapConfig()))


@cache
def map_of(lap: str) -> PoleMap:
    """The map that a lap makes."""
    return build_map(
        [open_drive(DRIVE).lap(lap)], PolemapConfig(), lambda _: list(scans_of(lap))
    ).pole_map


def drive_through(seed: int, pole_map: PoleMap | None, config: LocalizeConfig) -> tuple[Drive, Run]:
    """One replay of lap `test`."""
    drive = open_drive(DRIVE, seed=seed).lap("test")
    return drive, replay(drive, pole_map, scans_of("test"), config, seed=seed)


def errors(drive: Drive, track: Trajectory, pole_map: PoleMap, *, near: bool) -> tuple[Floats, ...]:
    """Stamps and position errors `(n,)` near trees, or elsewhere."""
    assert drive.reference is not None
    truth = drive.reference.at(track.stamp_s)[:, :2]
    known = np.isfinite(truth).all(axis=1) & (track.stamp_s > track.stamp_s[0] + SETTLED_S)
    trees = KDTree(pole_map.points_m).query_ball_point(
        np.nan_to_num(truth), NEAR_M, return_length=True
    )
    rows = known & ((trees >= NEAR_TREES) == near)
    return track.stamp_s[rows], np.hypot(*(track.poses[rows, :2] - truth[rows]).T)


def figures(stamps_s: Floats, error_m: Floats) -> dict[str, float]:
    """Median, mean, 95 % quantile and largest error in metres; the longest time lost in seconds."""
    lost_s, since_s = 0.0, None
    for stamp, error in zip(stamps_s, error_m, strict=True):
        since_s = (stamp if since_s is None else since_s) if error > OFF_M else None
        lost_s = max(lost_s, stamp - since_s) if since_s is not None else lost_s
    return {
        "median_m": float(np.median(error_m)),
        "mean_m": float(error_m.mean()),
        "p95_m": float(np.quantile(error_m, 0.95)),
        "max_m": float(error_m.max()),
        "lost_s": float(lost_s),
    }


Rows = dict[str, dict[str, float]]


def of_both(drive: Drive, run: Run, pole_map: PoleMap) -> Rows:
    """Both filters where trees are mapped."""
    return {
        f"near, {name}": figures(*errors(drive, track, pole_map, near=True))
        for name, track in (("particle filter", run.pf), ("output filter", run.kf))
    }


def near_trees(seed: int, config: LocalizeConfig, mapped: str) -> Rows:
    """The same, with a map of one of the laps and other settings."""
    drive, run = drive_through(seed, map_of(mapped), config)
    return of_both(drive, run, map_of(mapped))


@cache
def without_map() -> dict[str, float]:
    """GNSS and odometry alone, elsewhere: nothing in it is drawn, all seeds give the same."""
    drive, run = drive_through(0, None, LocalizeConfig())
    return figures(*errors(drive, run.kf, map_of("map"), near=False))


def held_out(seed: int) -> Rows:
    """Both filters near trees; elsewhere the output at 100 Hz, beside GNSS and odometry alone."""
    drive, run = drive_through(seed, map_of("map"), LocalizeConfig())
    rows = of_both(drive, run, map_of("map"))
    with_map = figures(*errors(drive, run.kf, map_of("map"), near=False))
    rows["elsewhere, output filter"] = with_map
    rows["elsewhere, GNSS and odometry"] = without_map()
    rows["elsewhere, the first less the second"] = {
        key: value - without_map()[key] for key, value in with_map.items()
    }
    return rows


def noise_a_third(seed: int) -> Rows:
    """The motion noise is stated at a third of the default."""
    return near_trees(seed, LocalizeConfig(**A_THIRD_OF_THE_NOISE), "map")


def same_drive(seed: int) -> Rows:
    """Map and test from one drive: the field's habit, for comparison only."""
    return near_trees(seed, LocalizeConfig(), "test")


CASES: dict[str, Callable[[int], Rows]] = {
    "held_out": held_out,
    "noise_a_third": noise_a_third,
    "same_drive": same_drive,
}


def main(seeds: int, names: list[str], workers: int = 2) -> int:
    """Print mean (least to most) of every figure over the seeds."""
    if not DRIVE.exists():
        print("skipped: the recording ../shared/data/victoria_park is not on this machine")
        return 0
    for case in names:
        rows = list(in_order(CASES[case], range(seeds), LocalWorkers(workers)))
        for kind in rows[0]:
            shown = []
            for key in rows[0][kind]:
                values = np.array([row[kind][key] for row in rows])
                shown.append(
                    f"{key} {values.mean():.3f} ({values.min():.3f} to {values.max():.3f})"
                )
            print(f"{case}, {seeds} seeds, {kind}: " + ", ".join(shown), flush=True)
    return 0


if __name__ == "__main__":
    chosen = sys.argv[2].split(",") if len(sys.argv) > 2 else list(CASES)
    sys.exit(main(int(sys.argv[1]) if len(sys.argv) > 1 else 20, chosen))
