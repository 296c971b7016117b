"""Drives through a town of poles, as the map's tests need them: scans and a reference that errs."""

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
from polemap.simulate.points.poles import Poles, passing_things
from polemap.simulate.points.town import town_poles, town_route
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
