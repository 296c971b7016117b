"""The whole stack in a loop: a simulated car steers along a path by the localizer's pose."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.samples import GnssFix, OdometrySample
from polemap.electric.control.path import StanleySettings, stanley_steer
from polemap.localize.config import LocalizeConfig
from polemap.localize.localizer import Localizer
from polemap.localize.particle_filter.estimate import PfEstimate
from polemap.simulate.closed_loop.cars import PASSENGER_CAR, plant_of
from polemap.simulate.closed_loop.road import Road, winding_road
from polemap.simulate.config import DetectorConfig
from polemap.simulate.detector import PoleDetector
from polemap.simulate.plant import REAR_LEFT, REAR_RIGHT, Plant, PlantInput, PlantState
from polemap.simulate.points.drive import GNSS, ODOMETRY, RECEIVER
from polemap.vehicle.packed import transform_point
from polemap.vehicle.parameters import Car
from polemap.vehicle.pose import Pose2D

Floats = NDArray[np.float64]
Source = Literal["truth", "filter", "raw"]

STEER_S, ODOMETRY_S, GNSS_S, SCAN_S = 0.01, 0.02, 0.2, 0.045
HANDOVER_S, PATIENCE_S, SETTLE_S = 6.0, 20.0, 3.0
LEFT_THE_ROAD_M = 3.0
SWING_M, SWING_S, SWINGS = 0.1, 2.0, 4
"""An oscillation: at least four successive swings of the lateral error of 0.1 m or more, each
within 2 s. The road's own bends take longer."""


@dataclass(frozen=True, slots=True)
class FollowScenario:
    """A drive along a winding road at constant speed.

    Attributes:
        source: what the car steers by: the true pose, the localizer's 100 Hz output, or the
            particle filter's last pose as it is.
        camera_delay_s: from a picture to the pose that comes of it; of the truth: its age.
    """

    speed_mps: float
    source: Source = "filter"
    camera_delay_s: float = 0.1
    duration_s: float = 45.0
    lateral_mps2: float = 2.0
    curvature_max_radpm: float = 0.02


@dataclass(frozen=True, slots=True)
class FollowRun:
    """A drive at 100 Hz; arrays `(n,)`, lateral errors of the front axle, left positive.

    `engaged_s` is when the car was handed over,
    nan if never; `driver_share` the share of the time since in which the localizer was not sure
    and the driver steered.
    """

    stamp_s: Floats
    lateral_m: Floats
    steer_rad: Floats
    engaged_s: float
    driver_share: float
    left_road: bool

    def scored(self) -> NDArray[np.bool_]:
        """From three seconds after the handover on."""
        return np.asarray(self.stamp_s >= self.engaged_s + SETTLE_S)

    def rms_m(self) -> float:
        """RMS of the lateral error."""
        return float(np.sqrt(np.mean(self.lateral_m[self.scored()] ** 2)))

    def largest_m(self) -> float:
        """Largest lateral error."""
        return float(np.abs(self.lateral_m[self.scored()]).max())

    def swings(self) -> int:
        """Longest row of successive quick swings; see `SWINGS`."""
        late = self.scored()
        return longest_swinging(self.stamp_s[late], self.lateral_m[late])

    def steer_rate_rms_radps(self) -> float:
        """How restless the wheel is."""
        rate = np.diff(self.steer_rad) / STEER_S
        return float(np.sqrt(np.mean(rate[self.scored()[1:]] ** 2)))


def longest_swinging(stamps_s: Floats, values: Floats) -> int:
    """Length of the longest row of swings of `SWING_M` or more that take `SWING_S` or less each."""
    turns: list[tuple[float, float]] = []
    best, worst = 0, 0
    low = high = (float(stamps_s[0]), float(values[0]))
    way = 0
    for stamp, value in zip(stamps_s.tolist(), values.tolist(), strict=True):
        if value > high[1]:
            high = (stamp, value)
        if value < low[1]:
            low = (stamp, value)
        if way >= 0 and high[1] - value >= SWING_M:
            turns.append(high)
            way, low = -1, (stamp, value)
        elif way <= 0 and value - low[1] >= SWING_M:
            turns.append(low)
            way, high = 1, (stamp, value)
    for (begin, _), (end, _) in pairwise(turns):
        worst = worst + 1 if end - begin <= SWING_S else 0
        best = max(best, worst)
    return best


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
    return _Drive(car, scenario, road, rngs[1:], config or LocalizeConfig()).run()


class _Drive:
    """State of a drive in progress."""

    def __init__(
        self,
        car: Car,
        scenario: FollowScenario,
        road: Road,
        rngs: list[np.random.Generator],
        config: LocalizeConfig,
    ) -> None:
        rng, seen, particles = rngs
        self._car, self._scenario, self._road, self._rng = road_car(car), scenario, road, rng
        self._parameters = plant_of(self._car, PASSENGER_CAR)
        self._plant = Plant(self._parameters)
        self._localizer = Localizer(
            road.pole_map, config, car.wheelbase_m, particles, processing_delay_s=0.0
        )
        detector = DetectorConfig(latency_s=scenario.camera_delay_s)
        self._detector = PoleDetector(road.poles.points_m, road.poles.width_m, detector, seen)
        self._raw: PfEstimate | None = None
        self._waiting: deque[tuple[float, Floats]] = deque()
        self._past: deque[tuple[float, Pose2D]] = deque()
        # what stays wrong over the whole drive, drawn once
        self._scale = 1.0 + ODOMETRY.speed_scale_sd * rng.standard_normal()
        self._bias = ODOMETRY.yaw_bias_sd_radps * rng.standard_normal()
        self._gnss_error = GNSS.wander_sd_m * rng.standard_normal(2)
        self._speed, self._yaw_rate = scenario.speed_mps, 0.0
        self._settings = StanleySettings(front_slip_rad_per_mps2=car.front_slip_rad_per_mps2)

    def run(self) -> FollowRun:
        state = self._start()
        rows: list[tuple[float, float, float]] = []
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
                true = self._road.path.locate(*self._front(rear), rear.yaw_rad, near)
                near = true.station_m
                rows.append((now, true.lateral_m, steer))
                if abs(true.lateral_m) > LEFT_THE_ROAD_M:
                    left = True
                    break
            push = 1.0 * self._parameters.mass_kg * (self._scenario.speed_mps - self._speed)
            torque = push * self._parameters.wheel_radius_m / 4.0
            state = self._plant.step(state, PlantInput(steer, (torque, torque, torque, torque)))
        stamps, lateral, steering = np.array(rows).T
        share = taken_back / max(1, int((stamps >= engaged).sum()))
        return FollowRun(stamps, lateral, steering, engaged, share, left)

    def _start(self) -> PlantState:
        start = Pose2D(*self._road.start.tolist())
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
            if self._scenario.source != "truth":
                self._localizer.add_sample(OdometrySample(now, now, self._speed, self._yaw_rate))
        if self._scenario.source == "truth":
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
            ticks["scan"] += SCAN_S
            self._waiting.append((now, np.array(rear)))
        while self._waiting and self._waiting[0][0] + self._scenario.camera_delay_s <= now + 1e-9:
            stamp, pose = self._waiting.popleft()
            scan = replace(self._detector.scan(stamp, pose), arrival_s=now)
            found = self._localizer.add_sample(scan)
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
        if pose is None or pose.pose_age_s > 1.0:
            return None
        return Pose2D(*pose.pose)

    def _steer(self, pose: Pose2D, state: PlantState, near: float, *, by_truth: bool) -> float:
        speed, rate = self._speed, self._yaw_rate
        if by_truth or self._scenario.source == "truth":
            speed, rate = state.vx_mps, state.yaw_rate_radps
        steer, _ = stanley_steer(
            self._road.path, pose, speed, rate, self._car.wheelbase_m, self._settings, near
        )
        return steer
