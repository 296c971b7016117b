"""The disturbance observer on a model with a known push."""

from __future__ import annotations

import numpy as np
import pytest

from polemap.electric.control.disturbance import DisturbanceObserver
from polemap.vehicle.errors import VehicleError

A = np.array([[-5.0, -1.0], [-10.0, -8.0]])
B = np.array([[3.0, 0.0], [40.0, 0.01]])


def test_follows_a_disturbance_as_a_low_pass_of_its_cut_off() -> None:
    observer, state, dt = DisturbanceObserver(10.0), np.zeros(2), 1e-4
    inputs, push = np.array([0.1, 50.0]), np.array([0.3, -2.0])
    found = np.zeros(2)
    for k in range(6000):
        found = observer.step(A, B, state, inputs, dt)
        if k == 1000:
            # a tenth of a second is one time constant of 10 rad/s
            np.testing.assert_allclose(found, push * (1 - np.exp(-1.0)), rtol=0.02)
        state = state + dt * (A @ state + B @ inputs + push)
    np.testing.assert_allclose(found, push, rtol=0.01)


def test_finds_nothing_where_the_model_is_right() -> None:
    observer, state, dt = DisturbanceObserver(10.0), np.array([0.02, 0.3]), 1e-3
    for k in range(2000):
        inputs = np.array([0.05 * np.sin(0.01 * k), 100.0])
        # the inputs of the last step brought the state to where it is
        assert np.abs(observer.step(A, B, state, inputs, dt)).max() < 1e-9
        state = state + dt * (A @ state + B @ inputs)


def test_refuses_a_cut_off_of_nothing() -> None:
    with pytest.raises(VehicleError, match="cut-off is 0"):
        DisturbanceObserver(0.0)
