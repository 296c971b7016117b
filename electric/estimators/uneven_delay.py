"""Delays that change from picture to picture: the residual against the state that was seen."""

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
class _Seen:
    stamp_s: float
    mean: Floats
    covariance: Floats
    carried: Floats  # product of (I - K C) G since the capture


class UnevenDelayKalman(VisionFilter):
    """W13: the residual is formed against the stored state, the gain is the present one.

    `x += K_k (y - C x_s)` with x_s stored *after* an arrival of the same step; stored before it,
    as printed, the filter diverges when the delay is one frame. The covariance takes the value
    for one of now, so the stated deviation is a little small.

    Source: W13 (15) as corrected in errata.md.
    """

    def __init__(self, car: Car, config: EstimatorConfig) -> None:
        super().__init__(car, config)
        self._filter = ClonedFilter(np.zeros(4), initial_covariance(config), SEEN, 0)
        self._seen: list[_Seen] = []

    def step(self, stamp_s: float, inputs: Inputs) -> None:
        model = self._model(stamp_s, inputs)
        if model is not None:
            self._filter.predict(*model)
            for seen in self._seen:
                seen.carried = model[0] @ seen.carried

    def capture(self, kind: str, stamp_s: float) -> None:
        if kind == CAMERA:
            f = self._filter
            self._seen.append(_Seen(stamp_s, f.x.copy(), f.p.copy(), np.eye(4)))
            del self._seen[: -self._config.camera_slots]

    def measure(self, kind: str, value: Value, stamp_s: float, arrival_s: float) -> None:
        f = self._filter
        if kind == YAW_RATE:
            gain = f.p[:, 1] / (f.p[1, 1] + self._gyro_variance)
            for seen in self._seen:
                seen.carried = seen.carried - np.outer(gain, seen.carried[1])
            f.scalar(1, float(value), self._gyro_variance)  # type: ignore[arg-type]
        elif kind == CAMERA:
            measured = np.array(pair(kind, value))
            found = [s for s in self._seen if abs(s.stamp_s - stamp_s) < 1e-6]
            if not found:
                self._drop("camera value without a capture")
                return
            self._seen = [s for s in self._seen if s is not found[0]]
            before = f.x.copy()
            self._correct(found[0], measured - SEEN @ found[0].mean)
            self._bridge.corrected(self._clock.stamp_s, before, f.x)

    def _correct(self, seen: _Seen, residual: Floats) -> None:
        self._filter.update(SEEN, residual, self._camera_noise)

    def estimate(self) -> Estimate:
        return self._output(self._filter.x.copy(), self._filter.p)

    def covariance(self) -> Floats:
        return self._filter.p.copy()


class ReconstructionKalman(UnevenDelayKalman):
    """The gain of the capture carried to now by what the filter did since.

    `x_k += M K_s (y - C x_s)`, `P_k -= M K_s S_s K_s' M'` with `M = prod (I - K C) G`. Its
    covariance is right for what it does. It is the best that can be had from the present state
    and the late residual; the clones know a little more, because the yaw rates since the capture
    also sharpen what was expected of the picture (under 1 % here).

    Source: Larsen et al., CDC 1998, as given in errata.md, Uneven delay.
    """

    def _correct(self, seen: _Seen, residual: Floats) -> None:
        cross = seen.covariance @ SEEN.T
        s = SEEN @ cross + self._camera_noise
        carried = seen.carried @ cross
        gain = np.linalg.solve(s, carried.T).T
        f = self._filter
        f.x += gain @ residual
        p = f.p - gain @ s @ gain.T
        f.p[:] = 0.5 * (p + p.T)
