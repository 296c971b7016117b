"""A street with pictures: the driver drives it once, and the car is to come again by itself.

Between the two drives parked cars leave and others come, and the traffic is another.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path as FilePath

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from polemap.build.build_map import build_map
from polemap.build.slam.motion import MotionNoise
from polemap.build.slam.slam import solve_slam
from polemap.config import PolemapConfig
from polemap.drivelog.atomic import scratch_folder
from polemap.drivelog.drive import Drive, FrameSource
from polemap.drivelog.odometry_choice import with_odometry
from polemap.drivelog.readers.registry import open_drive
from polemap.drivelog.samples import Image
from polemap.electric.control.path import Path
from polemap.perception import scan_drive
from polemap.simulate.closed_loop.path_following import Course
from polemap.simulate.config import SimulateConfig
from polemap.simulate.drive import simulate_drive
from polemap.simulate.driver import STEP_S, Motion
from polemap.simulate.image_sensor import SENSOR
from polemap.simulate.scenario import Scenario, load_scenario
from polemap.simulate.sensors import gauss_markov
from polemap.simulate.studio import Plan, Studio, make_plan
from polemap.simulate.traffic import make_traffic
from polemap.simulate.world import World, make_world
from polemap.stereo.config import StereoConfig
from polemap.vehicle.pose import Pose2D

Floats = NDArray[np.float64]

# a street of 560 m whose bends can be driven at 50 km/h
_CORNERS_M = [(0.0, 0.0), (150.0, 14.0), (300.0, -34.0), (440.0, 6.0), (560.0, -10.0)]
_CORNER_RADIUS_M = 110.0
# of all places to park, taken in the first drive, and again in the second
_PARKED_SHARE, _PARKED_KEEP = 0.6, 0.9
# points along a reference's path for the controller, and how it is smoothed (sd)
_STEP_M, _SMOOTH_M, _ENDS_M = 0.5, 2.0, 6.0
_STEREO = StereoConfig(threads=1)


@dataclass(frozen=True, slots=True)
class TaughtStreet:
    """What one drive with a driver and a reference has taught, and the world of the next.

    Attributes:
        course: path of the driver's rear axle, and the map of the poles seen on it.
        solved: the same of the stereo camera and GNSS alone, without reference and wheels; None
            where it was not asked for.
        world: as it looks when the car comes again.
        config, seed: of the simulation, for the camera and all draws.
    """

    course: Course
    world: World
    config: SimulateConfig
    seed: int
    solved: Course | None = None

    @property
    def origin_m(self) -> Floats:
        """Of the world's metres in the map's frame."""
        scenario = self.world.scenario
        return np.array([scenario.origin_east_m, scenario.origin_north_m])

    def studio(self, speed_mps: float, duration_s: float, period_s: float) -> Studio:
        """Pictures of a drive at constant speed, at any pose; see `Studio.views_at`."""
        motion = _steady(self.world, speed_mps, duration_s)
        stamps = np.arange(0.0, duration_s + 1.0, period_s)
        rng = np.random.default_rng([self.seed, 33])
        bumps = gauss_markov(stamps, 0.0022, 0.3, rng, 2)
        exposure = gauss_markov(stamps, SENSOR.exposure_wander, 4.0, rng)[:, 0]
        plan = Plan(
            self.world.scenario, self.seed, self.config, 1, motion, stamps, stamps, bumps, exposure
        )
        movers = make_traffic(self.world, motion, np.random.default_rng([self.seed, 34]))
        return Studio(plan, self.world, 1, movers)


def street_scenario() -> Scenario:
    """The packaged suburb along gentler bends."""
    tree = load_scenario("suburb").model_dump(mode="json")
    tree["name"] = "street"
    tree["route"] = {
        "corners_m": _CORNERS_M, "corner_radius_m": _CORNER_RADIUS_M, "closed": False,
    }  # fmt: skip
    tree["drive"] |= {"speed_mps": 10.0, "evasions": 0.0}
    for row in tree["rows"]:
        if row["kind"].startswith("parked_"):
            row["keep"] = _PARKED_KEEP
    return Scenario.model_validate(tree)


def teach(
    seed: int,
    config: PolemapConfig | None = None,
    scenario: Scenario | None = None,
    *,
    solve: bool = False,
) -> TaughtStreet:
    """Drive a street once with pictures and a reference, and map it.

    Args:
        seed: of the world, the sensors and the traffic.
        config: of perception and map.
        scenario: an open street; `street_scenario` by default.
        solve: map it a second time from the same pictures and the fixes alone.

    Raises:
        MissingExtraError: `solve`, and gtsam is not installed.
    """
    config, simulated = config or PolemapConfig(), SimulateConfig()
    unlit = scenario or street_scenario()
    scenario = unlit.lit(simulated.light)
    every = make_world(scenario, seed)
    rng = np.random.default_rng([seed, 32])
    first, again = (make_world(scenario, seed, _left(every, rng)) for _ in range(2))
    plan = make_plan(first.route, scenario, 1, seed, simulated)
    with scratch_folder() as place:
        folder = simulate_drive(unlit, FilePath(place) / "drive", 1, seed, simulated, images=False)
        drive = _with_pictures(open_drive(folder), Studio(plan, first, 1))
        assert drive.reference is not None
        scans = scan_drive(drive, config, stereo=_STEREO)
        path, start = _path_of(drive.reference.poses)
        course = Course(path, build_map([drive], config, lambda _: scans).pole_map, start)
        solved = _solved(drive, course, config) if solve else None
    return TaughtStreet(course, again, simulated, seed, solved)


def _solved(drive: Drive, taught: Course, config: PolemapConfig) -> Course:
    """The course as the stereo camera and the fixes tell it."""
    blind = with_odometry(replace(drive, reference=None, odometry=None), "camera")
    scans = scan_drive(blind, config, stereo=_STEREO)
    result = solve_slam(
        [("taught", blind)], [scans], config.mapping, config.slam, MotionNoise(), drive.frame
    )
    known = replace(blind, frame=result.frame, reference=result.references[0])
    built = build_map([known], config, lambda _: scans, frame=result.frame)
    path, _ = _path_of(result.references[0].poses)
    pole_map = result.with_precision(built.pole_map)
    return Course(path, pole_map, taught.start, taught.path)


class _Pictures:
    """What a studio takes, kept in memory: more than one looks at it."""

    def __init__(self, studio: Studio, rows: NDArray[np.int64]) -> None:
        self._studio, self._rows = studio, rows
        self._taken: dict[int, tuple[Image, Image]] = {}

    def load(self, row: int) -> tuple[Image, Image]:
        """See `FrameSource`."""
        number = int(self._rows[row])
        if number not in self._taken:
            left, right = self._studio.picture(number)
            self._taken[number] = left.copy(), right.copy()
        return self._taken[number]

    def keep(self, rows: NDArray[np.int64]) -> FrameSource:
        """See `FrameSource`."""
        return _Pictures(self._studio, self._rows[rows])


def _with_pictures(drive: Drive, studio: Studio) -> Drive:
    plan = studio.plan
    numbers = np.arange(len(plan.frame_stamps_s))
    return replace(
        drive,
        rig=studio.renderer.rig,
        images=_Pictures(studio, numbers),
        frame_stamps_s=plan.frame_stamps_s,
        frame_arrivals_s=plan.frame_arrivals_s,
        frame_numbers=numbers,
    )


def _left(world: World, rng: np.random.Generator) -> frozenset[int]:
    """Parked cars that are not there this time."""
    parked = [one.owner for one in world.objects if one.kind.startswith("parked_")]
    away = rng.random(len(parked)) > _PARKED_SHARE
    return frozenset(np.array(parked, dtype=np.int64)[away].tolist())


def _path_of(poses: Floats) -> tuple[Path, Pose2D]:
    """A smooth path through poses `(n, 3)` of a drive, and the pose at its beginning."""
    way = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(poses[:, :2], axis=0).T))])
    station = np.arange(0.0, way[-1], _STEP_M)
    points = np.stack([np.interp(station, way, poses[:, k]) for k in (0, 1)], axis=1)
    smooth = gaussian_filter1d(points, _SMOOTH_M / _STEP_M, axis=0, mode="nearest")
    ends = round(_ENDS_M / _STEP_M)
    smooth = smooth[ends:-ends]
    step = smooth[1] - smooth[0]
    x, y = smooth[0].tolist()
    return Path(smooth), Pose2D(x, y, float(np.arctan2(step[1], step[0])))


def _steady(world: World, speed_mps: float, duration_s: float) -> Motion:
    """Along the lane at one speed: whom the car meets is planned by it."""
    stamps = np.arange(0.0, duration_s, STEP_S)
    lane = world.scenario.drive.lane_offset_m
    station = np.minimum(speed_mps * stamps + 2.0 * _ENDS_M, world.route.length_m - 1.0)
    still, level = np.zeros(len(stamps)), np.full(len(stamps), lane)
    speed = np.full(len(stamps), speed_mps)
    return Motion(
        stamps, world.route.at(station, lane), speed, still, still, still, still, level, still,
        station, np.array([0.0, stamps[-1]]),
    )  # fmt: skip
