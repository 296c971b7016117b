"""Do odometry, poles and the car's own limits tell one story? The tests that say they do not.

Each is a test at a stated level, or a limit of what a car can do. What follows is the same whoever
found the contradiction: the pose is not called healthy, odometry counts for nothing until it is
confirmed, and the spread grows by what a car can do in the meantime. Whether fixes agree is tested
in `gnss/ekf_update.py`, whether poses do by the gate of `output_filter/pose_update.py`. See
docs/output_filter.md for all of them with their false alarms.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from math import inf

import numpy as np
from numpy.typing import NDArray

from polemap.vehicle.pose import pose_rotation

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Held:
    """The last rates that were believed, since when they are not, and how the doubt began.

    Attributes:
        since_s: stamp of the last believed sample.
        speed_mps, yaw_rate_radps: of it.
        step_mps: by how much the speed jumped; 0 where poles or the yaw rate began the doubt.
        turn_doubted: whether the yaw rate is in doubt too.
    """

    since_s: float
    speed_mps: float
    yaw_rate_radps: float
    step_mps: float = 0.0
    turn_doubted: bool = False


class OdometryWatch:
    """May odometry be believed? In doubt from a contradiction until that is settled.

    A sample contradicts those of the last quarter second where the speed would need more than 1 g
    and a wheel sensor's own steps to get there, or the yaw rate more than 5 rad/s^2; and any car
    where it would need more than 1.2 g sideways or a turn in three seconds. With sensor noises of
    0.05 m/s and 0.003 rad/s (sd) a sound sample fails by more than eleven standard deviations of a
    difference. Poles and fixes contradict by `contradict`.

    The doubt ends when the speed steps back by about as much and to where a car may have got to,
    when poles confirm the odometry, or when nothing has spoken against it for `_SETTLED_S`: by then
    the spread has grown beyond any use, and poles must prove the pose.
    """

    # what tyres can do, and by how much a wheel sensor's own steps may exceed it: many show nothing
    # below 0.7 m/s
    _ACCELERATION_MPS2, _SPEED_STEP_MPS = 10.0, 0.8
    _YAW_ACCELERATION_RADPS2, _TURN_STEP_RADPS = 5.0, 0.12
    _LATERAL_MPS2, _YAW_RATE_RADPS = 12.0, 2.1
    _COMPARED_S = 0.25
    # the way back: what a car mostly does, and how alike the two steps must be
    _USUAL_MPS2, _RETURN_MPS, _ALIKE = 3.0, 1.0, 0.5
    _SETTLED_S = 10.0
    # a turn of the wrong sign is right on every straight: once refuted again, it takes longer
    _FORGIVEN_S = 300.0

    def __init__(self) -> None:
        self._recent: deque[tuple[float, float, float]] = deque()
        self._held: Held | None = None
        self._contradicted_s = -inf
        self._refuted = 0
        self.contradictions = 0

    @property
    def held(self) -> Held | None:
        """The last believed rates while in doubt, None while odometry is believed."""
        return self._held

    def check(self, stamp_s: float, speed_mps: float, yaw_rate_radps: float) -> Held | None:
        """Take a sample in; what held before it while it is in doubt, None if it is believed."""
        recent = self._recent
        if recent and stamp_s <= recent[-1][0]:
            return self._held
        step = self._step(stamp_s, speed_mps)
        impossible = not (
            abs(speed_mps * yaw_rate_radps) <= self._LATERAL_MPS2
            and abs(yaw_rate_radps) <= self._YAW_RATE_RADPS
            and self._turns_smoothly(stamp_s, yaw_rate_radps)
        )
        if impossible or step:
            if step and not impossible and self._returns(stamp_s, speed_mps, step):
                self._held = None
            else:
                self._doubt(stamp_s, step, turn=impossible)
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
        self._refuted += self._held is None
        self._doubt(stamp_s, 0.0, turn=True)

    def confirm(self) -> None:
        """Poles say that it is right; what was refuted before must have been right for longer."""
        right_s = self._recent[-1][0] - self._contradicted_s if self._recent else inf
        if self._refuted < 2 or right_s > self._patience_s:
            self._held = None

    @property
    def _patience_s(self) -> float:
        return self._SETTLED_S * max(1, self._refuted)

    def _doubt(self, stamp_s: float, step_mps: float, *, turn: bool) -> None:
        self._contradicted_s = stamp_s
        if self._held is None and self._recent:
            self.contradictions += 1
            self._held = Held(*self._recent[-1], step_mps, turn)

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


class PoleInnovations:
    """Do poles correct the motion by more than its noise explains?

    The corrections that the poles make to the pose, summed over a second, have in the mean the
    covariance by which the particles have narrowed; along, aside and in yaw each is a normal
    variable. Five standard deviations happen by chance once in 1.7 million independent windows;
    the largest on Victoria Park and on drives of points was 2.7.

    Source: Mehra (1972), covariance matching, as in `NoiseScale`.
    """

    _WINDOW_S, _LARGEST_SD = 1.0, 5.0
    # corrections this small are of no use to anybody: metres, metres, radians
    _FLOOR = np.array([0.05, 0.05, 0.005]) ** 2

    def __init__(self) -> None:
        self._rows: deque[tuple[float, Floats, Floats]] = deque()

    def contradict(
        self,
        stamp_s: float,
        before: tuple[Floats, Floats],
        after: tuple[Floats, Floats],
        *,
        steady: bool,
    ) -> bool:
        """Take in a scan; whether the last second contradicts the motion.

        Args:
            before, after: mean `(3,)` and covariance `(3, 3)` of the poses.
            steady: whether poles hold the pose and odometry moves it; else the window starts anew.
        """
        if not steady:
            self.forget()
            return False
        turn = pose_rotation(before[0][2]).T
        moved = after[0] - before[0]
        moved[2] = np.arctan2(np.sin(moved[2]), np.cos(moved[2]))
        self._rows.append((stamp_s, turn @ moved, np.diag(turn @ (before[1] - after[1]) @ turn.T)))
        while self._rows[0][0] <= stamp_s - self._WINDOW_S:
            self._rows.popleft()
        total = np.sum([row[1] for row in self._rows], axis=0)
        expected = np.maximum(np.sum([row[2] for row in self._rows], axis=0), 0.0) + self._FLOOR
        return bool(np.max(total**2 / expected) > self._LARGEST_SD**2)

    def forget(self) -> None:
        """Start a new window."""
        self._rows.clear()


class UnmatchedPoles:
    """Are poles seen, and the map's in view, and they are not the same? Evidence within a second.

    The matches that can be hoped for are the smaller of the poles seen and the detections expected.
    Where that is half a match a scan or more, a right pose finds six or seven of ten; that a whole
    second of scans finds less than one in ten did not happen in the healthy time of Victoria Park.
    """

    _WINDOW_S, _LEAST_S = 1.0, 0.8
    _LEAST_HOPE, _LEAST_SHARE = 0.5, 0.1

    def __init__(self) -> None:
        self._rows: deque[tuple[float, int, float]] = deque()

    def contradict(self, stamp_s: float, matched: int, possible: float) -> bool:
        """Take in a scan: poles that match, and matches that could be hoped for."""
        rows = self._rows
        rows.append((stamp_s, matched, possible))
        while rows[0][0] < stamp_s - self._WINDOW_S:
            rows.popleft()
        if stamp_s - rows[0][0] < self._LEAST_S:
            return False
        hoped = sum(row[2] for row in rows)
        found = sum(row[1] for row in rows)
        return hoped >= self._LEAST_HOPE * len(rows) and found < self._LEAST_SHARE * hoped

    def forget(self) -> None:
        """After an initialization: the benefit of the doubt."""
        self._rows.clear()


class OdometryAgreement:
    """Do poles speak for an odometry that is in doubt?

    Particles that follow it and particles that move freely change places all the time. Where poles
    are seen and those that follow carry most of the weight for a second, the odometry is right: a
    wrong one loses them at every scan.
    """

    _MEMORY_S, _LASTS_S = 0.5, 1.0
    _SHARE, _LEAST_MATCHED = 0.6, 1.0

    def __init__(self) -> None:
        self._following = self._matched = self._agreed_s = 0.0

    def confirm(self, following: float, matched: int, elapsed_s: float) -> bool:
        """Take in a scan; whether the odometry is confirmed.

        Args:
            following: weight of the particles that follow the odometry.
            matched: poles that fit.
            elapsed_s: since the last scan.
        """
        gain = min(1.0, elapsed_s / self._MEMORY_S)
        self._following += gain * (following - self._following)
        self._matched += gain * (matched - self._matched)
        agrees = self._following > self._SHARE and self._matched > self._LEAST_MATCHED
        self._agreed_s = self._agreed_s + elapsed_s if agrees else 0.0
        return self._agreed_s >= self._LASTS_S

    def forget(self) -> None:
        """A new doubt."""
        self._following = self._matched = self._agreed_s = 0.0
