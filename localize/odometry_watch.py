"""Odometry against itself and against what a car can do: steps, stuck values, impossible turns."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, replace
from math import inf, nan


@dataclass(frozen=True, slots=True)
class Held:
    """The last rates that were believed, since when they are not, and how the doubt began.

    Attributes:
        since_s: stamp of the last believed sample.
        speed_mps, yaw_rate_radps: of it.
        step_mps: by how much the speed jumped; 0 where poles or the yaw rate began the doubt.
        turn_doubted: whether the yaw rate is in doubt.
        speed_doubted: whether the speed is.
    """

    since_s: float
    speed_mps: float
    yaw_rate_radps: float
    step_mps: float = 0.0
    turn_doubted: bool = False
    speed_doubted: bool = True


class StuckSignal:
    """Does a signal repeat one value that never did so before? A sensor or its bus has stopped.

    A signal with noise in it repeats a value by chance only; `_REPEATS` in a row have happened by
    chance once in a million where one sample in ten is like its predecessor. Of a signal that
    repeats itself more often (a coarse one, a simulated one) nothing can be said.
    """

    _REPEATS, _USUAL, _KNOWN_AFTER = 6, 0.1, 100

    def __init__(self) -> None:
        self._value = nan
        self._repeats = self._known = 0
        self._share = 0.0

    def stuck(self, value: float) -> bool:
        """Take in a sample of a moving car."""
        same = value == self._value
        self._value = value
        self._repeats = self._repeats + 1 if same else 0
        if self._repeats < self._REPEATS:
            self._known += 1
            self._share += max(1.0 / self._known, 0.002) * (same - self._share)
            return False
        return self._known > self._KNOWN_AFTER and self._share < self._USUAL


class OdometryWatch:
    """May odometry be believed? In doubt from a contradiction until that is settled.

    A sample contradicts those of the last quarter second where the speed would need more than 1 g
    and a wheel sensor's own steps to get there, or the yaw rate more than 5 rad/s^2; and any car
    where it would need more than 1.2 g sideways or a turn in three seconds. With sensor noises of
    0.05 m/s and 0.003 rad/s (sd) a sound sample fails by more than eleven standard deviations of a
    difference. A speed or yaw rate that repeats one value while the car moves is stuck. Poles and
    fixes contradict by `contradict`.

    The doubt ends when the speed steps back by about as much and to where a car may have got to,
    when poles confirm the odometry, or when nothing has spoken against it for `_SETTLED_S`: by then
    the spread has grown beyond any use, and poles must prove the pose.

    Args:
        doubts: off, every sample is believed.
    """

    # what tyres can do, and by how much a wheel sensor's own steps may exceed it: many show nothing
    # below 0.7 m/s
    _ACCELERATION_MPS2, _SPEED_STEP_MPS = 10.0, 0.8
    _YAW_ACCELERATION_RADPS2, _TURN_STEP_RADPS = 5.0, 0.12
    _LATERAL_MPS2, _YAW_RATE_RADPS = 12.0, 2.1
    _COMPARED_S = 0.25
    # slower than this a yaw rate of zero is right
    _MOVING_MPS = 1.0
    # the way back: what a car mostly does, and how alike the two steps must be
    _USUAL_MPS2, _RETURN_MPS, _ALIKE = 3.0, 1.0, 0.5
    _SETTLED_S = 10.0
    # a turn of the wrong sign is right on every straight: once refuted again, it takes longer
    _FORGIVEN_S = 300.0

    def __init__(self, *, doubts: bool = True) -> None:
        self._doubts = doubts
        self._recent: deque[tuple[float, float, float]] = deque()
        self._held: Held | None = None
        self._contradicted_s = -inf
        self._refuted = 0
        self._stuck = (StuckSignal(), StuckSignal())
        self.contradictions = 0

    @property
    def held(self) -> Held | None:
        """The last believed rates while in doubt, None while odometry is believed."""
        return self._held

    def check(self, stamp_s: float, speed_mps: float, yaw_rate_radps: float) -> Held | None:
        """Take a sample in; what held before it while it is in doubt, None if it is believed."""
        if not self._doubts:
            return None
        recent = self._recent
        if recent and stamp_s <= recent[-1][0]:
            return self._held
        step = self._step(stamp_s, speed_mps)
        impossible = not (
            abs(speed_mps * yaw_rate_radps) <= self._LATERAL_MPS2
            and abs(yaw_rate_radps) <= self._YAW_RATE_RADPS
            and self._turns_smoothly(stamp_s, yaw_rate_radps)
        )
        stuck_speed, stuck_turn = self._repeats(speed_mps, yaw_rate_radps)
        if stuck_speed or stuck_turn:
            self._doubt(stamp_s, 0.0, turn=True, speed=stuck_speed)
        elif impossible or step:
            if step and not impossible and self._returns(stamp_s, speed_mps, step):
                self._held = None
            else:
                self._doubt(stamp_s, step, turn=impossible, speed=step != 0.0)
        elif self._held is not None and stamp_s - self._contradicted_s > self._patience_s:
            self._held = None
        if stamp_s - self._contradicted_s > self._FORGIVEN_S:
            self._refuted = 0
        if step or impossible:
            recent.clear()
        recent.append((stamp_s, speed_mps, yaw_rate_radps))
        while recent[0][0] < stamp_s - self._COMPARED_S:
            recent.popleft()
        return self._held

    def contradict(self, stamp_s: float) -> None:
        """Poles or fixes say that the odometry is wrong; in what, nobody knows."""
        if not self._doubts:
            return
        self._refuted += self._held is None
        self._doubt(stamp_s, 0.0, turn=True, speed=True)

    def confirm(self) -> None:
        """Poles say that it is right; what was refuted before must have been right for longer."""
        right_s = self._recent[-1][0] - self._contradicted_s if self._recent else inf
        if self._refuted < 2 or right_s > self._patience_s:
            self._held = None

    @property
    def _patience_s(self) -> float:
        return self._SETTLED_S * max(1, self._refuted)

    def _repeats(self, speed_mps: float, yaw_rate_radps: float) -> tuple[bool, bool]:
        if abs(speed_mps) < self._MOVING_MPS:
            return False, False
        speed, turn = self._stuck
        return speed.stuck(speed_mps), turn.stuck(yaw_rate_radps)

    def _doubt(self, stamp_s: float, step_mps: float, *, turn: bool, speed: bool) -> None:
        self._contradicted_s = stamp_s
        if self._held is None and self._recent:
            self.contradictions += 1
            self._held = Held(*self._recent[-1], step_mps, turn, speed)
        elif self._held is not None and (speed, turn) != (False, False):
            self._held = replace(
                self._held,
                turn_doubted=self._held.turn_doubted or turn,
                speed_doubted=self._held.speed_doubted or speed,
            )

    def _step(self, stamp_s: float, speed_mps: float) -> float:
        """The step that no car takes, 0 if there is none."""
        for then, before, _ in self._recent:
            allowed = self._SPEED_STEP_MPS + self._ACCELERATION_MPS2 * (stamp_s - then)
            if abs(speed_mps - before) > allowed:
                return speed_mps - before
        return 0.0

    def _turns_smoothly(self, stamp_s: float, yaw_rate_radps: float) -> bool:
        return all(
            abs(yaw_rate_radps - before)
            <= self._TURN_STEP_RADPS + self._YAW_ACCELERATION_RADPS2 * (stamp_s - then)
            for then, _, before in self._recent
        )

    def _returns(self, stamp_s: float, speed_mps: float, step_mps: float) -> bool:
        held = self._held
        if held is None or stamp_s - held.since_s > self._SETTLED_S:
            return False
        reach = self._RETURN_MPS + self._USUAL_MPS2 * (stamp_s - held.since_s)
        alike = abs(step_mps + held.step_mps) <= self._ALIKE * abs(held.step_mps)
        return alike and abs(speed_mps - held.speed_mps) <= reach
