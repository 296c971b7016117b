"""The GPS paper's way with delay, for the camera: what would the picture show if taken now?"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from polemap.electric.config import EstimatorConfig
from polemap.electric.estimators.base import CAMERA, YAW_RATE, Estimate, Inputs, Value, pair
from polemap.electric.estimators.vision import SEEN, VisionFilter, initial_covariance
from polemap.vehicle.delay import ClonedFilter
from polemap.vehicle.parameters import Car

Floats = NDArray[np.float64]


@dataclass(slots=True)
class _Taken:
    """The state at a capture and what the model did since: `x_now = product x + driven`."""

    stamp_s: float
    mean: Floats
    product: Floats
    driven: Floats


class MeasurementReconstructionKalman(VisionFilter):
    """State `[beta, gamma, psi, y_l]`; a late picture is carried to now and measured as of now.

    The measured heading and offset take their places in the stored state of the capture, the model
    takes that to now with the stored inputs, and `C x` of it is the reconstructed measurement. The
    gain is the present one. What the yaw rates since the capture taught is not used, and the
    errors which reconstruction and state share are not counted: the stated deviation is a little
    small.

    Source: N13 (20)-(22) as corrected in errata.md, with the product of the stored transitions.
    """

    def __init__(self, car: Car, config: EstimatorConfig) -> None:
        super().__init__(car, config)
        self._filter = ClonedFilter(np.zeros(4), initial_covariance(config), SEEN, 0)
        self._taken: list[_Taken] = []

    def step(self, stamp_s: float, inputs: Inputs) -> None:
        model = self._model(stamp_s, inputs)
        if model is None:
            return
        self._filter.predict(*model)
        transition, driven, _ = model
        for taken in self._taken:
            taken.product = transition @ taken.product
            taken.driven = transition @ taken.driven + driven

    def capture(self, kind: str, stamp_s: float) -> None:
        if kind == CAMERA:
            self._taken.append(_Taken(stamp_s, self._filter.x.copy(), np.eye(4), np.zeros(4)))
            del self._taken[: -self._config.camera_slots]

    def measure(self, kind: str, value: Value, stamp_s: float, arrival_s: float) -> None:
        f = self._filter
        if kind == YAW_RATE:
            f.scalar(1, float(value), self._gyro_variance)  # type: ignore[arg-type]
        elif kind == CAMERA:
            measured = np.array(pair(kind, value))
            found = [t for t in self._taken if abs(t.stamp_s - stamp_s) < 1e-6]
            if not found:
                self._drop("camera value without a capture")
                return
            taken = found[0]
            self._taken = [t for t in self._taken if t is not taken]
            then = taken.mean.copy()
            then[2:] = measured
            now = taken.product @ then + taken.driven
            before = f.x.copy()
            f.update(SEEN, now[2:] - f.x[2:], self._camera_noise)
            self._bridge.corrected(self._clock.stamp_s, before, f.x)

    def estimate(self) -> Estimate:
        return self._output(self._filter.x.copy(), self._filter.p)

    def covariance(self) -> Floats:
        return self._filter.p.copy()
