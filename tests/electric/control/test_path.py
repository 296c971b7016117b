"""Path following: projection onto the path, and convergence of a kinematic car."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from polemap.electric.control.path import Path, StanleySettings, stanley_steer
from polemap.vehicle.errors import VehicleError
from polemap.vehicle.motion import move_along_arc
from polemap.vehicle.pose import Pose2D

ANGLES = np.linspace(0, 2 * np.pi, 361)[:-1]
CIRCLE = Path(20.0 * np.stack([np.cos(ANGLES), np.sin(ANGLES)], axis=1), closed=True)


@given(st.floats(-3.0, 3.0), st.floats(-3.0, 3.0), st.floats(-1.0, 1.0))
def test_a_point_beside_the_circle_is_located(angle: float, left_m: float, turn: float) -> None:
    radius = 20.0 - left_m  # counter-clockwise: left is inwards
    yaw = angle + np.pi / 2 + turn
    error = CIRCLE.locate(radius * np.cos(angle), radius * np.sin(angle), yaw)
    assert error.lateral_m == pytest.approx(left_m, abs=0.01)
    assert error.heading_rad == pytest.approx(turn, abs=0.01)
    assert error.curvature_radpm == pytest.approx(1 / 20.0, rel=0.02)
    assert error.station_m == pytest.approx((angle % (2 * np.pi)) * 20.0, abs=0.2) or (
        abs(error.station_m - (angle % (2 * np.pi)) * 20.0) > CIRCLE.length_m - 0.2
    )


def _drive(path: Path, start: Pose2D, speed: float, seconds: float) -> np.ndarray:
    pose, yaw_rate, errors = start, 0.0, []
    for _ in range(round(seconds / 0.01)):
        steer, error = stanley_steer(path, pose, speed, yaw_rate, 2.7, StanleySettings())
        yaw_rate = speed * np.tan(steer) / 2.7
        pose = Pose2D(*move_along_arc(pose, speed * 0.01, yaw_rate * 0.01))
        errors.append(error.lateral_m)
    return np.array(errors)


@pytest.mark.parametrize("speed", [2.0, 8.0, 14.0])
def test_a_kinematic_car_converges_to_a_line_without_oscillating(speed: float) -> None:
    line = Path(np.stack([np.linspace(0, 400, 401), np.zeros(401)], axis=1))
    errors = _drive(line, Pose2D(0.0, 2.0, 0.0), speed, 20.0)
    assert abs(errors[-1]) < 0.01
    assert errors.min() > -0.05


def test_a_kinematic_car_holds_the_circle() -> None:
    errors = _drive(CIRCLE, Pose2D(20.0, 0.0, np.pi / 2), 6.0, 15.0)
    assert np.abs(errors[500:]).max() < 0.1


@pytest.mark.parametrize(
    ("points", "message"),
    [
        ([[0.0, 0.0], [1.0, 0.0]], "at least 3 points"),
        ([[0.0, 0.0], [0.0, 0.0], [1.0, 0.0]], "must not repeat a point"),
        ([[0.0, 0.0], [np.nan, 0.0], [1.0, 0.0]], "not finite"),
    ],
)
def test_refuses_what_is_no_path(points: list[list[float]], message: str) -> None:
    with pytest.raises(VehicleError, match=message):
        Path(np.array(points))


def test_the_front_slip_of_a_bend_is_steered_ahead() -> None:
    pose, speed = Pose2D(20.0, 0.0, np.pi / 2), 8.0
    plain, error = stanley_steer(CIRCLE, pose, speed, 0.4, 2.7, StanleySettings())
    settings = StanleySettings(front_slip_rad_per_mps2=0.01)
    ahead, _ = stanley_steer(CIRCLE, pose, speed, 0.4, 2.7, settings)
    assert ahead - plain == pytest.approx(0.01 * speed**2 * error.curvature_radpm)
