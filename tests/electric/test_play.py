"""What an estimator is driven by: steering as the wheels turn."""

from __future__ import annotations

import numpy as np
import pytest

from polemap.electric.estimators.base import Estimate, Inputs
from polemap.electric.signals import SignalLog, play, shifted


class Steered:
    """Keeps the steering that it is told."""

    fields = ("sideslip_rad",)

    def __init__(self) -> None:
        self.dropped: dict[str, int] = {}
        self.angles: list[float] = []

    def step(self, stamp_s: float, inputs: Inputs) -> None:
        self.angles.append(inputs.road_wheel_angle_rad)

    def capture(self, *_: object) -> None:
        pass

    measure = capture

    def estimate(self) -> Estimate:
        return Estimate(0.0, self.fields, np.zeros(1), np.ones(1))

    def covariance(self) -> np.ndarray:
        return np.eye(1)


def steered(later_s: float) -> np.ndarray:
    stamps = 0.01 * np.arange(200)
    log = SignalLog(stamps, {"road_wheel_angle_rad": 0.1 * stamps, "vx_mps": np.full(200, 10.0)})
    estimator = Steered()
    play(estimator, log, steering_scale=2.0, steering_offset_rad=0.05, steering_delay_s=later_s)
    return np.array(estimator.angles)


def test_wheels_turn_after_their_sensor_and_never_before_it() -> None:
    now, late = steered(0.0), steered(0.025)
    assert late[10:] == pytest.approx(now[10:] - 2.0 * 0.1 * 0.025)
    assert steered(-0.025) == pytest.approx(now)


def test_a_signal_that_is_not_shifted_is_the_same_array_and_ends_are_held() -> None:
    stamps, values = np.arange(4.0), np.array([0.0, 1.0, np.nan, 3.0])
    assert shifted(stamps, values, 0.0) is values
    assert shifted(stamps, np.arange(4.0), 10.0).tolist() == [0.0] * 4
