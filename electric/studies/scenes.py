"""Simulated drives with known truth: a sine of steering before a camera, or with GPS."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from polemap.electric.config import EstimatorConfig
from polemap.electric.estimators.vision import vision_density
from polemap.electric.signals import SignalLog
from polemap.vehicle.discretize import van_loan, zero_order_hold
from polemap.vehicle.errors import VehicleError
from polemap.vehicle.parameters import Car
from polemap.vehicle.single_track import (
    combined_vision,
    lateral_acceleration_rows,
    schedule,
)

Floats = NDArray[np.float64]

KMH = 1.0 / 3.6
PATTERN_S = (0.020, 0.015, 0.010, 0.025)  # delays of successive pictures, W13

# The papers print no process noise and no steering; these are ours and serve all studies.
# No gates: the papers' filters as they are printed.
MISMATCH = EstimatorConfig(sideslip_walk_rad=0.02, yaw_rate_walk_radps=0.2, innovation_gate_sd=0.0)
MATCHED = EstimatorConfig(
    sideslip_walk_rad=0.0316, yaw_rate_walk_radps=0.316, innovation_gate_sd=0.0
)
GPS_NOISE = EstimatorConfig(
    innovation_gate_sd=0.0,
    sideslip_walk_rad=0.005,
    yaw_rate_walk_radps=0.05,
    course_sd_rad=0.003,
    acceleration_walk_mps=0.02,
    # roll in the accelerometer follows the steering, so its disturbance forgets as fast
    acceleration_disturbance_time_s=2.0,
)
GPS_STIFFNESS_NPRAD = (7000.0, 10000.0)  # real and nominal
ROLL_RAD_PER_MPS2, ACCELERATION_BIAS_MPS2 = 0.007, 0.1


GRAVITY_MPS2 = 9.81


@dataclass(frozen=True, slots=True)
class Scene:
    """A drive at constant speed, or at one that swings between two.

    Attributes:
        speed_mps: of the whole drive, or the lowest.
        duration_s: its length.
        steering_rad: amplitude of the sine.
        steering_hz: its frequency.
        delays_s: of the late sensor, taken in turn.
        period_s: of the late sensor.
        model_noise: whether the plant follows the filter's process noise; without it the drive
            is the model's own answer to the steering.
        top_speed_mps: the highest, reached each `swing_s`; None for a constant speed.
        swing_s: from lowest to lowest speed.
    """

    speed_mps: float
    duration_s: float = 12.0
    steering_rad: float = 0.1
    steering_hz: float = 0.5
    delays_s: tuple[float, ...] = (0.033,)
    period_s: float = 0.033
    model_noise: bool = True
    top_speed_mps: float | None = None
    swing_s: float = 8.0

    def speeds(self, stamps_s: Floats) -> Floats:
        """Speed `(n,)` at the stamps, m/s: a cosine between the lowest and the highest."""
        if self.top_speed_mps is None:
            return np.full(len(stamps_s), self.speed_mps)
        half = 0.5 * (self.top_speed_mps - self.speed_mps)
        turn = 2.0 * np.pi / self.swing_s
        return np.asarray(self.speed_mps + half * (1.0 - np.cos(turn * stamps_s)))


@dataclass(frozen=True, slots=True)
class Simulated:
    """A log and the truth behind it: `[beta, gamma, psi, y_l]` `(n, 4)`."""

    log: SignalLog
    truth: Floats


def drive_with_camera(
    plant: Car, scene: Scene, config: EstimatorConfig, rng: np.random.Generator
) -> Simulated:
    """A car before a straight lane: gyro at every step, late pictures."""
    truth, steering, stamps = _states(plant, scene, config, rng)
    n = len(stamps)
    yaw_rate = truth[:, 1] + config.gyro_sd_radps * rng.standard_normal(n)
    rows, arrivals = _captures(scene, config.step_s, n)
    heading, offset, arrival = (np.full(n, np.nan) for _ in range(3))
    heading[rows] = truth[rows, 2] + config.heading_sd_rad * rng.standard_normal(len(rows))
    offset[rows] = truth[rows, 3] + config.lateral_offset_sd_m * rng.standard_normal(len(rows))
    arrival[rows] = arrivals
    columns = {
        "road_wheel_angle_rad": steering,
        "yaw_rate_radps": yaw_rate,
        "vx_mps": scene.speeds(stamps),
        "heading_rad": heading,
        "lateral_offset_m": offset,
        "camera_arrival_s": arrival,
    }
    return Simulated(SignalLog(stamps, columns), truth)


def drive_with_gps(
    plant: Car,
    scene: Scene,
    config: EstimatorConfig,
    rng: np.random.Generator,
    *,
    roll_rad_per_mps2: float = 0.0,
    acceleration_bias_mps2: float = 0.0,
) -> Simulated:
    """The same car with GPS course and speed, accelerometers and the body's roll in them.

    The lateral accelerometer reads `ay + g sin(roll)`, roll proportional to ay, plus a bias.
    """
    truth, steering, stamps = _states(plant, scene, config, rng)
    n = len(stamps)
    speed_mps = scene.speeds(stamps)
    if scene.top_speed_mps is None:
        row, direct = lateral_acceleration_rows(plant, scene.speed_mps)
        ay = truth[:, :2] @ row + direct[0] * steering
    else:
        # v sin(beta) changes with the speed, too: ay = dvy/dt + gamma vx
        vy = speed_mps * np.sin(truth[:, 0])
        ay = np.gradient(vy, stamps) + truth[:, 1] * speed_mps * np.cos(truth[:, 0])
    rolled = ay + GRAVITY_MPS2 * np.sin(roll_rad_per_mps2 * ay) + acceleration_bias_mps2
    noise = config.acceleration_walk_mps / np.sqrt(config.step_s)
    vx, vy = speed_mps * np.cos(truth[:, 0]), speed_mps * np.sin(truth[:, 0])
    ax = np.gradient(vx, stamps) - truth[:, 1] * vy
    rows, arrivals = _captures(scene, config.step_s, n)
    course, speed, arrival = (np.full(n, np.nan) for _ in range(3))
    course[rows] = truth[rows, 0] + truth[rows, 2]
    course[rows] += config.course_sd_rad * rng.standard_normal(len(rows))
    speed[rows] = speed_mps[rows] + config.speed_sd_mps * rng.standard_normal(len(rows))
    arrival[rows] = arrivals
    wheel = speed_mps.copy()
    columns = {
        "road_wheel_angle_rad": steering,
        "yaw_rate_radps": truth[:, 1] + config.gyro_sd_radps * rng.standard_normal(n),
        "ax_mps2": ax + noise * rng.standard_normal(n),
        "ay_mps2": rolled + noise * rng.standard_normal(n),
        "vx_mps": wheel,
        "course_rad": course,
        "speed_mps": speed,
        "gnss_arrival_s": arrival,
        "sideslip_rad": truth[:, 0],
        "vy_mps": vy,
    }
    return Simulated(SignalLog(stamps, columns), truth)


def _states(
    plant: Car, scene: Scene, config: EstimatorConfig, rng: np.random.Generator
) -> tuple[Floats, Floats, Floats]:
    """Truth `(n, 4)`, steering `(n,)` and stamps `(n,)`."""
    if not scene.duration_s > 1.0:
        raise VehicleError(f"a scene of {scene.duration_s} s is too short, take 1 s at least")
    n = round(scene.duration_s / config.step_s) + 1
    stamps: Floats = np.asarray(np.arange(n) * config.step_s, dtype=np.float64)
    steering: Floats = scene.steering_rad * np.sin(2.0 * np.pi * scene.steering_hz * stamps)
    if scene.top_speed_mps is not None:
        return _varying(plant, scene, config, rng, steering, stamps)
    a, b = combined_vision(plant, scene.speed_mps)
    g, h = zero_order_hold(a, b, config.step_s)
    pushed = steering[:, None] * h[:, 0]
    if scene.model_noise:
        q = van_loan(a, np.diag(vision_density(config)), config.step_s)[1]
        values, vectors = np.linalg.eigh(q)
        root = vectors * np.sqrt(np.maximum(values, 0.0))
        pushed = pushed + rng.standard_normal((n, 4)) @ root.T
    truth = np.zeros((n, 4))
    for k in range(1, n):
        truth[k] = g @ truth[k - 1] + pushed[k - 1]
    return truth, np.asarray(steering), np.asarray(stamps, dtype=np.float64)


def _varying(
    plant: Car,
    scene: Scene,
    config: EstimatorConfig,
    rng: np.random.Generator,
    steering: Floats,
    stamps: Floats,
) -> tuple[Floats, Floats, Floats]:
    """`_states` where the speed changes: each step by the model of its own speed."""
    model = schedule(combined_vision, plant, vision_density(config), config.step_s)
    n = len(stamps)
    speeds = scene.speeds(stamps).tolist()
    drawn = rng.standard_normal((n, 4)) if scene.model_noise else np.zeros((n, 4))
    truth = np.zeros((n, 4))
    for k in range(1, n):
        g, h, q = model.at(speeds[k - 1])
        truth[k] = g @ truth[k - 1] + h[:, 0] * steering[k - 1]
        if scene.model_noise:
            values, vectors = np.linalg.eigh(q)
            truth[k] += vectors @ (np.sqrt(np.maximum(values, 0.0)) * drawn[k])
    return truth, steering, stamps


def _captures(scene: Scene, step_s: float, rows: int) -> tuple[NDArray[np.int64], Floats]:
    """Rows at which the late sensor measures, and when each value arrives."""
    every = round(scene.period_s / step_s)
    found = np.arange(every, rows, every)
    delays = np.array([scene.delays_s[i % len(scene.delays_s)] for i in range(len(found))])
    return found, found * step_s + np.round(delays / step_s) * step_s
