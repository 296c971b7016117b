"""Poses of the particle filter on their way to the output filter: held, judged, handed over."""

from __future__ import annotations

import heapq
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from itertools import count
from math import nan
from typing import Literal

from polemap.localize.output_filter.filter import OutputFilter, usable_pose
from polemap.localize.particle_filter.estimate import PfEstimate
from polemap.localize.particle_filter.health import not_offered
from polemap.localize.stage_times import StageTimes
from polemap.vehicle.delay import Placement


@dataclass(frozen=True, slots=True)
class PoseUpdate:
    """A pose of the particle filter and what became of it.

    `decision`: "accepted", "ignored", "inflated", "vetoed", "reinitialized", "started",
    "not_offered:REASON" or "dropped:REASON". `taken_s` is when the output filter got it, `nis` its
    squared Mahalanobis distance there (three degrees of freedom; NaN where none was computed).
    With a clock, `update_s` and `offer_s` are the time that the particle filter took to come to it
    and the output filter to take it in.
    """

    estimate: PfEstimate
    decision: str
    taken_s: float
    nis: float = nan
    update_s: float = nan
    offer_s: float = nan


class PoseQueue:
    """Holds a pose until it would have been computed; then its health and the gate decide.

    Not for two threads at once: the localizer's lock of its fast half guards it.

    Args:
        output: takes the poses.
        counts: of what became of them, the localizer's.
        times: of the stages.
        delay_s: from the arrival of a frame to its pose, in a replay.
        on_update: called with every pose once its fate is known.
        slip_rad_per_mps2: outward slip of the rear axle, until the particle filter knows better.
        offered: poses that the particle filter's health speaks for, or all.
    """

    def __init__(
        self,
        output: OutputFilter,
        counts: Counter[str],
        times: StageTimes,
        delay_s: float,
        on_update: Callable[[PoseUpdate], None] | None,
        slip_rad_per_mps2: float,
        *,
        offered: Literal["healthy", "all"] = "healthy",
    ) -> None:
        self._all = offered == "all"
        self._output, self._counts, self._times = output, counts, times
        self._delay_s, self._on_update = delay_s, on_update
        self.slip_rad_per_mps2 = slip_rad_per_mps2
        # why the particle filter's last pose may not be trusted; without one the output stands for
        # itself
        self.particles_distrust = ""
        self._pending: list[tuple[float, int, PfEstimate, float]] = []
        self._numbers = count()

    def hold(self, estimate: PfEstimate, arrival_s: float, update_s: float = nan) -> None:
        """Keep a pose until it would have been computed."""
        taken = arrival_s + self._delay_s
        heapq.heappush(self._pending, (taken, next(self._numbers), estimate, update_s))
        self.release(arrival_s)

    def release(self, now_s: float) -> None:
        """Give the output filter the poses that have been computed by `now_s`."""
        while self._pending and self._pending[0][0] <= now_s:
            taken, _, estimate, update_s = heapq.heappop(self._pending)
            verdict = self._offer(estimate)
            if self._on_update is not None:
                decision, nis, offer_s = verdict
                self._on_update(PoseUpdate(estimate, decision, taken, nis, update_s, offer_s))

    def _offer(self, estimate: PfEstimate) -> tuple[str, float, float]:
        """Let the filter's health and then the gate decide; decision, NIS and time spent."""
        self.particles_distrust = "" if estimate.healthy else "particle_filter"
        if not estimate.healthy and estimate.detector:
            self.particles_distrust = "detector"
        problem = usable_pose(estimate.stamp_s, estimate.pose, estimate.covariance)
        if problem is not None:
            self._counts[f"pose_{problem}"] += 1
            return f"dropped:{problem}", nan, nan
        reason = None if self._all else not_offered(estimate)
        if reason is not None:
            self._counts[f"not_offered_{reason}"] += 1
            return f"not_offered:{reason}", nan, nan
        with self._times.of("output_pose"):
            placed = self._output.add_pose(
                estimate.stamp_s,
                estimate.pose,
                estimate.covariance,
                self.slip_rad_per_mps2,
                held=estimate.health.matched > 0,
            )
        if placed is Placement.TOO_OLD:
            self._counts["late_dropped"] += 1
        count_dropped(self._counts, "pose", placed)
        if placed in (Placement.TOO_OLD, Placement.DUPLICATE):
            return f"dropped:{placed.value}", nan, self._times.last_s("output_pose")
        return *self._output.decision_at(estimate.stamp_s), self._times.last_s("output_pose")


def count_dropped(counts: Counter[str], stream: str, placed: Placement | None) -> None:
    """Count what came too late or twice."""
    if placed in (Placement.TOO_OLD, Placement.DUPLICATE):
        counts[f"{stream}_{placed.value}"] += 1
