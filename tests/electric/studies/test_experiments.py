"""Swinging speeds, and what the papers' experiments say of position, course and velocity."""

from __future__ import annotations

import numpy as np
import pytest

from polemap.electric.config import EstimatorConfig
from polemap.electric.estimators.base import CAMERA, YAW_RATE, Inputs
from polemap.electric.estimators.registry import make_estimator
from polemap.electric.estimators.vision import vision_density
from polemap.electric.studies.convergence import frame_radii, running_radius
from polemap.electric.studies.experiments import (
    position_rows,
    swinging,
    velocity_panels,
    velocity_rows,
)
from polemap.electric.studies.scenes import (
    GPS_NOISE,
    KMH,
    MISMATCH,
    Scene,
    drive_with_camera,
    drive_with_gps,
)
from polemap.vehicle.io import load_car

CAR = load_car("coms")


def test_a_swing_of_nothing_is_the_constant_speed() -> None:
    steady = Scene(25 * KMH, 3.0, 0.06, 0.5, model_noise=False)
    one, other = (
        drive_with_camera(CAR, scene, MISMATCH, np.random.default_rng(1))
        for scene in (steady, swinging(25.0, 25.0, steady))
    )
    assert other.truth == pytest.approx(one.truth, abs=1e-5)  # the schedule is linear between rows


def test_the_speed_swings_between_its_ends() -> None:
    speeds = swinging(10.0, 20.0, Scene(0.0)).speeds(np.linspace(0.0, 16.0, 401)) / KMH
    assert (speeds.min(), speeds.max()) == pytest.approx((10.0, 20.0))


def test_gps_on_a_swinging_speed_is_consistent() -> None:
    """dvx/dt = ax + gamma vy, dvy/dt = ay - gamma vx hold for what the sensors would read."""
    quiet = GPS_NOISE.model_copy(update={"acceleration_walk_mps": 1e-9, "gyro_sd_radps": 1e-9})
    scene = swinging(5.0, 30.0, Scene(0.0, 4.0, 0.06, 0.5, (0.1,), 0.2, model_noise=False))
    drive = drive_with_gps(CAR, scene, quiet, np.random.default_rng(0))
    c, step = drive.log.columns, quiet.step_s
    vx = c["vx_mps"] * np.cos(c["sideslip_rad"])
    for v, push in (
        (vx, c["ax_mps2"] + c["yaw_rate_radps"] * c["vy_mps"]),
        (c["vy_mps"], c["ay_mps2"] - c["yaw_rate_radps"] * vx),
    ):
        moved = v[0] + np.cumsum(push) * step
        assert np.abs(moved - v)[100:].max() < 0.02


def test_w13_beats_a_constant_delay_on_position() -> None:
    lines, figures = position_rows(CAR, 1, lambda _n: None)
    assert len(lines) == 16
    for key in ("25", "0-30"):
        assert figures[f"{key}_lateral_offset_m_uneven_compensated"] < 1.0


def test_layer_two_has_the_velocities_and_the_course_without_delay() -> None:
    scene = Scene(29 * KMH, 6.0, 0.06, 0.2, (0.1,), 0.2, model_noise=False)
    drives = [drive_with_gps(CAR, scene, GPS_NOISE, np.random.default_rng(0))]
    names = ("kinematic", "two_layer_reconstructed")
    _, figures = velocity_rows(CAR, GPS_NOISE, drives, names)
    course = figures["two_layer_reconstructed_course_rad"]
    assert course < 0.3 * figures["held_course_rad"]
    assert {"kinematic_vy_mps", "two_layer_reconstructed_vx_mps"} <= figures.keys()
    whole = figures["two_layer_reconstructed_yaw_rate_radps"]
    assert 0.0 < figures["two_layer_reconstructed_yaw_rate_radps_cornering"] < 3.0 * whole
    panels = velocity_panels(CAR, GPS_NOISE, drives[0], names)
    assert [len(panel.curves) for panel in panels] == [3, 3, 3, 3]


def test_the_running_filter_forgets_as_its_analysis_says() -> None:
    config = MISMATCH.model_copy(update={"camera_period_s": 0.02})
    analysed = frame_radii(CAR, config, 25 * KMH)["radius_compensated"]
    running = running_radius("compensated", CAR, config, 25 * KMH)
    assert running == pytest.approx(analysed, abs=2e-3)


def test_the_vision_part_of_the_process_noise_is_a_setting() -> None:
    config = EstimatorConfig(heading_walk_rad=0.01, lateral_offset_walk_m=0.02)
    assert vision_density(config)[2:] == pytest.approx((1e-4, 4e-4))


def test_compensation_ends_with_the_frame_or_with_the_next_picture() -> None:
    """j < T_l / T_s as W14 prints it; W13's goes on until a late picture comes."""
    config = EstimatorConfig()
    states = {}
    for name in ("compensated", "uneven_compensated"):
        estimator = make_estimator(name, CAR, config)
        trail = []
        for row in range(140):
            stamp = row * config.step_s
            estimator.step(stamp, Inputs(0.0, 7.0))
            estimator.measure(YAW_RATE, 0.0, stamp, stamp)
            if row == 33:
                estimator.capture(CAMERA, stamp)
                estimator.measure(CAMERA, (0.02, 0.1), stamp, stamp)
            trail.append(estimator.estimate().value("lateral_offset_m"))
        states[name] = np.array(trail)
    alike = states["compensated"] == states["uneven_compensated"]
    assert alike[: 33 + 33].all()
    assert not alike[-1]
