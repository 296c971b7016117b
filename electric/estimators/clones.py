"""The exact filter for a late camera, at the same cost each step: clones of what it saw."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from polemap.electric.config import EstimatorConfig
from polemap.electric.estimators.base import CAMERA, YAW_RATE, Estimate, Inputs, Value, pair
from polemap.electric.estimators.vision import SEEN, VisionFilter, initial_covariance
from polemap.vehicle.delay import ClonedFilter
from polemap.vehicle.parameters import Car

Floats = NDArray[np.float64]


class CloneKalman(VisionFilter):
    """State `[beta, gamma, psi, y_l]` and, per capture on its way, `[psi, y_l]` at that moment.

    Source: errata.md, Delay by cloning at 1 ms (W12 (10)-(13), W14 (12), (13) corrected).
    """

    def __init__(self, car: Car, config: EstimatorConfig) -> None:
        super().__init__(car, config)
        self._filter = ClonedFilter(
            np.zeros(4), initial_covariance(config), SEEN, config.camera_slots
        )
        self._jacobians = [
            np.eye(2, self._filter.size, 4 + 2 * slot) for slot in range(config.camera_slots)
        ]

    def step(self, stamp_s: float, inputs: Inputs) -> None:
        model = self._model(stamp_s, inputs)
        if model is not None:
            self._filter.predict(*model)

    def capture(self, kind: str, stamp_s: float) -> None:
        if kind == CAMERA:
            self._filter.capture(stamp_s)

    def measure(self, kind: str, value: Value, stamp_s: float, arrival_s: float) -> None:
        if kind == YAW_RATE:
            self._filter.scalar(1, float(value), self._gyro_variance)  # type: ignore[arg-type]
        elif kind == CAMERA:
            seen = np.array(pair(kind, value))
            rows = self._filter.clone(stamp_s)
            if rows is None:
                self._drop("camera value without a capture")
                return
            before = self._filter.x[:4].copy()
            jacobian = self._jacobians[(rows.start - 4) // 2]
            self._filter.update(jacobian, seen - self._filter.x[rows], self._camera_noise)
            self._filter.release(stamp_s)
            self._bridge.corrected(self._clock.stamp_s, before, self._filter.x[:4])

    def estimate(self) -> Estimate:
        return self._output(self._filter.x[:4].copy(), self._filter.p[:4, :4])

    def covariance(self) -> Floats:
        return self._filter.p[:4, :4].copy()
