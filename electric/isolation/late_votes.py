"""What a value of camera or GPS says when it arrives: of its sensor, and as one vote of many."""

from __future__ import annotations

from polemap.electric.config import EstimatorConfig
from polemap.electric.isolation.alone import GYRO, LATERAL
from polemap.electric.isolation.families import CAMERA, GPS, WINDOWS_S, Families
from polemap.electric.isolation.judgement import Judgement
from polemap.electric.isolation.late import Event, LateSensor
from polemap.electric.isolation.motion import slow_between
from polemap.electric.isolation.speed_watch import DIFFER_S, SpeedWatch
from polemap.electric.isolation.suspicion import TOGETHER_S, Suspicions

TURNS, GAINS = "turns by {:.2g} rad/s otherwise than", "gains {:.2g} m/s otherwise than"
"""How votes of yaw rate and speed contradict the others."""
# a course that leaps: within so long, what ay errs by, what side-slip moves between two fixes in a
# slide, deviations of both courses
_LEAP_WITHIN_S, _LATERAL_MPS2, _LATERAL_SHARE = 1.1, 1.5, 0.2
_LEAP_SLIP_RAD, _LEAP_SD = 0.06, 8.0
# from value to value side-slip moves a course, and an unknown bend a heading, by so much at most
_SLIP_CHANGE_RAD, _LANE_CHANGE_RAD = 0.03, 0.012


def late_sensors(config: EstimatorConfig) -> dict[str, LateSensor]:
    """GPS and camera, nothing told yet."""
    return {
        GPS: LateSensor(config.course_sd_rad, _SLIP_CHANGE_RAD, in_lane=False),
        CAMERA: LateSensor(config.heading_sd_rad, _LANE_CHANGE_RAD, in_lane=True),
    }


class LateVotes:
    """Judges each late value against what the fast sensors told since earlier ones.

    Args:
        late: by name, as `late_sensors` makes them.
        watch: keeps the speed to be believed.
    """

    def __init__(
        self,
        late: dict[str, LateSensor],
        families: Families,
        suspicions: Suspicions,
        judgement: Judgement,
        watch: SpeedWatch,
        config: EstimatorConfig,
    ) -> None:
        self._late, self._families, self._suspicions = late, families, suspicions
        self._judgement, self._watch, self._config = judgement, watch, config

    def arrived(
        self,
        name: str,
        stamp_s: float,
        angle_rad: float,
        other: float,
        arrival_s: float,
        sd_rad: float,
    ) -> None:
        """A value of the sensor `name` is there; `sd_rad` is what it states of its angle."""
        late = self._late[name]
        if not late.arrived(stamp_s, angle_rad, other, arrival_s, sd_rad) or len(late.events) < 2:
            return
        self._suspicions.together_s = max(TOGETHER_S, late.together_s())
        last = late.events[-1]
        if slow_between(late.events[-2].moment, last.moment):
            return
        self._alone(name, late, arrival_s, sd_rad)
        for window_s in WINDOWS_S:
            first = late.before(window_s)
            if first is None or slow_between(first.moment, last.moment):
                continue
            if name == GPS:
                self._fixes(first, last, arrival_s, window_s)
            else:
                self._pictures(first, last, arrival_s, window_s)
        if name == GPS:
            evidence = self._watch.compare(self._families, arrival_s)
            if evidence is not None:
                self._judgement.accuse(evidence[0], arrival_s, DIFFER_S, evidence[1])

    def _alone(self, name: str, late: LateSensor, arrival_s: float, sd_rad: float) -> None:
        if late.constant():
            self._judgement.accuse(name, arrival_s, 0.0, "constant")
        if name == GPS:
            sd_rad = max(sd_rad, self._config.speed_sd_mps / max(self._watch.speed.mps, 1.0))
            if self._course_leaps(late.events[-2], late.events[-1], sd_rad):
                self._judgement.accuse(name, arrival_s, 0.0, "its course leaps")
        if late.noisy(sd_rad) and GYRO not in self._suspicions.faulty:
            self._judgement.accuse(name, arrival_s, 0.0, "noise of many times its own")

    def _course_leaps(self, last: Event, fix: Event, sd_rad: float) -> bool:
        """Whether a course turns within a fix as neither ay over the speed nor the gyro does.

        A course has no other way to turn than the lateral acceleration, a slide's too; the gyro,
        from which side-slip may set it apart, vouches for that accelerometer.
        """
        if not {GYRO, LATERAL} <= self._watch.heard - self._suspicions.faulty:
            return False
        start, end = last.moment, fix.moment
        t = end.stamp_s - start.stamp_s
        if t > _LEAP_WITHIN_S:
            return False
        turned = fix.angle_rad - last.angle_rad
        off = turned - (end.lateral - start.lateral)
        by_gyro = turned - (end.gyro - start.gyro)
        size = (end.lateral_size - start.lateral_size) * _LATERAL_SHARE
        speed = max((end.distance - start.distance) / t, 1.0)
        noise = _LEAP_SD * max(sd_rad, self._config.course_sd_rad)
        limit = size + _LATERAL_MPS2 / speed * t + noise
        return abs(off) > limit and abs(by_gyro) > _LEAP_SLIP_RAD + noise and off * by_gyro > 0.0

    def _fixes(self, first: Event, last: Event, arrival_s: float, window_s: float) -> None:
        pair, start, end = (first, last), first.moment, last.moment
        turns = self._families.yaw(start, end, gps=pair)
        self._judgement.judge(turns, start, arrival_s, window_s, TURNS)
        if window_s <= 2.0:
            speeds = self._families.speed(start, end, pair)
            self._judgement.judge(speeds, start, arrival_s, window_s, GAINS)

    def _pictures(self, first: Event, last: Event, arrival_s: float, window_s: float) -> None:
        start, end = first.moment, last.moment
        turns = self._families.yaw(start, end, camera=(first, last))
        self._judgement.judge(turns, start, arrival_s, window_s, TURNS)
        sound = self._suspicions.comparable(CAMERA, start.stamp_s)
        faulty = self._suspicions.faulty
        if window_s <= 2.0 and sound and not self._families.across(first, last, faulty):
            what = "its offset does not move as its heading says"
            self._judgement.accuse(CAMERA, arrival_s, window_s, what)
