"""Innovation gates: a value that the filter holds for impossible does not move it.

The papers' filters believe every value. A gate compares a residual with its predicted deviation;
what stands too far off is left out and counted. A filter that is itself wrong must not shut the
truth out for good: where all values of a kind are refused for `PATIENCE_S`, they are taken again
until one fits.
"""

from __future__ import annotations

from polemap.electric.config import EstimatorConfig
from polemap.electric.estimators.base import (
    CAMERA,
    GPS,
    LATERAL_ACCELERATION,
    WHEEL_SPEED,
    YAW_RATE,
)

# the GPS's velocity, which two filters measure apart from its course
GPS_SPEED = "gps_speed"
# so long, and for so many values, a filter trusts itself more than a sensor that contradicts it
PATIENCE_S, PATIENCE_VALUES = 0.5, 3
# Residuals smaller than these are never refused, by kind and number: filters on a linear model that
# leave the delay out of their covariance state less than they err, and values so near do no harm.
LEAST_RESIDUAL = {
    YAW_RATE: (0.15,),
    LATERAL_ACCELERATION: (3.0,),
    CAMERA: (0.05, 0.3),
    GPS: (0.1, 1.0),
    GPS_SPEED: (1.0, 1.0),
    WHEEL_SPEED: (1.0,),
}


class Gate:
    """Says of each residual whether it is believed, by its kind.

    Attributes:
        dropped: reasons and counts of refused values; the estimator's own.
        noise_scale: by kind, how many times its configured deviation a sensor is held to have.
    """

    def __init__(self, config: EstimatorConfig, dropped: dict[str, int]) -> None:
        self._limit = config.innovation_gate_sd
        self._dropped = dropped
        self._refused: dict[str, tuple[float, int]] = {}
        self.noise_scale: dict[str, float] = {}

    def variance(self, kind: str, configured: float) -> float:
        """The variance of a kind, `noise_scale` in it."""
        scale = self.noise_scale.get(kind)
        return configured if scale is None else configured * scale * scale

    def refuses(self, kind: str, stamp_s: float, *numbers: tuple[float, float]) -> bool:
        """Whether to leave a value out: its residuals, each with the variance it was predicted to.

        A residual that is not a number is refused without end.
        """
        limit = self._limit
        if not limit:
            return False
        for (residual, variance), least in zip(numbers, LEAST_RESIDUAL[kind], strict=False):
            size = abs(residual)
            if not (size < least or size * size < limit * limit * variance):
                break
        else:
            if self._refused:
                self._refused.pop(kind, None)
            return False
        since, count = self._refused.get(kind, (stamp_s, 0))
        self._refused[kind] = (since, count + 1)
        if residual == residual and stamp_s - since > PATIENCE_S and count >= PATIENCE_VALUES:
            return False
        reason = f"{kind.replace('_', ' ')} beyond the innovation gate, left out"
        self._dropped[reason] = self._dropped.get(reason, 0) + 1
        return True
