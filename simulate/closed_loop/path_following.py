"""The whole stack in a loop: a simulated car steers along a path by the localizer's pose."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, replace
from math import nan
from time import process_time
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.samples import GnssFix, OdometrySample
from polemap.electric.control.path import Path, StanleySettings, stanley_steer
from polemap.localize.config import LocalizeConfig
from polemap.localize.localizer import Localizer
from polemap.localize.particle_filter.estimate import PfEstimate
from polemap.map.pole_map import PoleMap
from polemap.simulate.closed_loop.cars import PASSENGER_CAR, plant_of
from polemap.simulate.closed_loop.eyes import DetectorEye, Eye
from polemap.simulate.closed_loop.follow_run import STEER_S, FollowRun
from polemap.simulate.closed_loop.road import winding_road
from polemap.simulate.config import DetectorConfig
from polemap.simulate.detector import PoleDetector
from polemap.simulate.plant import REAR_LEFT, REAR_RIGHT, Plant, PlantInput, PlantState
from polemap.simulate.points.drive import GNSS, ODOMETRY, RECEIVER
from polemap.vehicle.packed import rotate_back, transform_point
from polemap.vehicle.parameters import Car
from polemap.vehicle.pose import Pose2D, wrap_angle

Floats = NDArray[np.float64]
Source = Literal["truth", "filter", "raw"]

ODOMETRY_S, GNSS_S, SCAN_S = 0.02, 0.2, 0.045
HANDOVER_S, PATIENCE_S = 6.0, 20.0
LEFT_THE_ROAD_M = 3.0


@dataclass(frozen=True, slots=True)
class FollowScenario:
    """A drive along a winding road at constant speed.

    Attributes:
        source: what the car steers by: the true pose, the localizer's 100 Hz output, or the
            particle filter's last pose as it is.
        camera_delay_s: from a picture to the pose that comes of it; of the truth: its age.
        healthy_only: whether the driver takes over while the output calls itself unhealthy, too.
    """

    speed_mps: float
    source: Source = "filter"
    camera_delay_s: float = 0.1
    duration_s: float = 45.0
    lateral_mps2: float = 2.0
    curvature_max_radpm: float = 0.02
    healthy_only: bool = False


def road_car(car: Car) -> Car:
    """A car with typical wheels and brakes where its file says nothing of them."""
    return replace(
        car,
        rear_track_m=car.rear_track_m or 1.55,
        wheel_radius_m=car.wheel_radius_m or 0.31,
        motor_torque_limit_nm=car.motor_torque_limit_nm or 1000.0,
    )


def follow_path(
    car: Car, scenario: FollowScenario, seed: int, config: LocalizeConfig | None = None
) -> FollowRun:
    """Drive once.

    The driver steers by the truth until the localizer is sure of itself, then hands over. The
    drive ends early where the car leaves the road.
    """
    # a generator for each, so that drives of one seed differ by nothing but what is compared
    rngs = [np.random.default_rng([seed, part]) for part in range(4)]
    bends = min(scenario.lateral_mps2 / scenario.speed_mps**2, scenario.curvature_max_radpm)
    length = scenario.speed_mps * (scenario.duration_s + 2.0) + 60.0
    road = winding_road(length, bends, rngs[0])
    detector = PoleDetector(
        road.poles.points_m,
        road.poles.width_m,
        DetectorConfig(latency_s=scenario.camera_delay_s),
        rngs[2],
    )
    sees = scenario.source != "truth"
    eye = DetectorEye(detector, scenario.camera_delay_s) if sees else None
    course = Course(road.path, road.pole_map, Pose2D(*road.start.tolist()))
    return PathDrive(car, scenario, course, eye, (rngs[1], rngs[3]), config).run()


@dataclass(frozen=True, slots=True)
class Course:
    """What a car is to drive by.

    Attributes:
        path: to follow, in the map's frame.
        pole_map: to know where it is.
        start: true pose that the car starts from.
        true_path: what `path` is in truth, where map and path were made without a reference: the
            driver follows it, and errors are counted from it. None: `path` is true.
    """

    path: Path
    pole_map: PoleMap
    start: Pose2D
    true_path: Path | None = None


class PathDrive:
    """A drive in progress.

    Args:
        car: its plant is that of `road_car`.
        scenario: speed, length, and what the car steers by.
        course: where it goes.
        eye: sees the poles; None where the car steers by the truth.
        rngs: of odometry and GNSS, and of the particles.
        config: of the localizer.
        scan_s: time between pictures.
    """

    def __init__(
        self,
        car: Car,
        scenario: FollowScenario,
        course: Course,
        eye: Eye | None,
        rngs: tuple[np.random.Generator, np.random.Generator],
        config: LocalizeConfig | None = None,
        *,
        scan_s: float = SCAN_S,
    ) -> None:
        self._rng, particles = rngs
        rng = self._rng
        self._car, self._scenario, self._course, self._eye = road_car(car), scenario, course, eye
        self._scan_s = scan_s
        self._true_path = course.true_path or course.path
        self._parameters = plant_of(self._car, PASSENGER_CAR)
        self._plant = Plant(self._parameters)
        self._localizer = Localizer(
            course.pole_map,
            config or LocalizeConfig(),
            car.wheelbase_m,
            particles,
            processing_delay_s=0.0,
        )
        self._raw: PfEstimate | None = None
        self._past: deque[tuple[float, Pose2D]] = deque()
        # what stays wrong over the whole drive, drawn once
        self._scale = 1.0 + ODOMETRY.speed_scale_sd * rng.standard_normal()
        self._bias = ODOMETRY.yaw_bias_sd_radps * rng.standard_normal()
        self._gnss_error = GNSS.wander_sd_m * rng.standard_normal(2)
        self._speed, self._yaw_rate = scenario.speed_mps, 0.0
        self._settings = StanleySettings(front_slip_rad_per_mps2=car.front_slip_rad_per_mps2)

    def run(self) -> FollowRun:
        """Drive; ends early where the car leaves the road, or was never handed over."""
        state = self._start()
        rows: list[tuple[float, ...]] = []
        engaged, near, steer, left, taken_back = float("nan"), 0.0, 0.0, False, 0
        ticks = {"odometry": 0.0, "gnss": 0.05, "scan": 0.5, "steer": 0.0}
        for k in range(round(self._scenario.duration_s / self._plant.step_s)):
            now = k * self._plant.step_s
            state = replace(state, time_s=now)
            self._sense(now, state, ticks)
            if now >= ticks["steer"] - 1e-9:
                ticks["steer"] += STEER_S
                rear = self._rear(state)
                believed = self._believed(now, rear)
                if engaged != engaged and now >= HANDOVER_S and believed is not None:
                    engaged = now
                if engaged != engaged and now > PATIENCE_S:
                    break
                used = believed if engaged == engaged and believed is not None else rear
                taken_back += engaged == engaged and believed is None
                steer = self._steer(used, state, near, by_truth=used is rear)
                true = self._true_path.locate(*self._front(rear), rear.yaw_rad, near)
                near = true.station_m
                rows.append((now, true.lateral_m, steer, *_error(believed, rear)))
                if abs(true.lateral_m) > LEFT_THE_ROAD_M:
                    left = True
                    break
            push = 1.0 * self._parameters.mass_kg * (self._scenario.speed_mps - self._speed)
            torque = push * self._parameters.wheel_radius_m / 4.0
            state = self._plant.step(state, PlantInput(steer, (torque, torque, torque, torque)))
        table = np.array(rows)
        stamps, lateral, steering = table[:, :3].T
        share = taken_back / max(1, int((stamps >= engaged).sum()))
        return FollowRun(stamps, lateral, steering, engaged, share, left, table[:, 3:])

    def _start(self) -> PlantState:
        start = self._course.start
        east, north = transform_point(start, self._parameters.rear_m + 2.0, 0.0)
        rolling = self._plant.rolling(self._scenario.speed_mps)
        return replace(rolling, east_m=east, north_m=north, yaw_rad=start.yaw_rad)

    def _rear(self, s: PlantState) -> Pose2D:
        middle = (s.east_m, s.north_m, s.yaw_rad)
        return Pose2D(*transform_point(middle, -self._parameters.rear_m, 0.0), s.yaw_rad)

    def _front(self, rear: Pose2D) -> tuple[float, float]:
        return transform_point(rear, self._car.wheelbase_m, 0.0)

    def _sense(self, now: float, state: PlantState, ticks: dict[str, float]) -> None:
        rng = self._rng
        if now >= ticks["odometry"] - 1e-9:
            ticks["odometry"] += ODOMETRY_S
            spin = 0.5 * (state.wheel_radps[REAR_LEFT] + state.wheel_radps[REAR_RIGHT])
            self._speed = float(
                self._scale * self._parameters.wheel_radius_m * spin
                + ODOMETRY.speed_noise_sd_mps * rng.standard_normal()
            )
            self._yaw_rate = float(
                state.yaw_rate_radps
                + self._bias
                + ODOMETRY.yaw_noise_sd_radps * rng.standard_normal()
            )
            if self._eye is not None:
                sample = OdometrySample(now, now, self._speed, self._yaw_rate)
                if not self._eye.measures_motion:
                    self._localizer.add_sample(sample)
                    self._eye.record_odometry(sample)
        if self._eye is None:
            return
        rear = self._rear(state)
        if now >= ticks["gnss"] - 1e-9:
            ticks["gnss"] += GNSS_S
            keep = np.exp(-GNSS_S / RECEIVER.wander_time_s)
            kick = GNSS.wander_sd_m * np.sqrt(1.0 - keep**2) * rng.standard_normal(2)
            self._gnss_error = keep * self._gnss_error + kick
            x, y = (self._gnss_error + RECEIVER.noise_sd_m * rng.standard_normal(2)).tolist()
            self._localizer.add_sample(GnssFix(now, now, rear.x_m + x, rear.y_m + y, 1.0))
        if now >= ticks["scan"] - 1e-9:
            ticks["scan"] += self._scan_s
            self._eye.look(now, rear, state)
        for sample in self._eye.motion(now):
            self._localizer.add_sample(sample)
        for scan in self._eye.scans(now):
            begin = process_time()
            found = self._localizer.add_sample(scan)
            self._eye.localized(process_time() - begin)
            self._raw = found if found is not None else self._raw

    def _believed(self, now: float, rear: Pose2D) -> Pose2D | None:
        """The pose to steer by; None while the localizer is not sure."""
        if self._scenario.source == "truth":
            self._past.append((now, rear))
            while len(self._past) > 1 and self._past[1][0] <= now - self._scenario.camera_delay_s:
                self._past.popleft()
            return self._past[0][1]
        if self._scenario.source == "raw":
            ready = self._raw is not None and self._raw.healthy
            return Pose2D(*self._raw.pose.tolist()) if self._raw is not None and ready else None
        pose = self._localizer.pose_at(now)
        if pose is None or pose.pose_age_s > 1.0 or (self._scenario.healthy_only and pose.distrust):
            return None
        return Pose2D(*pose.pose)

    def _steer(self, pose: Pose2D, state: PlantState, near: float, *, by_truth: bool) -> float:
        speed, rate, path = self._speed, self._yaw_rate, self._course.path
        if by_truth or self._scenario.source == "truth":
            speed, rate, path = state.vx_mps, state.yaw_rate_radps, self._true_path
        steer, _ = stanley_steer(
            path, pose, speed, rate, self._car.wheelbase_m, self._settings, near
        )
        return steer


def _error(believed: Pose2D | None, true: Pose2D) -> tuple[float, float, float]:
    """Of a pose, along and to the left of the true one, and in yaw; nan where there is none."""
    if believed is None:
        return (nan, nan, nan)
    x, y = rotate_back(believed.x_m - true.x_m, believed.y_m - true.y_m, true.yaw_rad)
    return x, y, float(wrap_angle(believed.yaw_rad - true.yaw_rad))
