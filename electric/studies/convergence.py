"""How fast the camera filters forget an error, and how much they jump: no delay, steady gains."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from polemap.electric.config import EstimatorConfig
from polemap.electric.estimators.base import CAMERA, YAW_RATE, Inputs
from polemap.electric.estimators.compensated import PSEUDO_INVERSE, steady_gain
from polemap.electric.estimators.registry import make_estimator
from polemap.electric.estimators.vision import ALL_ROWS, SEEN, vision_density
from polemap.electric.studies.scenes import Simulated
from polemap.vehicle.parameters import Car
from polemap.vehicle.single_track import combined_vision, schedule

Floats = NDArray[np.float64]
GYRO = ALL_ROWS[:1]


def frame_radii(car: Car, config: EstimatorConfig, speed_mps: float) -> dict[str, float]:
    """Spectral radius of the error over one camera frame.

    `ideal` measures everything at every step; `compensated` gets pictures once a frame and
    propagates their residual; `switching` is the Kalman filter without compensation.
    """
    model = schedule(combined_vision, car, vision_density(config), config.step_s)
    g, _, q = model.exact(speed_mps)
    q = q + np.diag([0.0, 0.0, 1e-14, 1e-14])
    n = max(1, round(config.camera_period_s / config.step_s))
    gain, _ = steady_gain(g, q, config)
    ideal = np.linalg.matrix_power((np.eye(4) - gain @ ALL_ROWS) @ g, n)
    return {
        "radius_ideal": _radius(ideal),
        "radius_compensated": _radius(compensated_frame(g, gain, n)),
        "radius_switching": _radius(_switching_frame(g, q, config, n)),
    }


def compensated_frame(g: Floats, gain: Floats, steps: int) -> Floats:
    """Error `(4, 4)` from just before one picture to just before the next.

    State `[x error, e]`; the picture starts e, the yaw rate corrects at every step.
    """
    eye, keep = np.eye(4), np.eye(4) - gain @ ALL_ROWS
    start = np.vstack([keep, (PSEUDO_INVERSE - gain) @ ALL_ROWS])
    gyro, camera = gain[:, :1] @ GYRO, gain[:, 1:] @ SEEN
    between = np.block([[(eye - gyro) @ g, -camera @ g], [np.zeros((4, 4)), keep @ g]])
    # the picture's own step closes the frame: predicted, not yet corrected
    last = np.hstack([g, np.zeros((4, 4))])
    return np.asarray(last @ np.linalg.matrix_power(between, steps - 1) @ start)


def _switching_frame(g: Floats, q: Floats, config: EstimatorConfig, n: int) -> Floats:
    gyro_noise = np.array([[config.gyro_sd_radps**2]])
    camera_noise = np.diag([config.heading_sd_rad**2, config.lateral_offset_sd_m**2])
    p, error = np.eye(4) * 1e-2, np.eye(4)
    for step in range(400 * n):
        if step >= 399 * n and step % n == 0:
            error = np.eye(4)
        p = g @ p @ g.T + q
        error = g @ error
        rows = [(GYRO, gyro_noise)]
        if step % n == n - 1:
            rows.append((SEEN, camera_noise))
        for c, r in rows:
            gain = np.linalg.solve(c @ p @ c.T + r, c @ p).T
            p = (np.eye(4) - gain @ c) @ p
            error = (np.eye(4) - gain @ c) @ error
        p = 0.5 * (p + p.T)
    return error


def update_jumps(car: Car, config: EstimatorConfig, drive: Simulated) -> dict[str, float]:
    """RMS jump of the side-slip at camera updates, no delay: exact filter and compensated."""
    result = {}
    for name, key in (
        ("clones", "jump_uncompensated_rad"),
        ("compensated", "jump_compensated_rad"),
    ):
        estimator = make_estimator(name, car, config)
        log, jumps = drive.log, []
        steering, speed = log.columns["road_wheel_angle_rad"], log.columns["vx_mps"]
        heading, offset = log.columns["heading_rad"], log.columns["lateral_offset_m"]
        for row, stamp in enumerate(log.stamp_s.tolist()):
            before_row = max(row - 1, 0)
            estimator.step(stamp, Inputs(float(steering[before_row]), float(speed[before_row])))
            estimator.measure(YAW_RATE, float(log.columns["yaw_rate_radps"][row]), stamp, stamp)
            if np.isfinite(heading[row]):
                before = estimator.estimate().mean[0]
                estimator.capture(CAMERA, stamp)
                value = (float(heading[row]), float(offset[row]))
                estimator.measure(CAMERA, value, stamp, stamp)
                jumps.append(estimator.estimate().mean[0] - before)
        result[key] = float(np.sqrt(np.mean(np.square(jumps[20:]))))
    return result


def running_radius(
    name: str, car: Car, config: EstimatorConfig, speed_mps: float, frames: int = 60
) -> float:
    """Factor a frame by which the running filter forgets one wrong picture, no delay or noise.

    Two copies hear the same, but for one picture that was 0.01 rad and 0.01 m off; the slope of
    the logarithm of how far their states are apart is the answer. No matrix of the analysis is in
    it.
    """
    steps = max(1, round(config.camera_period_s / config.step_s))
    settle = 200
    copies = [make_estimator(name, car, config) for _ in range(2)]
    inputs = Inputs(0.0, speed_mps)
    apart = []
    for row in range((settle + frames) * steps):
        stamp = row * config.step_s
        for wrong, estimator in enumerate(copies):
            estimator.step(stamp, inputs)
            estimator.measure(YAW_RATE, 0.0, stamp, stamp)
            if row and row % steps == 0:
                estimator.capture(CAMERA, stamp)
                off = 0.01 * wrong * (row == settle * steps)
                estimator.measure(CAMERA, (off, off), stamp, stamp)
        if row > settle * steps and row % steps == steps - 1:
            mean = [estimator.estimate().mean for estimator in copies]
            apart.append(float(np.linalg.norm(mean[0] - mean[1])))
    late = np.log(np.array(apart[frames // 3 :]))
    return float(np.exp(np.polynomial.polynomial.polyfit(np.arange(len(late)), late, 1)[1]))


def _radius(matrix: Floats) -> float:
    return float(np.abs(np.linalg.eigvals(matrix)).max())
