"""The votes of a tick: yaw rate, speed and size of turns over windows, shapes of turns."""

from __future__ import annotations

from polemap.electric.isolation.families import WINDOWS_S, Families
from polemap.electric.isolation.judgement import Judgement
from polemap.electric.isolation.late import LateSensor
from polemap.electric.isolation.late_votes import TURNS
from polemap.electric.isolation.motion import TICK_S, Motion, slow_between
from polemap.electric.isolation.proportions import SPAN_S, proportions
from polemap.electric.isolation.speed_watch import SpeedWatch
from polemap.electric.isolation.suspicion import TOGETHER_S, Suspicions
from polemap.vehicle.parameters import Car

_LEADS = "turns {:.2g} s earlier than"
_AMPLIFIES = "its turns are e^{:.2g} times those of"
_SHAPES_TICKS = 5


class FastVotes:
    """Judges the fast sensors against each other, tick by tick.

    Args:
        gps: what the receiver told; its courses vote on the shapes of turns.
        watch: keeps the speed to be believed.
        heard: names of the sensors that have spoken; grows.
    """

    def __init__(
        self,
        car: Car,
        motion: Motion,
        families: Families,
        suspicions: Suspicions,
        judgement: Judgement,
        gps: LateSensor,
        watch: SpeedWatch,
        heard: set[str],
    ) -> None:
        self._car, self._motion, self._families, self._heard = car, motion, families, heard
        self._suspicions, self._judgement = suspicions, judgement
        self._gps, self._watch = gps, watch
        self._since_shapes = 0

    def vote(self, now_s: float) -> None:
        """All windows that end now."""
        end = self._motion.now
        for window_s in WINDOWS_S:
            start = self._motion.before(window_s)
            if start is None or slow_between(start, end):
                return
            self._judgement.judge(self._families.yaw(start, end), start, now_s, window_s, TURNS)
            if window_s <= 2.0:
                speeds = self._families.speed(start, end)
                fresh = self._watch.fresh_fix()
                self._judgement.forward(speeds, start, end, now_s, window_s, fresh_fix=fresh)
            else:
                gains = self._families.gain(start, end)
                self._judgement.judge(gains, start, now_s, window_s, _AMPLIFIES)
        self._shapes(now_s)

    def _shapes(self, now_s: float) -> None:
        """Scales and lateness in the turns of the last seconds, four times a second."""
        self._since_shapes += 1
        start = self._motion.before(SPAN_S)
        if (
            self._since_shapes < _SHAPES_TICKS
            or start is None
            or slow_between(start, self._motion.now)
        ):
            return
        self._since_shapes = 0
        moments = [m for m in self._motion.moments if m.stamp_s >= start.stamp_s]
        fixes = [event for event in self._gps.events if event.moment.stamp_s >= start.stamp_s]
        gains, leads = proportions(self._car, moments, self._heard, fixes)
        self._suspicions.together_s = max(TOGETHER_S, 2.5 * _SHAPES_TICKS * TICK_S)
        self._judgement.judge(gains, start, now_s, SPAN_S, _AMPLIFIES)
        self._judgement.judge(leads, start, now_s, SPAN_S, _LEADS)
