"""Drives, maps, scans and truth of the routes on which departures are compared."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache, partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from benchmarks.campaign.detector_faults import Faulty, Kind
from benchmarks.campaign.drives import STREET, case_of
from benchmarks.campaign.fault_kinds import KINDS
from benchmarks.departures.cases import Concern
from benchmarks.evaluate.report_routes import short_world
from benchmarks.harness import RECORDINGS
from benchmarks.localize.victoria_park import DRIVE as VICTORIA_PARK
from benchmarks.localize.victoria_park import NEAR_M, NEAR_TREES
from polemap.build.build_map import build_map
from polemap.drivelog.detections import Detections
from polemap.drivelog.drive import Drive
from polemap.drivelog.odometry_choice import with_odometry
from polemap.drivelog.readers.registry import open_drive
from polemap.map.io import read_map
from polemap.map.pole_map import PoleMap
from polemap.perception import scan_drive
from polemap.settings import Settings
from polemap.simulate.config import DetectorConfig, SimulateConfig
from polemap.simulate.drive import simulate_drive
from polemap.simulate.points.drive import simulate_points
from polemap.simulate.scenario import Scenario

Floats = NDArray[np.float64]

SIMULATED = ("park_loop", "avenue", "suburb")
KITTI = RECORDINGS / "kitti_odometry"
RATE_HZ = 11.0
"""Of the simulated detector: the paper's system came to 13.5 Hz."""


@dataclass(frozen=True, slots=True)
class Course:
    """A drive to localize.

    Attributes:
        drive: odometry and fixes.
        pole_map, scans: as the case's settings make them.
        truth: poses `(n, 3)` at stamps `(n,)`, NaN where they are not to be judged.
        faulty: the fault that is in it, if any.
    """

    drive: Drive
    pole_map: PoleMap
    scans: tuple[Detections, ...]
    truth: Callable[[Floats], Floats]
    faulty: Faulty | None = None


@dataclass(frozen=True, slots=True)
class Route:
    """Where a course comes from.

    Attributes:
        concerns: what can differ on it.
        course: by seed and settings; the seed is the world's where it is simulated.
        missing: the recording that it needs and that is not there.
    """

    concerns: tuple[Concern, ...]
    course: Callable[[int, Settings, Path], Course]
    missing: Path | None = None


def simulated(
    route: str, seed: int, settings: Settings, folder: Path, rate_hz: float = RATE_HZ
) -> Course:
    """Two laps past a detector without pictures; the second in the map of the first."""
    place = folder / f"{route}_{seed}"
    if not place.exists():
        config = SimulateConfig(detector=DetectorConfig(rate_hz=rate_hz))
        # what the drive folder lacks is written beside it, last
        simulate_drive(_scenario(route), place, 2, seed, config, objects=True, images=False,
                       scans=True)  # fmt: skip
    drive = open_drive(place)
    first, second = (drive.lap(lap.name) for lap in drive.laps)
    scans = scan_drive(first, settings.polemap)
    pole_map = build_map([first], settings.polemap, lambda _: scans).pole_map
    scans = scan_drive(second, settings.polemap)
    return Course(second, pole_map, tuple(scans), truth_of(place))


def truth_of(folder: Path) -> Callable[[Floats], Floats]:
    """Poses `(n, 3)` of a simulated drive's truth at stamps `(n,)`."""
    table = np.genfromtxt(folder / "truth.csv", delimiter=",", names=True)
    columns = [table["east_m"], table["north_m"], np.unwrap(table["yaw_rad"])]

    def truth(stamps_s: Floats) -> Floats:
        return np.column_stack([np.interp(stamps_s, table["stamp_s"], c) for c in columns])

    return truth


@cache
def _scenario(route: str) -> Scenario:
    return short_world(route)


def _victoria_park(seed: int, settings: Settings, folder: Path) -> Course:
    """Lap `test` in the map of lap `map`, judged where three trees stand near."""
    driven = open_drive(VICTORIA_PARK, seed=seed).lap("test")
    chosen = Settings(polemap=settings.polemap)
    pole_map, scans = _victoria_park_seen(chosen.model_dump_json())
    reference = driven.reference
    assert reference is not None

    def truth(stamps_s: Floats) -> Floats:
        poses = reference.at(stamps_s)
        places = np.nan_to_num(poses[:, :2])
        trees = KDTree(pole_map.points_m).query_ball_point(places, NEAR_M, return_length=True)
        poses[trees < NEAR_TREES] = np.nan
        return poses

    return Course(driven, pole_map, scans, truth)


@cache
def _victoria_park_seen(chosen: str) -> tuple[PoleMap, tuple[Detections, ...]]:
    """Map and scans by settings as JSON: recorded, so the same for every seed."""
    settings, drive = Settings.model_validate_json(chosen), open_drive(VICTORIA_PARK)
    mapped, driven = (drive.lap(name) for name in ("map", "test"))
    scans = scan_drive(mapped, settings.polemap)
    pole_map = build_map([mapped], settings.polemap, lambda _: scans).pole_map
    return pole_map, tuple(scan_drive(driven, settings.polemap))


def _kidnapped(seed: int) -> Faulty:
    """A car that is put 50 m ahead, unknown to its odometry."""
    scenario = replace(STREET, kidnap_s=18.0)
    return Faulty(case_of(simulate_points(scenario, np.random.default_rng([seed, 77]))), 18.0)


_NAMED = (
    "speed x 1.8 for 5 s", "speed 0 for 2 s, no poles", "silent for 5 s",
    "yaw rate other sign for 5 s", "no poles for 20 s", "fixes jump 30 m for 10 s",
    "fixes 60 m off from the start", "map 40 % out of date", "map doubled, 1 m off",
)  # fmt: skip
FAULTS: tuple[Kind, ...] = (_kidnapped, *(KINDS[name] for name in _NAMED))
# drives that the campaign does not use
_FIRST_DRIVE = 5000


def _faults(seed: int, settings: Settings, folder: Path) -> Course:
    """A drive of points with a fault in it: ten seeds have one of each kind."""
    faulty = FAULTS[seed % len(FAULTS)](_FIRST_DRIVE + seed)
    drive = faulty.case.drive
    assert drive.reference is not None
    return Course(drive, faulty.case.pole_map, faulty.case.scans, drive.reference.at, faulty)


@cache
def _kitti_drive() -> Drive:
    return with_odometry(open_drive(KITTI / "sequences" / "03"), "camera")


def _kitti_03(seed: int, settings: Settings, folder: Path) -> Course:
    """Real pictures in the LiDAR map, with the odometry of the cameras."""
    drive = replace(_kitti_drive(), gnss=open_drive(KITTI / "sequences" / "03", seed=seed).gnss)
    pole_map = read_map(KITTI / "poles" / "03.csv", drive.frame)
    chosen = Settings(stereo=settings.stereo, polemap=settings.polemap)
    assert drive.reference is not None
    scans = _kitti_scans(chosen.model_dump_json())
    return Course(drive, pole_map, scans, drive.reference.at)


@cache
def _kitti_scans(chosen: str) -> tuple[Detections, ...]:
    """Of the pictures, by settings as JSON: seen once for all seeds, which differ in fixes."""
    settings = Settings.model_validate_json(chosen)
    return tuple(scan_drive(_kitti_drive(), settings.polemap, stereo=settings.stereo))


_FILTERS: tuple[Concern, ...] = ("tracks", "particles", "output")
ROUTES: dict[str, Route] = {
    **{name: Route(_FILTERS, partial(simulated, name)) for name in SIMULATED},
    "faults": Route(("particles", "output"), _faults),
    "victoria_park": Route(
        _FILTERS, _victoria_park, None if VICTORIA_PARK.exists() else VICTORIA_PARK
    ),
    "kitti_03": Route(
        ("eye", *_FILTERS), _kitti_03, None if KITTI.exists() else KITTI
    ),
}  # fmt: skip
