"""Drives through a town of poles, as the map's tests need them: scans and a reference that errs.

The town has streets in a grid with lamps and trees on both sides, and a route through all of them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.detections import Detections, VisibleRegion
from polemap.drivelog.frames import EarthFrame
from polemap.drivelog.streams import ReferenceStream
from polemap.simulate.config import DetectorConfig
from polemap.simulate.points.drive import PointScenario, simulate_points
from polemap.simulate.points.motion import GivenPoses
from polemap.simulate.points.poles import Poles
from polemap.simulate.sensors import ReferenceErrors

Floats = NDArray[np.float64]
Town = Poles

FRAME = EarthFrame("utm", 32632)
ORIGIN = np.array([458000.0, 5_430_000.0])
# a stereo camera's: errors last over neighbouring frames, and grow with the square of the range
DETECTOR = DetectorConfig(
    rate_hz=10.0, half_view_rad=0.6, range_max_m=30.0, detected_share=0.85, clutter_share=0.1,
    bearing_sd_rad=0.003, correlated_share=1.0, latency_s=0.0,
)  # fmt: skip


BLOCK_M = 120.0
_SPACING_M = 24.0
_TWINS = 0.05  # share of poles with a close neighbour
_LEAST_GAP_M = 1.3


def town_poles(origin_m: Floats, blocks: int, rng: np.random.Generator) -> Poles:
    """Poles along the streets of a grid of `blocks` by `blocks`; they differ in how visible they
    are, and every twentieth has a close neighbour.

    Args:
        origin_m: `(2,)` south-west corner.
        blocks: along each side.
        rng: all randomness.
    """
    points = []
    length = blocks * BLOCK_M
    for street in range(blocks + 1):
        for side in (-6.0, 6.0):
            along = np.arange(0.5 * _SPACING_M, length - 8.0, _SPACING_M)
            along = along + rng.uniform(-6.0, 6.0, len(along))
            across = street * BLOCK_M + side + rng.uniform(-1.5, 1.5, len(along))
            points += [np.stack([along, across], 1), np.stack([across, along], 1)]
    every = np.concatenate(points)
    twins = every[rng.random(len(every)) < _TWINS]
    angle = rng.uniform(0, 2 * np.pi, len(twins))
    twins = twins + 1.6 * np.stack([np.cos(angle), np.sin(angle)], 1)
    every = _thinned(np.concatenate([every, twins]), _LEAST_GAP_M)
    n = len(every)
    return Poles(every + origin_m, rng.uniform(0.08, 0.5, n), rng.beta(6.0, 2.0, n))


def _thinned(points: Floats, least_m: float) -> Floats:
    kept: list[Floats] = []
    for point in points:
        if all(np.hypot(*(point - other)) >= least_m for other in kept):
            kept.append(point)
    return np.array(kept)


def town_route(origin_m: Floats, blocks: int, step_m: float = 1.0) -> Floats:
    """Poses `(n, 3)` through every street of the grid, there and back, every `step_m`."""
    length = blocks * BLOCK_M
    corners: list[tuple[float, float]] = []
    for k in range(blocks + 1):
        ends = [(0.0, k * BLOCK_M), (length, k * BLOCK_M)]
        corners += ends if k % 2 == 0 else ends[::-1]
    for k in range(blocks, -1, -1):
        ends = [(k * BLOCK_M, 0.0), (k * BLOCK_M, length)]
        corners += ends[::-1] if (blocks - k) % 2 == 0 else ends
    corners += corners[::-1]
    path = np.array(corners)
    path = path[np.concatenate([[True], np.linalg.norm(np.diff(path, axis=0), axis=1) > 1.0])]
    station = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))])
    s = np.arange(0.0, station[-1], step_m)
    xy = np.stack([np.interp(s, station, path[:, axis]) for axis in (0, 1)], axis=1)
    # corners are rounded over ten steps, so that a car can take them
    kernel = np.ones(11) / 11.0
    padded = np.pad(xy, ((5, 5), (0, 0)), mode="edge")
    xy = np.stack([np.convolve(padded[:, axis], kernel, mode="valid") for axis in (0, 1)], axis=1)
    heading = np.gradient(xy, axis=0)
    return np.column_stack([xy + origin_m, np.arctan2(heading[:, 1], heading[:, 0])])


def passing_things(poses: Floats, count: int, rng: np.random.Generator) -> Poles:
    """What looks like poles and stands near a path `(n, 3)` during one drive only: vans, say."""
    points = poses[rng.integers(0, len(poses), count), :2] + rng.uniform(-7, 7, (count, 2))
    return Poles(points, np.full(count, 0.15), np.full(count, 0.7))


@dataclass(frozen=True)
class DriveThrough:
    """What one drive recorded, and where the car really was."""

    scans: list[Detections]
    reference: ReferenceStream
    true_poses: Floats


def make_town(rng: np.random.Generator, blocks: int = 3) -> Town:
    return town_poles(ORIGIN, blocks, rng)


def route(blocks: int = 3) -> Floats:
    """Poses `(n, 3)` through every street, for 10 m/s at 10 Hz."""
    return town_route(ORIGIN, blocks)


def drive_through(
    town: Town,
    rng: np.random.Generator,
    *,
    start_s: float,
    poses: Floats | None = None,
    reference_sd_m: float = 0.05,
    reference_time_s: float = 20.0,
    shift_m: Floats | None = None,
    vans: int = 10,
) -> DriveThrough:
    """One drive over `poses` (the whole grid by default) from `start_s` on.

    `reference_sd_m` is an axis's, correlated over `reference_time_s`; `shift_m` `(2,)` is by how
    much the whole reference is off; `vans` stand there for this drive only.
    """
    poses = route() if poses is None else poses
    scenario = PointScenario(
        duration_s=0.1 * len(poses),
        motion=GivenPoses(poses),
        odometry=None,
        gnss=None,
        detector=DETECTOR,
        detector_error_time_s=0.3,
        reference=ReferenceErrors(reference_sd_m, reference_time_s, 0.001),
        reference_hz=10.0,
        start_s=start_s,
        frame=FRAME,
    )  # fmt: skip
    drive = simulate_points(scenario, rng, town.joined(passing_things(poses, vans, rng))).drive
    assert drive.reference is not None
    reference = drive.reference
    if shift_m is not None:
        offset = np.append(shift_m, 0.0)
        reference = replace(reference, poses=reference.poses + offset)
    return DriveThrough(list(drive.scans), reference, poses)


def passed(
    town: Town, poses: Floats, within_m: float = 20.0, observations: int = 5
) -> NDArray[np.bool_]:
    """Which poles a drive had in its field of view, near enough, often enough."""
    count = np.zeros(len(town), dtype=np.int64)
    view = VisibleRegion(np.array([1.5, 0.0]), -0.6, 0.6, 3.0, np.array([within_m]))
    for east, north, yaw in poses:
        offset = town.points_m - (east, north)
        c, s = np.cos(yaw), np.sin(yaw)
        local = np.stack(
            [c * offset[:, 0] + s * offset[:, 1], -s * offset[:, 0] + c * offset[:, 1]], axis=1
        )
        count += view.contains(local)
    return count >= observations
