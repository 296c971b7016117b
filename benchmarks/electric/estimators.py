"""A 1 ms step of the side-slip estimators from Python: speed varies, gyro in every step."""

from __future__ import annotations

import time

import numpy as np

from benchmarks.harness import compared, interleaved, summary
from polemap.electric.config import EstimatorConfig
from polemap.electric.estimators.base import CAMERA, YAW_RATE, Estimator, Inputs
from polemap.electric.estimators.registry import make_estimator
from polemap.electric.signals import play
from polemap.electric.studies.scenes import Scene, drive_with_camera
from polemap.stereo.lane import LaneFinder
from polemap.stereo.road_plane import RoadCamera
from polemap.vehicle.io import load_car

STEPS, WARM, FRAME, DELAY = 30_000, 2_000, 33, 33
LOG_S = 60.0
NAMES = ("clones", "compensated", "bicycle", "uneven_delay")


def run() -> dict[str, dict[str, float]]:
    """Median and tails of a step (predict, yaw rate, pictures when due), and a log's pace."""
    car, config = load_car("coms"), EstimatorConfig()
    times = {name: _steps(make_estimator(name, car, config)) for name in NAMES}
    steps = compared(times, "clones")
    result = {
        f"estimator_step_{name}": {**steps[name], **summary(each, 99)}
        for name, each in times.items()
    }
    result["lane_frame_640x480"] = _lane()
    drive = drive_with_camera(car, Scene(7.0, LOG_S), config, np.random.default_rng(0))
    begin = time.perf_counter()
    play(make_estimator("clones", car, config), drive.log)
    spent = time.perf_counter() - begin
    result["estimator_log_1khz_clones"] = {
        "median_ms": spent / LOG_S * 550.0 * 1e3,
        "log_s": 550.0,
        "real_time_factor": LOG_S / spent,
    }
    return result


def _lane() -> dict[str, float]:
    """One frame of the lane finder on a drawn road with noise and two lines."""
    camera = RoadCamera.from_focal(640, 480, 600.0, 1.3, 0.08)
    rows, columns = np.indices((480, 640))
    road = camera.pixel_to_road(np.stack([rows, columns], axis=-1))
    painted = np.abs(np.abs(road[..., 1]) - 1.75) < 0.075
    rng = np.random.default_rng(0)
    image = np.where(painted, 180.0, 90.0) + 5.0 * rng.standard_normal((480, 640))
    grey = np.clip(image, 0, 255).astype(np.uint8)
    finder = LaneFinder(camera, rng=rng)
    return summary(interleaved({"find": lambda: finder.find(grey, 0.0, 0.0)}, 100)["find"])


def _steps(estimator: Estimator) -> list[float]:
    """Seconds of each step, arrivals and captures included."""
    rng = np.random.default_rng(0)
    speeds = 8.0 + 4.0 * np.sin(np.arange(STEPS) * 2e-4)
    inputs = [Inputs(0.05, v) for v in speeds.tolist()]
    gyro = (0.1 + 0.003 * rng.standard_normal(STEPS)).tolist()
    spent = np.zeros(STEPS)
    step, measure, capture = estimator.step, estimator.measure, estimator.capture
    clock = time.perf_counter
    for k in range(STEPS):
        stamp = k * 0.001
        begin = clock()
        step(stamp, inputs[k])
        measure(YAW_RATE, gyro[k], stamp, stamp)
        if k % FRAME == 0 and k >= FRAME:
            measure(CAMERA, (0.0, 0.0), (k - DELAY) * 0.001, stamp)
        if k % FRAME == 0:
            capture(CAMERA, stamp)
        spent[k] = clock() - begin
    return list(map(float, spent[WARM:]))
