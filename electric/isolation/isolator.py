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
    LATERAL,
    SPIKES,
    STEERING,
    WHEEL_SPEED,
    OwnChecks,
)
from polemap.electric.isolation.families import CAMERA, GPS, WINDOWS_S, Families
from polemap.electric.isolation.judgement import Judgement
from polemap.electric.isolation.late import LateSensor
from polemap.electric.isolation.motion import SLOW_MPS, TICK_S, Motion, slow_between
from polemap.electric.isolation.proportions import SPAN_S, proportions
from polemap.electric.isolation.speed import TrustedSpeed
from polemap.electric.isolation.suspicion import TOGETHER_S, Fault, Suspicions
from polemap.vehicle.parameters import Car

LATE = {CAMERA_KIND: CAMERA, GPS_KIND: GPS}
_ROWS_MIN = 4
_TURNING_RADPS = 0.12
# from value to value side-slip moves a course, and an unknown bend a heading, by so much at most
_SLIP_CHANGE_RAD, _LANE_CHANGE_RAD = 0.03, 0.012
# a value that stands for so long is the guilty one of two that contradict each other
_STILL_S = 0.4
_FRESH_S = 1.0
_TURNS = "turns by {:.2g} rad/s otherwise than"
_GAINS = "gains {:.2g} m/s otherwise than"
_LEADS = "turns {:.2g} s earlier than"
_SHAPES_TICKS = 5
_AMPLIFIES = "its turns are e^{:.2g} times those of"


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
        self._car, self._config = car, config
        self._suspicions = Suspicions((*FAST, GPS, CAMERA), faults)
        self.faulty = self._suspicions.faulty
        self.heard: set[str] = set()
        self.motion = Motion(car, stamp_s)
        self.speed = TrustedSpeed(speed_mps, self.motion)
        self._families = Families(car, config, self.heard)
        self._own = OwnChecks(stamp_s)
        self._judgement = Judgement(self._suspicions, self._still, self._doubt_speed)
        self._late = {
            GPS: LateSensor(config.course_sd_rad, _SLIP_CHANGE_RAD, in_lane=False),
            CAMERA: LateSensor(config.heading_sd_rad, _LANE_CHANGE_RAD, in_lane=True),
        }
        self._rows: list[Inputs] = []
        self._raw: list[Inputs] = []
        self._stamps: list[float] = []
        self._carried = self._since_shapes = 0
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
        self._follow_speed(rows[-1].speed_mps, now_s)
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
        self._vote(now_s)
        back = self._suspicions.acquit(now_s, judged=moving, alive=self._alive)
        if WHEEL_SPEED in back:
            self._speed_changed(now_s)
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
                self._judgement.accuse(name, now_s, 0.0, "silent")

    # speed

    def _by_ax(self) -> bool:
        return FORWARD in self.heard and FORWARD not in self.faulty

    def _follow_speed(self, wheel_mps: float, now_s: float) -> None:
        last = self.motion.now
        if WHEEL_SPEED in self.faulty:
            self.speed.carry(by_ax=self._by_ax())
            return
        gone = self.speed.leaps(wheel_mps, now_s - last.stamp_s)
        known = WHEEL_SPEED in self.heard and self.motion.before(1.0) is not None
        if gone and known and self.speed.mps > SLOW_MPS:
            what = f"leaps by {wheel_mps - self.speed.mps:.2g} m/s"
            self._judgement.accuse(WHEEL_SPEED, now_s, 0.0, what)
            return
        self.speed.follow(wheel_mps)

    def _doubt_speed(self, now_s: float, window_s: float) -> None:
        """Take the speed from before the wheels lied, and begin anew what rests on it."""
        before = self.motion.before(max(2.0 * window_s, 0.5)) or self.motion.moments[0]
        fix = self._late[GPS].events[-1] if self._fresh_fix() else None
        self.speed.from_before(before, fix, by_ax=self._by_ax())
        self._speed_changed(now_s)

    def _speed_changed(self, now_s: float) -> None:
        self._suspicions.compare_from((LATERAL, STEERING, FORWARD, CAMERA), now_s)

    def _fresh_fix(self) -> bool:
        events = self._late[GPS].events
        return (
            bool(events)
            and GPS not in self.faulty
            and self.motion.now.stamp_s - events[-1].moment.stamp_s < _FRESH_S
        )

    # late sensors

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
        late = self._late[name]
        if not late.arrived(stamp_s, angle_rad, other, arrival_s, sd_rad) or len(late.events) < 2:
            return
        self._suspicions.together_s = max(TOGETHER_S, late.together_s())
        last = late.events[-1]
        if slow_between(late.events[-2].moment, last.moment):
            return
        if late.constant():
            self._judgement.accuse(name, arrival_s, 0.0, "constant")
        if name == GPS:
            sd_rad = max(sd_rad, self._config.speed_sd_mps / max(self.speed.mps, 1.0))
        if late.noisy(sd_rad) and GYRO not in self.faulty:
            self._judgement.accuse(name, arrival_s, 0.0, "noise of many times its own")
        for window_s in WINDOWS_S:
            first = late.before(window_s)
            if first is None or slow_between(first.moment, last.moment):
                continue
            pair, start, end = (first, last), first.moment, last.moment
            if name == GPS:
                self._judgement.judge(
                    self._families.yaw(start, end, gps=pair), start, arrival_s, window_s, _TURNS
                )
                if window_s <= 2.0:
                    speeds = self._families.speed(start, end, pair)
                    self._judgement.judge(speeds, start, arrival_s, window_s, _GAINS)
                continue
            turns = self._families.yaw(start, end, camera=pair)
            self._judgement.judge(turns, start, arrival_s, window_s, _TURNS)
            sound = self._suspicions.comparable(CAMERA, start.stamp_s)
            if window_s <= 2.0 and sound and not self._families.across(first, last, self.faulty):
                what = "its offset does not move as its heading says"
                self._judgement.accuse(CAMERA, arrival_s, window_s, what)
        if name == GPS:
            self._compare_speed(late, arrival_s)

    def _compare_speed(self, late: LateSensor, now_s: float) -> None:
        """Wheel and GPS speeds that differ all the time: which of them the turning car tells."""
        last = late.events[-1]
        if WHEEL_SPEED not in self.heard:
            return
        differ = not self._families.same_speed(last)
        if WHEEL_SPEED in self.faulty:
            if differ:
                self._suspicions.still_against(WHEEL_SPEED, now_s, 2.0)
            if GPS not in self.faulty:
                self.speed.toward(last, by_ax=self._by_ax())
            return
        if not differ:
            return
        if GPS in self.faulty:
            self._suspicions.still_against(GPS, now_s, 2.0)
            return
        first = late.before(2.0)
        if first is None:
            return
        start, end = first.moment, last.moment
        guilty, t = WHEEL_SPEED, end.stamp_s - start.stamp_s
        turned = end.gyro - start.gyro
        if {LATERAL, GYRO} <= self.heard - self.faulty and abs(turned) > _TURNING_RADPS * t:
            # ay over the yaw rate is a third speed; the lateral turn is the integral of ay / v
            third = (end.lateral - start.lateral) / turned * (end.distance - start.distance) / t
            if abs(third - last.moment.wheel) < abs(third - last.other):
                guilty = GPS
        what = f"wheel speed and GPS differ by {last.moment.wheel - last.other:.2g} m/s"
        self._judgement.accuse(guilty, now_s, 2.0, what)

    # votes

    def _vote(self, now_s: float) -> None:
        end = self.motion.now
        for window_s in WINDOWS_S:
            start = self.motion.before(window_s)
            if start is None or slow_between(start, end):
                return
            self._judgement.judge(self._families.yaw(start, end), start, now_s, window_s, _TURNS)
            if window_s <= 2.0:
                speeds = self._families.speed(start, end)
                fresh = self._fresh_fix()
                self._judgement.forward(speeds, start, end, now_s, window_s, fresh_fix=fresh)
            else:
                gains = self._families.gain(start, end)
                self._judgement.judge(gains, start, now_s, window_s, _AMPLIFIES)
        self._shapes(now_s)

    def _shapes(self, now_s: float) -> None:
        """Scales and lateness in the turns of the last seconds, four times a second."""
        self._since_shapes += 1
        start = self.motion.before(SPAN_S)
        if (
            self._since_shapes < _SHAPES_TICKS
            or start is None
            or slow_between(start, self.motion.now)
        ):
            return
        self._since_shapes = 0
        moments = [m for m in self.motion.moments if m.stamp_s >= start.stamp_s]
        events = self._late[GPS].events
        fixes = [event for event in events if event.moment.stamp_s >= start.stamp_s]
        gains, leads = proportions(self._car, moments, self.heard, fixes)
        self._suspicions.together_s = max(TOGETHER_S, 2.5 * _SHAPES_TICKS * TICK_S)
        self._judgement.judge(gains, start, now_s, SPAN_S, _AMPLIFIES)
        self._judgement.judge(leads, start, now_s, SPAN_S, _LEADS)

    def _still(self, name: str) -> bool:
        return bool(self._own.still_s[FAST.index(name)] > _STILL_S)

    def course_offset(self) -> float:
        """What the newest course is ahead of the one before its fault and the gyro's turn since."""
        if GYRO in self.faulty:
            return 0.0
        return self._late[GPS].ahead_since(self._suspicions.since_s(GPS) - 1.0)

    def _alive(self, name: str) -> bool:
        late = self._late.get(name)
        return late is None or not (late.silent(self.motion.now.stamp_s) or late.constant())
