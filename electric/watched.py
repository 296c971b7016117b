"""What an estimator was told against what it expected: innovations, and values it refused."""

from __future__ import annotations

from dataclasses import dataclass, field
from math import sqrt

import numpy as np
from numpy.typing import NDArray

from polemap.electric.config import EstimatorConfig
from polemap.electric.estimators.base import (
    CAMERA,
    GPS,
    YAW_RATE,
    Estimate,
    Estimator,
    Inputs,
    Value,
)
from polemap.electric.estimators.forwarding import Forwarding

Floats = NDArray[np.float64]
# what a kind of measurement measures, and the setting that is its deviation
MEASURED = {
    YAW_RATE: (("yaw_rate_radps", "gyro_sd_radps"),),
    CAMERA: (("heading_rad", "heading_sd_rad"), ("lateral_offset_m", "lateral_offset_sd_m")),
    GPS: (("course_rad", "course_sd_rad"),),
}
JOINED_S = 1.0  # refusals nearer than this are one fault


@dataclass(frozen=True, slots=True)
class Fault:
    """A stretch in which values of a sensor were refused.

    Attributes:
        sensor: the kind of measurement; what: the reason that the estimator gives.
        from_s, to_s: stamps of the first and the last value; count: how many.
    """

    sensor: str
    what: str
    from_s: float
    to_s: float
    count: int


@dataclass(slots=True)
class Innovations:
    """Residuals of one signal: when, how large, and their expected deviation."""

    stamp_s: list[float] = field(default_factory=list)
    value: list[float] = field(default_factory=list)
    sd: list[float] = field(default_factory=list)

    def normalised(self) -> tuple[Floats, Floats]:
        """Stamps `(n,)`, and residuals over their deviation `(n,)`."""
        return np.array(self.stamp_s), np.array(self.value) / np.array(self.sd)


@dataclass(slots=True)
class Record:
    """What was heard in a whole log.

    Attributes:
        innovations: by signal, of every so manyth fast value and of all late ones.
        faults: in the order of their beginning.
    """

    innovations: dict[str, Innovations] = field(default_factory=dict)
    faults: list[Fault] = field(default_factory=list)


class Watched(Forwarding):
    """An estimator that keeps a record; it changes nothing of what the estimator does.

    A late value is compared with what the estimator held at its capture, where it tells the same: a
    heading in the lane is none from which a course is counted. `every` is how many fast
    values pass between two that are looked at.
    """

    def __init__(
        self, inner: Estimator, config: EstimatorConfig, record: Record, every: int = 10
    ) -> None:
        super().__init__(inner)
        self._config, self._record, self._every = config, record, every
        self._held: dict[tuple[str, float], Estimate] = {}
        self._count, self._stamp_s = 0, 0.0
        self._dropped = 0
        self._in_lane = "lateral_offset_m" in inner.fields
        self._pictures = False

    def step(self, stamp_s: float, inputs: Inputs) -> None:
        """Predict."""
        self._stamp_s = stamp_s
        self._inner.step(stamp_s, inputs)

    def capture(self, kind: str, stamp_s: float) -> None:
        """A late sensor measures now: what is held then is kept."""
        if kind in MEASURED:
            self._held[kind, stamp_s] = self._inner.estimate()
            if len(self._held) > 64:
                del self._held[next(iter(self._held))]
        self._inner.capture(kind, stamp_s)

    def measure(self, kind: str, value: Value, stamp_s: float, arrival_s: float) -> None:
        """A value; its innovation and whether it was refused go to the record."""
        if kind == YAW_RATE:
            self._count += 1
            if self._count % self._every == 0:
                self._compare(kind, (float(value),), stamp_s, self._inner.estimate())  # type: ignore[arg-type]
        elif kind in MEASURED:
            held = self._held.pop((kind, stamp_s), None)
            self._pictures |= kind == CAMERA
            tells = self._in_lane if kind == CAMERA else not (self._in_lane and self._pictures)
            if held is not None and tells:
                self._compare(kind, tuple(np.ravel(np.asarray(value)).tolist()), stamp_s, held)
        before = dict(self._inner.dropped) if kind in MEASURED else {}
        self._inner.measure(kind, value, stamp_s, arrival_s)
        total = sum(self._inner.dropped.values())
        if total != self._dropped:
            self._dropped = total
            for reason, count in self._inner.dropped.items():
                if count != before.get(reason, 0 if kind in MEASURED else count - 1):
                    self._refused(kind, reason, stamp_s)

    def _compare(
        self, kind: str, values: tuple[float, ...], stamp_s: float, held: Estimate
    ) -> None:
        for value, (name, setting) in zip(values, MEASURED[kind], strict=False):
            if name in held.fields:
                expected, sd = held.value(name), held.sd_of(name)
            elif name == "course_rad" and {"heading_rad", "sideslip_rad"} <= set(held.fields):
                expected = held.value("heading_rad") + held.value("sideslip_rad")
                sd = sqrt(held.sd_of("heading_rad") ** 2 + held.sd_of("sideslip_rad") ** 2)
            else:
                continue
            off = value - expected
            if name.endswith("_rad"):
                off = float(np.arctan2(np.sin(off), np.cos(off)))
            found = self._record.innovations.setdefault(name, Innovations())
            found.stamp_s.append(stamp_s)
            found.value.append(off)
            found.sd.append(sqrt(sd * sd + getattr(self._config, setting) ** 2))

    def _refused(self, kind: str, reason: str, stamp_s: float) -> None:
        faults = self._record.faults
        for place in range(len(faults) - 1, -1, -1):
            last = faults[place]
            if (last.sensor, last.what) == (kind, reason) and stamp_s - last.to_s < JOINED_S:
                faults[place] = Fault(kind, reason, last.from_s, stamp_s, last.count + 1)
                return
        faults.append(Fault(kind, reason, stamp_s, stamp_s, 1))
