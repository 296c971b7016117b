"""Do odometry and poles tell one story? The tests that say they do not.

Each is a test at a stated level. What follows is the same whoever found the contradiction: the pose
is not called healthy, odometry counts for nothing until it is confirmed, and the spread grows by
what a car can do in the meantime. What odometry says against itself is found in
`odometry_watch.py`, whether fixes agree in `gnss/ekf_update.py`, whether poses do by the gate of
`output_filter/pose_update.py`. See docs/output_filter.md for all of them with their false alarms.
"""

from __future__ import annotations

from collections import deque
from math import log

import numpy as np
from numpy.typing import NDArray

from polemap.vehicle.pose import pose_rotation

Floats = NDArray[np.float64]


class PoleInnovations:
    """Do poles correct the motion by more than its noise explains?

    The corrections that the poles make to the pose, summed over a second, have in the mean the
    covariance by which the particles have narrowed; along, aside and in yaw each is a normal
    variable. Five standard deviations happen by chance once in 1.7 million independent windows;
    the largest on Victoria Park and on drives of points was 2.7.

    Source: Mehra (1972), covariance matching, as in `NoiseScale`.
    """

    _WINDOW_S, _LARGEST_SD = 1.0, 5.0
    # corrections this small may come from the map: metres, metres, radians
    _FLOOR = (0.08**2, 0.08**2, 0.008**2)

    def __init__(self) -> None:
        self._rows: deque[tuple[float, list[float], list[float]]] = deque()

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
        # particles of two opinions may spread more after a scan than before it
        narrowed = np.maximum(np.diag(turn @ (before[1] - after[1]) @ turn.T), 0.0)
        self._rows.append((stamp_s, (turn @ moved).tolist(), narrowed.tolist()))
        while self._rows[0][0] <= stamp_s - self._WINDOW_S:
            self._rows.popleft()
        for axis, floor in enumerate(self._FLOOR):
            total = sum(row[1][axis] for row in self._rows)
            expected = sum(row[2][axis] for row in self._rows) + floor
            if total**2 / expected > self._LARGEST_SD**2:
                return True
        return False

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


class StrangePoles:
    """Do the poles that are seen fit as those before did?

    A cumulative sum of the log-likelihood ratio between "as many fit, and as well, as did" and "a
    wrong pose or wrong ranges, where half fit, and none well", over the poles that are independent
    of those before. Of a pose metres off four in a row that match nothing are evidence where nine
    of ten did; ranges that are a tenth wrong show in the squared distances: 5 to 6 a pole, where
    drives of points have 1.5, Victoria Park 1.2 and a map whose own errors count, KITTI 03's, 3.

    Source: Page (1954), "Continuous inspection schemes", Biometrika 41.
    """

    # a wrong pose: share that fits by chance, squared distances that are as likely up to the gate
    _CHANCE, _GATE = 0.5, 14.0
    _MOST, _LEAST = 0.93, 0.55
    # until they are known: the share that fits, and the squared distance of those that do
    _START_SHARE, _START_MISFIT = 0.75, 2.3
    _MISFIT_LEAST, _MISFIT_MOST = 1.7, 2.7
    _MEMORY_POLES = 100.0
    # of a pole that is taken for its neighbour, in a pose that others hold too
    _MISTAKEN_M = 0.4
    _LIMIT, _SETTLED, _MOST_SUM = 5.0, 1.0, 8.0

    def __init__(self) -> None:
        self._share, self._misfit = self._START_SHARE, self._START_MISFIT
        self._sum = 0.0
        self.contradict = False

    @property
    def map_sd_m(self) -> float:
        """What the pose may be off by where the map is out of date: poles that are seen and not in
        it have neighbours that are in it and are gone, and now and then one is taken for the other.
        """
        return self._MISTAKEN_M * max(0.0, self._MOST - self._share)

    def add_scan(
        self, matched: int, seen: int, misfit: float, share: float, *, mapped: bool
    ) -> None:
        """Take in a scan; `contradict` says then whether they do not fit.

        Args:
            matched: of the poles seen, those that fit.
            seen: poles of the scan.
            misfit: sum of the squared distances of those that fit.
            share: of the scan that is independent of the last one.
            mapped: whether the map has poles where the scan looked; where not, it may end here.
        """
        if not seen or not mapped:
            return
        usual = min(max(self._share, self._LEAST), self._MOST)
        mean = min(max(self._misfit, self._MISFIT_LEAST), self._MISFIT_MOST)
        strange = log((1.0 - self._CHANCE) / (1.0 - usual))
        fitting = log(self._CHANCE / usual) + log(mean / self._GATE)
        gain = share * ((seen - matched) * strange + matched * fitting + misfit / mean)
        self._sum = min(max(0.0, self._sum + gain), self._MOST_SUM)
        if self._sum >= self._LIMIT:
            self.contradict = True
        elif self._sum <= self._SETTLED:
            self.contradict = False
        if self._sum <= self._SETTLED:
            weight = min(1.0, share * seen / self._MEMORY_POLES)
            self._share += weight * (matched / seen - self._share)
            if matched:
                self._misfit += weight * (misfit / matched - self._misfit)

    def forget(self) -> None:
        """After an initialization: the benefit of the doubt, but of half of it only."""
        self._sum, self.contradict = min(self._sum, 0.5 * self._LIMIT), False


class OdometryAgreement:
    """Do poles speak for an odometry that is in doubt?

    Particles that follow it and particles that move freely change places all the time. Where poles
    are seen and those that follow carry most of the weight for a second, the odometry is right: a
    wrong one loses them at every scan.
    """

    _MEMORY_S, _LEAST_MATCHED = 0.5, 0.7

    def __init__(self, share: float = 0.6, lasts_s: float = 1.0) -> None:
        self._share, self._lasts_s = share, lasts_s
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
        agrees = self._following > self._share and self._matched > self._LEAST_MATCHED
        self._agreed_s = self._agreed_s + elapsed_s if agrees else 0.0
        return self._agreed_s >= self._lasts_s

    def forget(self) -> None:
        """A new doubt."""
        self._following = self._matched = self._agreed_s = 0.0
