"""The exact filter for late values by doing the time since over again; any delay, any order.

A late value goes where its stamp says (`vehicle.delay.ReplayBuffer`). `MultiRateKalman` is the
same machine told a wrong stamp: the papers' multi-rate filter, which takes the delay for a known
constant, or for none at all.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from polemap.electric.config import EstimatorConfig
from polemap.electric.estimators.base import CAMERA, YAW_RATE, Estimate, Inputs, Value, pair
from polemap.electric.estimators.vision import SEEN, VisionFilter, initial_covariance
from polemap.vehicle.delay import Placement, ReplayBuffer
from polemap.vehicle.kalman import innovate, joseph_update, predict
from polemap.vehicle.parameters import Car

Floats = NDArray[np.float64]
_STEP, _GYRO, _CAMERA = 0, 1, 2
GYRO_ROW = np.array([[0.0, 1.0, 0.0, 0.0]])


class _Moment(NamedTuple):
    mean: Floats
    covariance: Floats


class _Predict(NamedTuple):
    transition: Floats
    driven: Floats
    noise: Floats


class _Measured(NamedTuple):
    value: Floats
    rows: Floats
    noise: Floats


def _apply(state: _Moment, stamp_s: float, event: _Predict | _Measured) -> _Moment:
    if isinstance(event, _Predict):
        mean = event.transition @ state.mean + event.driven
        return _Moment(mean, predict(state.covariance, event.transition, event.noise))
    residual = event.value - event.rows @ state.mean
    innovation = innovate(residual, state.covariance, event.rows, event.noise)
    return _Moment(
        *joseph_update(state.mean, state.covariance, innovation, event.rows, event.noise)
    )


class ReplayKalman(VisionFilter):
    """State `[beta, gamma, psi, y_l]`; every value in its place in time.

    A camera stamp between two steps counts at the step before it.
    """

    horizon_s = 0.5

    def __init__(self, car: Car, config: EstimatorConfig) -> None:
        super().__init__(car, config)
        capacity = int(4.0 * self.horizon_s / config.step_s) + 16
        self._buffer: ReplayBuffer[_Moment, _Predict | _Measured] = ReplayBuffer(
            _apply, horizon_s=self.horizon_s, capacity=capacity
        )
        self._buffer.reset(_Moment(np.zeros(4), initial_covariance(config)), float("-inf"))
        self._gyro_noise = np.array([[self._gyro_variance]])

    def step(self, stamp_s: float, inputs: Inputs) -> None:
        model = self._model(stamp_s, inputs)
        if model is not None:
            g, driven, q = model
            self._buffer.insert(stamp_s, _Predict(g.copy(), driven, q.copy()), kind=_STEP)

    def capture(self, kind: str, stamp_s: float) -> None:
        """Needs no notice: the past is kept."""

    def measure(self, kind: str, value: Value, stamp_s: float, arrival_s: float) -> None:
        if kind == YAW_RATE:
            self._gyro(float(value), stamp_s)  # type: ignore[arg-type]
        elif kind == CAMERA:
            event = _Measured(np.array(pair(kind, value)), SEEN, self._camera_noise)
            before, taken = self._buffer.state.mean, self._taken_at(stamp_s, arrival_s)
            then = self._buffer.state_at(taken)
            residual = event.value - then.mean[2:]
            if self._wild(CAMERA, taken, residual, then.covariance[2:, 2:], event.noise):
                return
            placement = self._buffer.insert(taken, event, kind=_CAMERA)
            if placement in (Placement.TOO_OLD, Placement.DUPLICATE):
                self._drop(f"camera value {placement.value}")
                return
            self._bridge.corrected(self._clock.stamp_s, before, self._buffer.state.mean)

    def _gyro(self, value_radps: float, stamp_s: float) -> None:
        now = self._buffer.state
        noise, scale = self._gyro_noise, self.gate.noise_scale.get(YAW_RATE)
        if scale is not None:
            noise = noise * scale * scale
        numbers = (value_radps - now.mean.item(1), now.covariance.item(1, 1) + noise.item())
        if not self.gate.refuses(YAW_RATE, stamp_s, numbers):
            event = _Measured(np.array([value_radps]), GYRO_ROW, noise)
            self._buffer.insert(stamp_s, event, kind=_GYRO)

    def _taken_at(self, stamp_s: float, arrival_s: float) -> float:
        return stamp_s

    def estimate(self) -> Estimate:
        return self._output(self._buffer.state.mean.copy(), self._buffer.state.covariance)

    def covariance(self) -> Floats:
        return self._buffer.state.covariance.copy()


class MultiRateKalman(ReplayKalman):
    """Without inter-sample compensation, and with a delay assumed instead of read from stamps.

    Every step takes the yaw rate; where no picture arrives its residual is zero, not its value.
    `camera_delay_s` = 0 is the filter that ignores the delay, one camera period is W12's and
    W14's; with the true delay it is the exact filter.

    Source: W12 (12), (13), W14 (16) as corrected in errata.md.
    """

    def _taken_at(self, stamp_s: float, arrival_s: float) -> float:
        return self._clock.stamp_s - self._config.camera_delay_s + 1e-7
