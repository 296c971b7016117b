"""A late picture against the filter of now: four ways, alike in all but the correction."""

from __future__ import annotations

from abc import ABC, abstractmethod
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
class Capture:
    """The state at a capture and what came since: `x_now = carried x + driven` by the model.

    Filters that correct what they carry put their corrections into `carried`, too.
    """

    stamp_s: float
    mean: Floats
    covariance: Floats
    carried: Floats
    driven: Floats


class LateCameraFilter(VisionFilter, ABC):
    """State `[beta, gamma, psi, y_l]`; how a late picture corrects it is left open."""

    def __init__(self, car: Car, config: EstimatorConfig, clones: int = 0) -> None:
        super().__init__(car, config)
        self._filter = ClonedFilter(np.zeros(4), initial_covariance(config), SEEN, clones)

    def step(self, stamp_s: float, inputs: Inputs) -> None:
        model = self._model(stamp_s, inputs)
        if model is not None:
            self._predict(*model)

    def _predict(self, transition: Floats, driven: Floats, noise: Floats) -> None:
        self._filter.predict(transition, driven, noise)

    def measure(self, kind: str, value: Value, stamp_s: float, arrival_s: float) -> None:
        if kind == YAW_RATE:
            self._take_yaw_rate(float(value))  # type: ignore[arg-type]
        elif kind == CAMERA:
            measured = np.array(pair(kind, value))
            before, expected = self._filter.x[:4].copy(), self._expected(stamp_s)
            if expected is None:
                self._drop("camera value without a capture")
            elif not self._wild(
                CAMERA, stamp_s, measured - expected[0], expected[1], self._camera_noise
            ):
                self._take_picture(measured, stamp_s)
                self._bridge.corrected(self._clock.stamp_s, before, self._filter.x[:4])

    def _take_yaw_rate(self, value_radps: float) -> None:
        f = self._filter
        variance = self.gate.variance(YAW_RATE, self._gyro_variance)
        numbers = (value_radps - f.x.item(1), f.p.item(1, 1) + variance)
        if not self.gate.refuses(YAW_RATE, self._clock.stamp_s, numbers):
            self._correct_yaw_rate(value_radps, variance)

    def _correct_yaw_rate(self, value_radps: float, variance: float) -> None:
        self._filter.scalar(1, value_radps, variance)

    @abstractmethod
    def _expected(self, stamp_s: float) -> tuple[Floats, Floats] | None:
        """Heading and offset `(2,)` of a capture with their covariance; None without one."""

    @abstractmethod
    def _take_picture(self, measured: Floats, stamp_s: float) -> None:
        """Correct by heading and offset `(2,)` of a capture that is there."""

    def estimate(self) -> Estimate:
        return self._output(self._filter.x[:4].copy(), self._filter.p[:4, :4])

    def covariance(self) -> Floats:
        return self._filter.p[:4, :4].copy()


class CloneKalman(LateCameraFilter):
    """Exact, at the same cost each step: per capture on its way a clone of `[psi, y_l]`.

    Source: errata.md, Delay by cloning at 1 ms (W12 (10)-(13), W14 (12), (13) corrected).
    """

    def __init__(self, car: Car, config: EstimatorConfig) -> None:
        super().__init__(car, config, config.camera_slots)
        self._jacobians = [
            np.eye(2, self._filter.size, 4 + 2 * slot) for slot in range(config.camera_slots)
        ]

    def capture(self, kind: str, stamp_s: float) -> None:
        if kind == CAMERA:
            self._filter.capture(stamp_s)

    def _expected(self, stamp_s: float) -> tuple[Floats, Floats] | None:
        rows = self._filter.clone(stamp_s)
        return None if rows is None else (self._filter.x[rows], self._filter.p[rows, rows])

    def _take_picture(self, measured: Floats, stamp_s: float) -> None:
        rows = self._filter.clone(stamp_s)
        if rows is not None:
            jacobian = self._jacobians[(rows.start - 4) // 2]
            self._filter.update(jacobian, measured - self._filter.x[rows], self._camera_noise)
            self._filter.release(stamp_s)


class StoredCaptureFilter(LateCameraFilter):
    """Keeps the states at the captures whose pictures are on their way."""

    def __init__(self, car: Car, config: EstimatorConfig) -> None:
        super().__init__(car, config)
        self._captures: list[Capture] = []

    def _predict(self, transition: Floats, driven: Floats, noise: Floats) -> None:
        super()._predict(transition, driven, noise)
        for capture in self._captures:
            capture.carried = transition @ capture.carried
            capture.driven = transition @ capture.driven + driven

    def capture(self, kind: str, stamp_s: float) -> None:
        if kind == CAMERA:
            f = self._filter
            now = Capture(stamp_s, f.x.copy(), f.p.copy(), np.eye(4), np.zeros(4))
            self._captures = [*self._captures, now][-self._config.camera_slots :]

    def _found(self, stamp_s: float) -> Capture | None:
        return next((c for c in self._captures if abs(c.stamp_s - stamp_s) < 1e-6), None)

    def _expected(self, stamp_s: float) -> tuple[Floats, Floats] | None:
        found = self._found(stamp_s)
        return None if found is None else (found.mean[2:], found.covariance[2:, 2:])

    def _take_picture(self, measured: Floats, stamp_s: float) -> None:
        capture = self._found(stamp_s)
        if capture is not None:
            self._captures = [one for one in self._captures if one is not capture]
            self._correct(capture, measured)

    @abstractmethod
    def _correct(self, capture: Capture, measured: Floats) -> None:
        """Correct by heading and offset `(2,)` of the picture of a capture."""


class MeasurementReconstructionKalman(StoredCaptureFilter):
    """The GPS paper's way: what would the picture show if it were taken now?

    The measured heading and offset take their places in the stored state of the capture, the model
    takes that to now with the stored inputs, and `C x` of it is the reconstructed measurement. The
    gain is the present one. What the yaw rates since the capture taught is not used, and the
    errors which reconstruction and state share are not counted: the stated deviation is a little
    small.

    Source: N13 (20)-(22) as corrected in errata.md, with the product of the stored transitions.
    """

    def _correct(self, capture: Capture, measured: Floats) -> None:
        then = capture.mean.copy()
        then[2:] = measured
        now = capture.carried @ then + capture.driven
        self._filter.update(SEEN, now[2:] - self._filter.x[2:], self._camera_noise)


class UnevenDelayKalman(StoredCaptureFilter):
    """Delays that change from picture to picture: the residual against the state that was seen.

    `x += K_k (y - C x_s)` with the present gain and x_s stored *after* an arrival of the same
    step; stored before it, as printed, the filter diverges when the delay is one frame. The
    covariance takes the value for one of now, so the stated deviation is a little small.

    Source: W13 (15) as corrected in errata.md.
    """

    def _correct(self, capture: Capture, measured: Floats) -> None:
        self._filter.update(SEEN, measured - SEEN @ capture.mean, self._camera_noise)


class ReconstructionKalman(StoredCaptureFilter):
    """The gain of the capture carried to now by what the filter did since.

    `x_k += M K_s (y - C x_s)`, `P_k -= M K_s S_s K_s' M'` with `M = prod (I - K C) G`. Its
    covariance is right for what it does. It is the best that can be had from the present state
    and the late residual; the clones know a little more, because the yaw rates since the capture
    also sharpen what was expected of the picture (under 1 % here).

    Source: Larsen et al., CDC 1998, as given in errata.md, Uneven delay.
    """

    def _correct_yaw_rate(self, value_radps: float, variance: float) -> None:
        f = self._filter
        gain = f.p[:, 1] / (f.p[1, 1] + variance)
        for capture in self._captures:
            capture.carried = capture.carried - np.outer(gain, capture.carried[1])
        super()._correct_yaw_rate(value_radps, variance)

    def _correct(self, capture: Capture, measured: Floats) -> None:
        cross = capture.covariance @ SEEN.T
        s = SEEN @ cross + self._camera_noise
        carried = capture.carried @ cross
        gain = np.linalg.solve(s, carried.T).T
        f = self._filter
        f.x += gain @ (measured - SEEN @ capture.mean)
        p = f.p - gain @ s @ gain.T
        f.p[:] = 0.5 * (p + p.T)
