"""The particle filter behind the camera: simulated routes at 22 pairs a second, many seeds.

    python -m benchmarks.localize.worlds [SEEDS] [ROUTE[:WORLD] ...]

The routes are those of `report_routes`, WORLD is the seed of houses, trees, camera and sensors (0).
Every fourth frame of lap 1 makes the map; lap 2 is localized in it, once with all frames and 1000
particles, once with every second frame and 300. All is judged against the simulator's truth from
`SETTLED_S` after the first pose on. Frames are rendered and seen once, the seeds differ in the
filter. Not timed, so `python -m benchmarks` leaves it out.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.evaluate.report_routes import CORNERS_M, short_world
from polemap.build.build_map import build_map
from polemap.config import PolemapConfig
from polemap.drivelog.detections import Detections
from polemap.drivelog.drive import Drive
from polemap.drivelog.jobs import LocalWorkers, in_order
from polemap.drivelog.readers.registry import open_drive
from polemap.drivelog.samples import Image, StereoFrame
from polemap.evaluation.errors import nees, pose_errors
from polemap.localize.config import LocalizeConfig
from polemap.localize.replay import replay
from polemap.map.pole_map import PoleMap
from polemap.perception import PolePerception
from polemap.simulate.config import SimulateConfig
from polemap.simulate.drive import simulate_drive
from polemap.simulate.scenario import Scenario
from polemap.simulate.studio import Plan, Studio, make_plan
from polemap.simulate.world import World, make_world
from polemap.stereo.config import StereoConfig
from polemap.stereo.matching import DisparityPair, StereoMatcher, make_matcher
from polemap.vehicle.trajectory import Trajectory

Floats = NDArray[np.float64]

RATE_HZ = 22.0
MAP_EVERY = 4
SETTLED_S = 5.0
CASES: dict[str, tuple[int, dict[str, int]]] = {
    "22 Hz, 1000 particles": (1, {}),
    "11 Hz, 300 particles": (2, {"particles": 300}),
}
COLUMNS = (
    "lateral", "along", "yaw_deg", "nees", "largest", "kf_lateral", "kf_along", "kf_nees",
    "reinitialized",
)  # fmt: skip

_studio: tuple[Studio, StereoMatcher] | None = None


def scenario_of(route: str) -> Scenario:
    """The route of the evaluation, at the frame rate of the paper's camera."""
    tree = short_world(route).model_dump(mode="json")
    tree["drive"]["frame_rate_hz"] = RATE_HZ
    return Scenario.model_validate(tree)


def plan_of(route: str, seed: int) -> tuple[World, Plan]:
    """World and drive of two laps."""
    scenario, config = scenario_of(route), SimulateConfig()
    world = make_world(scenario.lit(config.light), seed)
    return world, make_plan(world.route, world.scenario, 2, seed, config)


def _open_studio(route: str, seed: int) -> None:
    global _studio
    cv2.setNumThreads(1)
    world, plan = plan_of(route, seed)
    studio = Studio(plan, world, 1)
    _studio = studio, make_matcher(StereoConfig(threads=1), studio.renderer.rig)


def _take(number: int) -> tuple[Image, Image, DisparityPair]:
    assert _studio is not None
    studio, matcher = _studio
    shot = studio.shot(number)
    return shot.left, shot.right, matcher.match(shot.left, shot.right)


def see(route: str, seed: int, drive: Drive, lap: int, every: int) -> list[Detections]:
    """The scans of a lap, from every n-th frame."""
    _, plan = plan_of(route, seed)
    span = drive.laps[lap]
    numbers = [
        n for n, s in enumerate(plan.frame_stamps_s) if span.start_s <= s < span.end_s
    ][::every]  # fmt: skip
    assert drive.odometry is not None
    perception, odometry = (
        PolePerception(SimulateConfig().camera.rig(), PolemapConfig()),
        drive.odometry,
    )
    row = int(np.searchsorted(odometry.stamp_s, span.start_s - 1.0))
    scans = []
    taken = in_order(_take, numbers, LocalWorkers(2, _open_studio, (route, seed)))
    for number, (left, right, disparity) in zip(numbers, taken, strict=True):
        stamp = float(plan.frame_stamps_s[number])
        while row < len(odometry) and odometry.stamp_s[row] <= stamp:
            perception.record_odometry(odometry.sample(row))
            row += 1
        arrival = float(plan.frame_arrivals_s[number])
        frame = StereoFrame(stamp, arrival, number, left, right)
        scans.append(perception.perceive(frame, disparity).scan)
    return scans


def map_of(drive: Drive, scans: list[Detections]) -> PoleMap:
    """The map of lap 1; at a quarter of the frames a pole is seen in fewer."""
    config = PolemapConfig()
    few = config.mapping.model_copy(update={"observations_min": 5})
    config = config.model_copy(update={"mapping": few})
    return build_map([drive.lap(drive.laps[0].name)], config, lambda _: scans).pole_map


def judge(
    folder: Path, pole_map: PoleMap, scans: list[Detections], changes: dict[str, int], seed: int
) -> list[float]:
    """Figures of one run, in the order of `COLUMNS`."""
    drive = open_drive(folder)
    table = np.genfromtxt(folder / "truth.csv", delimiter=",", names=True)
    lap = drive.lap(drive.laps[1].name)
    run = replay(lap, pole_map, scans, LocalizeConfig(**changes), seed=seed)
    particle, output = (_errors(track, table) for track in (run.pf, run.kf))
    lateral, along, yaw, consistency, largest = particle
    counts = run.counts
    again = float(counts.get("reinitializations", 0))
    return [
        lateral, along, yaw, consistency, largest, output[0], output[1], output[3], again
    ]  # fmt: skip


def _errors(track: Trajectory, table: NDArray[np.void]) -> tuple[float, ...]:
    stamps = track.stamp_s
    rows = stamps > stamps[0] + SETTLED_S
    true = np.column_stack(
        [
            np.interp(stamps[rows], table["stamp_s"], table["east_m"]),
            np.interp(stamps[rows], table["stamp_s"], table["north_m"]),
            np.interp(stamps[rows], table["stamp_s"], np.unwrap(table["yaw_rad"])),
        ]
    )
    error = pose_errors(track.poses[rows], true)
    along, lateral, yaw = np.sqrt((error**2).mean(axis=0)).tolist()
    assert track.covariance is not None
    consistency = nees(track.poses[rows], true, track.covariance[rows])
    largest = np.hypot(error[:, 0], error[:, 1]).max()
    return (
        lateral,
        along,
        float(np.degrees(yaw)),
        float(np.nanmean(consistency)) / 3.0,
        float(largest),
    )


def rows_of(place: str, seeds: int) -> Iterator[str]:
    """A line a case: mean, spread and worst over the seeds."""
    route, _, digits = place.partition(":")
    seed = int(digits or 0)
    with TemporaryDirectory() as name:
        folder = Path(name) / route
        simulate_drive(
            scenario_of(route), folder, 2, seed, SimulateConfig(), objects=True, images=False
        )
        drive = open_drive(folder)
        pole_map = map_of(drive, see(route, seed, drive, 0, MAP_EVERY))
        scans = see(route, seed, drive, 1, 1)
        for case, (every, changes) in CASES.items():
            run = partial(judge, folder, pole_map, scans[::every], changes)
            table = np.array(list(in_order(run, range(seeds), LocalWorkers(2))))
            figures = zip(
                COLUMNS, table.mean(axis=0), table.std(axis=0), table.max(axis=0), strict=True
            )
            yield f"{place} | {case} | {len(pole_map)} poles | " + " | ".join(
                f"{name} {mean:.3f} sd {sd:.3f} worst {worst:.3f}"
                for name, mean, sd, worst in figures
            )


def main(words: list[str]) -> None:
    """Print every route as it is done."""
    seeds = int(words[0]) if words else 20
    for place in words[1:] or list(CORNERS_M):
        for line in rows_of(place, seeds):
            print(line, flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
