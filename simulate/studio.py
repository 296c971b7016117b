"""The pictures of a simulated drive: when each is taken, of what, and what it shows."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from os import cpu_count

import cv2
import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.jobs import LocalWorkers, in_order
from polemap.drivelog.samples import Image
from polemap.simulate import sensors
from polemap.simulate.camera_mounting import camera_poses
from polemap.simulate.config import SimulateConfig
from polemap.simulate.driver import Motion, drive_route
from polemap.simulate.image_sensor import SENSOR, expose, exposure_of, make_units
from polemap.simulate.render import Renderer, RenderOptions, View
from polemap.simulate.route import Route
from polemap.simulate.scenario import Scenario
from polemap.simulate.traffic import Mover, make_traffic, moving_mesh
from polemap.simulate.truth import to_disparity_png, to_owner_png
from polemap.simulate.world import World, make_world
from polemap.stereo.rig import rotation_from_angles

Floats = NDArray[np.float64]
_FEW = 24
# body angles per acceleration: about 3 degrees of pitch and 4.5 of roll a g
_PITCH_PER_MPS2, _ROLL_PER_MPS2 = 0.005, 0.008


@dataclass(frozen=True, slots=True)
class Shot:
    """A pair, and for the truth: disparity of both views and object ids of the left, uint16."""

    left: Image
    right: Image
    truth: tuple[NDArray[np.uint16], NDArray[np.uint16], NDArray[np.uint16]] | None = None


@dataclass(frozen=True, slots=True)
class Plan:
    """All of a simulated drive but its pictures; the same scenario and seed give the same plan."""

    scenario: Scenario
    seed: int
    config: SimulateConfig
    laps: int
    motion: Motion
    frame_stamps_s: Floats
    frame_arrivals_s: Floats
    body_rad: Floats
    exposure_log: Floats

    @property
    def origin_m(self) -> Floats:
        """The world's origin in the drive's frame."""
        return np.array([self.scenario.origin_east_m, self.scenario.origin_north_m])


def make_plan(
    route: Route, scenario: Scenario, laps: int, seed: int, config: SimulateConfig
) -> Plan:
    """Drives the route and decides when pictures are taken."""
    motion = drive_route(route, scenario.drive, laps, np.random.default_rng([seed, 20]))
    rng = np.random.default_rng([seed, 21])
    rate = config.camera.frame_rate_hz or scenario.drive.frame_rate_hz
    stamps, arrivals = sensors.frame_times(motion, rate, rng)
    bumps = sensors.gauss_markov(stamps, 0.0022, 0.3, rng, 2)
    bumps *= np.minimum(motion.value("speed_mps", stamps) / 5.0, 1.0)[:, None]
    wander = sensors.gauss_markov(stamps, SENSOR.exposure_wander, 4.0, rng)[:, 0]
    return Plan(scenario, seed, config, laps, motion, stamps, arrivals, bumps, wander)


@dataclass(frozen=True, slots=True)
class Moment:
    """Where the car is, and how its body leans, when a picture is taken.

    Attributes:
        stamp_s: the plan's time, by which traffic moves.
        pose: `(3,)` of the rear axle in the world's local metres.
        lateral_m: left of the route's centre line.
        street_yaw_rad: heading of the route there.
        acceleration_mps2, lateral_mps2: along and across the car.
        body_rad: `(2,)` roll and pitch by bumps.
    """

    stamp_s: float
    pose: Floats
    lateral_m: float
    street_yaw_rad: float
    acceleration_mps2: float
    lateral_mps2: float
    body_rad: Floats


class Studio:
    """Takes the pictures of a plan; every picture depends on the seed and its number alone.

    Args:
        plan: of the drive.
        world: what stands still.
        threads: of the renderer; 0 for as many as it likes.
        movers: what moves; drawn for the plan by default.
    """

    def __init__(
        self, plan: Plan, world: World, threads: int, movers: list[Mover] | None = None
    ) -> None:
        quality = plan.config.render
        options = RenderOptions(
            shadows=quality.shadows, shadow_rays=quality.shadow_rays, threads=threads
        )
        self.plan, self.world = plan, world
        self.renderer = Renderer(world, plan.config.camera.rig(), options)
        if movers is None:
            movers = make_traffic(world, plan.motion, np.random.default_rng([plan.seed, 30]))
        self._movers = movers
        rng = np.random.default_rng([plan.seed, 31])
        self._units = make_units(plan.config.camera, rng)
        tilt = np.deg2rad(plan.config.camera.calibration_error_deg) * rng.standard_normal(3)
        self._tilt = rotation_from_angles(*tilt)

    def views(self, number: int) -> tuple[View, View]:
        """What both cameras see in picture `number` of the plan."""
        plan = self.plan
        stamp = plan.frame_stamps_s[number : number + 1]
        speed, rate = (
            plan.motion.value(name, stamp)[0] for name in ("speed_mps", "yaw_rate_radps")
        )
        street = self.world.route.at(plan.motion.value("station_m", stamp))[0, 2]
        return self.views_at(
            Moment(
                float(stamp[0]),
                plan.motion.at(stamp)[0],
                float(plan.motion.value("lateral_m", stamp)[0]),
                float(street),
                float(plan.motion.value("acceleration_mps2", stamp)[0]),
                float(speed * rate),
                plan.body_rad[number],
            )
        )

    def views_at(self, moment: Moment) -> tuple[View, View]:
        """What both cameras see."""
        x, y, yaw = moment.pose
        section, lateral = self.world.section, moment.lateral_m
        slope, turned = np.arctan(section.slope_at(lateral)), yaw - moment.street_yaw_rad
        roll = slope * np.cos(turned) + _ROLL_PER_MPS2 * moment.lateral_mps2 + moment.body_rad[0]
        pitch = (
            -slope * np.sin(turned)
            - _PITCH_PER_MPS2 * moment.acceleration_mps2
            + moment.body_rad[1]
        )
        place = np.array([x, y, float(section.height_at(lateral))])
        rig = self.renderer.rig
        poses = camera_poses(rig, place, rotation_from_angles(yaw, pitch, roll), self._tilt)
        moving = moving_mesh(self._movers, self.world, moment.stamp_s)
        return self.renderer.pair(poses, moving)

    def picture(self, number: int, views: tuple[View, View] | None = None) -> tuple[Image, Image]:
        """The digital pair of picture `number`."""
        views = views or self.views(number)
        bits = self.plan.config.camera.bits
        gain = exposure_of(views[0].irradiance, float(self.plan.exposure_log[number]))
        left, right = (
            expose(
                view.irradiance, gain, unit, bits,
                np.random.default_rng([self.plan.seed, 40, number, side]),
            )
            for side, (view, unit) in enumerate(zip(views, self._units, strict=True))
        )  # fmt: skip
        return left, right

    def shot(self, number: int) -> Shot:
        """The pair, with its truth where the settings ask for it."""
        views = self.views(number)
        left, right = self.picture(number, views)
        if not self.plan.config.render.truth_images:
            return Shot(left, right)
        disparity = [to_disparity_png(self.renderer.true_disparity(view)) for view in views]
        return Shot(left, right, (disparity[0], disparity[1], to_owner_png(views[0].owner)))


_studio: Studio | None = None


def _open_studio(scenario: Scenario, laps: int, seed: int, config: SimulateConfig) -> None:
    global _studio
    cv2.setNumThreads(1)
    world = make_world(scenario, seed)
    _studio = Studio(make_plan(world.route, scenario, laps, seed, config), world, 1)


def _take(number: int) -> Shot:
    if _studio is None:
        raise RuntimeError("the worker was not opened")
    return _studio.shot(number)


def shots(plan: Plan, world: World) -> Iterator[Shot]:
    """All pairs of a plan in order, rendered by as many processes as the settings say."""
    count = len(plan.frame_stamps_s)
    workers = plan.config.render.workers or min(cpu_count() or 1, 8)
    if workers == 1 or count < _FEW:
        studio = Studio(plan, world, 1 if workers == 1 else 0)
        yield from map(studio.shot, range(count))
        return
    job = (plan.scenario, plan.laps, plan.seed, plan.config)
    yield from in_order(_take, range(count), LocalWorkers(workers, _open_studio, job))
