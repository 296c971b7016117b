"""From votes to accusations: who contradicts the others, and what is held against the faulty."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from polemap.electric.isolation.alone import FAST, FORWARD, WHEEL_SPEED
from polemap.electric.isolation.motion import Moment
from polemap.electric.isolation.speed import IMPOSSIBLE_MPS2
from polemap.electric.isolation.suspicion import Suspicions
from polemap.electric.isolation.votes import Vote, accused, contradict


class Judgement:
    """Judges the votes of a window.

    Args:
        suspicions: what speaks against each sensor so far.
        still: whether a fast sensor has kept its value for long.
        doubt_speed: told when the wheels are no longer believed: stamp and window, seconds.
    """

    def __init__(
        self,
        suspicions: Suspicions,
        still: Callable[[str], bool],
        doubt_speed: Callable[[float, float], None],
    ) -> None:
        self._suspicions, self._faulty = suspicions, suspicions.faulty
        self._still, self._doubt_speed = still, doubt_speed

    def accuse(self, name: str, now_s: float, window_s: float, what: str) -> None:
        """Evidence against one sensor."""
        if self._suspicions.accuse(name, now_s, window_s, what) and name == WHEEL_SPEED:
            self._doubt_speed(now_s, window_s)

    def judge(
        self, votes: dict[str, Vote], start: Moment, now_s: float, window_s: float, what: str
    ) -> None:
        """Accuse by majority of those that are trusted; hold what is faulty against them."""
        sound = {n: v for n, v in votes.items() if self._suspicions.comparable(n, start.stamp_s)}
        trusted = {name: vote for name, vote in sound.items() if name not in self._faulty}
        guilty, disputed = accused(trusted)
        for name in guilty:
            rest = [other for other in trusted if other not in guilty]
            off = trusted[name].value - float(np.mean([trusted[other].value for other in rest]))
            self.accuse(name, now_s, window_s, f"{what.format(off)} {' and '.join(rest)}")
        if disputed and not guilty:
            still = {n for n in disputed & set(FAST) if self._still(n)}
            for name in still:
                self.accuse(name, now_s, window_s, "constant while others move")
            if not still:
                self._suspicions.undecided(disputed, now_s)
        for name in self._faulty & sound.keys():
            against = sum(contradict(sound[name], vote) for vote in trusted.values())
            if against and 2 * against >= len(trusted):
                self._suspicions.still_against(name, now_s, window_s)

    def forward(
        self, votes: dict[str, Vote], start: Moment, end: Moment, now_s: float, window_s: float,
        *, fresh_fix: bool,
    ) -> None:  # fmt: skip
        """Wheels against ax alone: who gains what no car gains, or never moves."""
        names = (WHEEL_SPEED, FORWARD)
        if not all(n in votes and self._suspicions.comparable(n, start.stamp_s) for n in names):
            return
        wheel, ax = votes[WHEEL_SPEED], votes[FORWARD]
        if not contradict(wheel, ax):
            return
        both = self._faulty.intersection(names)
        for name in both:
            self._suspicions.still_against(name, now_s, window_s)
        if both:
            return
        t = end.stamp_s - start.stamp_s
        what = f"gains {(wheel.value - ax.value) / t:.2g} m/s2 otherwise than"
        if self._still(WHEEL_SPEED) or abs(wheel.value) > IMPOSSIBLE_MPS2 * t:
            self.accuse(WHEEL_SPEED, now_s, window_s, f"{what} the accelerometer")
        elif not fresh_fix and (window_s >= 2.0 or abs(ax.value) > IMPOSSIBLE_MPS2 * t):
            self.accuse(FORWARD, now_s, window_s, f"{what} the wheels")
