"""Which sensor is at fault: votes of yaw rate and speed, and what each tells of itself."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from polemap.electric.config import EstimatorConfig
from polemap.electric.estimators.base import CAMERA as CAMERA_KIND
from polemap.electric.estimators.base import GPS as GPS_KIND
from polemap.electric.estimators.base import Inputs
from polemap.electric.isolation.alone import (
    FAST,
    FORWARD,
    GYRO,
    SPIKES,
    STEERING,
    WHEEL_SPEED,
    OwnChecks,
)
from polemap.electric.isolation.families import CAMERA, GPS, Families
from polemap.electric.isolation.fast_votes import FastVotes
from polemap.electric.isolation.judgement import Judgement
from polemap.electric.isolation.late_votes import LateVotes, late_sensors
from polemap.electric.isolation.motion import SLOW_MPS, TICK_S, Motion
from polemap.electric.isolation.speed_watch import SpeedWatch
from polemap.electric.isolation.suspicion import TOGETHER_S, Fault, Suspicions
from polemap.vehicle.parameters import Car

LATE = {CAMERA_KIND: CAMERA, GPS_KIND: GPS}
SILENT = "silent"
_ROWS_MIN, _LEAPT_S = 4, 4.0
# a value that stands for so long is the guilty one of two that contradict each other
_STILL_S = 0.4


class Isolator:
    """Hears what an estimator hears and says which sensors not to believe.

    Attributes:
        faulty: names of the sensors that are held for faulty now.
        heard: names of the sensors that have spoken.
        motion: integrals of what the sensors say.
        speed: the wheels', or what stands in for it.
        next_s: stamp from which on `tick` is due.
    """

    def __init__(
        self,
        car: Car,
        config: EstimatorConfig,
        faults: list[Fault],
        stamp_s: float,
        speed_mps: float,
    ) -> None:
        self._suspicions = Suspicions((*FAST, GPS, CAMERA), faults)
        self.faulty = self._suspicions.faulty
        self.heard: set[str] = set()
        self.motion = Motion(car, stamp_s)
        self._late = late_sensors(config)
        self._watch = SpeedWatch(
            speed_mps, self.motion, self._suspicions, self.heard, self._late[GPS]
        )
        self.speed = self._watch.speed
        self._own = OwnChecks(stamp_s)
        self._judgement = Judgement(self._suspicions, self._still, self._watch.doubt)
        families = Families(car, config, self.heard)
        self._late_votes = LateVotes(
            self._late, families, self._suspicions, self._judgement, self._watch, config
        )
        self._fast_votes = FastVotes(
            car, self.motion, families, self._suspicions, self._judgement, self._late[GPS],
            self._watch, self.heard,
        )  # fmt: skip
        self._rows: list[Inputs] = []
        self._raw: list[Inputs] = []
        self._stamps: list[float] = []
        self._carried = 0
        self.next_s = stamp_s + TICK_S
        self.withheld = self._suspicions.withheld

    def hear(self, stamp_s: float, raw: Inputs, inputs: Inputs) -> None:
        """Inputs of the step that ends at the stamp, as they came and without single jumps."""
        self._raw.append(raw)
        self._rows.append(inputs)
        self._stamps.append(stamp_s)

    def tick(self) -> set[str]:
        """Twenty times a second, look at each sensor and at their votes; who is believed again."""
        rows = self._rows
        if len(rows) < _ROWS_MIN:
            return set()
        now_s = self._stamps[-1]
        self.next_s = now_s + TICK_S - 1e-6
        self._suspicions.together_s = TOGETHER_S
        leaps = self._watch.follow(rows[-1].speed_mps, now_s)
        if leaps is not None:
            self._judgement.accuse(WHEEL_SPEED, now_s, 0.0, leaps)
        self._carry()
        self.motion.tick()
        table, stamps = np.array(self._raw), np.array(self._stamps)
        rows.clear()
        self._raw.clear()
        self._stamps.clear()
        self._carried = 0
        # inputs have no notice of their own: a sensor that ever said other than 0 is there
        for name, column in ((STEERING, 0), (FORWARD, 3)):
            if name not in self.heard and table[:, column].any():
                self.heard.add(name)
        moving = self.speed.mps > SLOW_MPS
        self._look(table, stamps, now_s, moving=moving)
        self._fast_votes.vote(now_s)
        back = self._suspicions.acquit(now_s, judged=moving, alive=self._alive)
        if WHEEL_SPEED in back:
            self._watch.changed(now_s)
        return back

    def _carry(self) -> None:
        done = self._carried
        self.motion.carry(self._stamps[done:], self._rows[done:], self.speed.mps)
        self._carried = len(self._rows)

    def _look(
        self, table: NDArray[np.float64], stamps: NDArray[np.float64], now_s: float, *, moving: bool
    ) -> None:
        for name, what in self._own.look(stamps, table, moving).items():
            if name not in self.heard or not moving:
                continue
            if what == SPIKES:
                self._suspicions.spiked(name, what, now_s)
            else:
                self._judgement.accuse(name, now_s, 0.0, what)
        for name, late in self._late.items():
            if moving and late.silent(now_s):
                self._judgement.accuse(name, now_s, 0.0, SILENT)

    def noise(self, name: str) -> float:
        """What a fast sensor scatters by itself, 0 until that is learned."""
        return float(self._own.base[FAST.index(name)])

    def leapt(self, name: str, size: float, stamp_s: float) -> None:
        """A sensor has made a step that no car makes."""
        if name in self.heard and self.speed.mps > SLOW_MPS:
            self._judgement.accuse(name, stamp_s, 0.0, f"leaps by {size:.2g} within a row")
            # small steps show to votes over windows of two seconds only
            self._suspicions.trust_late(name, _LEAPT_S)

    def captured(self, kind: str, stamp_s: float) -> None:
        """A camera or a GPS measures now."""
        name = LATE.get(kind)
        if name is not None:
            self._carry()
            self._late[name].captured(self.motion.now._replace(stamp_s=stamp_s))

    def arrived(
        self,
        kind: str,
        stamp_s: float,
        angle_rad: float,
        other: float,
        arrival_s: float,
        sd_rad: float = 0.0,
    ) -> None:
        """Its value is there; `sd_rad` is what it states of its angle."""
        name = LATE[kind]
        self.heard.add(name)
        self._late_votes.arrived(name, stamp_s, angle_rad, other, arrival_s, sd_rad)

    def _still(self, name: str) -> bool:
        return bool(self._own.still_s[FAST.index(name)] > _STILL_S)

    def course_offset(self) -> float:
        """What the newest course is ahead of the one before its fault and the gyro's turn since."""
        if GYRO in self.faulty or self._suspicions.what(GPS) == SILENT:
            # side-slip and the gyro's own drift: a course that was only away is as good as before
            return 0.0
        return self._late[GPS].ahead_since(self._suspicions.since_s(GPS) - 1.0)

    def _alive(self, name: str) -> bool:
        late = self._late.get(name)
        return late is None or not (late.silent(self.motion.now.stamp_s) or late.constant())
