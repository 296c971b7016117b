"""One run of one case, and its figures."""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.linalg import LinAlgError
from numpy.typing import NDArray

from benchmarks.campaign.judge import judge
from benchmarks.departures.routes import Course
from polemap.errors import PolemapError
from polemap.evaluation.errors import nees, pose_errors
from polemap.localize.config import LocalizeConfig
from polemap.localize.replay import Run, replay
from polemap.vehicle.trajectory import Trajectory

Floats = NDArray[np.float64]

SETTLED_S = 5.0
LOST_M = 2.0
DIVERGED = (ArithmeticError, LinAlgError, PolemapError, ValueError)
"""What a filter raises whose covariance or weights have come to nothing."""


@dataclass(frozen=True, slots=True)
class Figures:
    """Of one trajectory, from `SETTLED_S` after its first pose on.

    Attributes:
        lateral_m, along_m, position_m, yaw_deg: root mean squares.
        p95_m: of the position.
        nees: mean over degrees of freedom, 1 where the covariance is right.
        lost_share: of the judged poses, more than `LOST_M` off.
    """

    lateral_m: float
    along_m: float
    position_m: float
    yaw_deg: float
    p95_m: float
    nees: float
    lost_share: float


def run_case(course: Course, config: LocalizeConfig, seed: int) -> dict[str, Any]:
    """Figures of both filters, what was counted, and milliseconds an update; or how it failed."""
    begin = time.process_time()
    try:
        run = replay(course.drive, course.pole_map, course.scans, config, seed=seed)
    except DIVERGED as error:
        return {"failed": " ".join(f"{type(error).__name__}: {error}".split())[:150]}
    spent_s = time.process_time() - begin
    if not len(run.pf) or not len(run.kf):
        return {"failed": "no pose"}
    row: dict[str, Any] = {"counts": _counts(run), "cpu_ms": 1e3 * spent_s / len(course.scans)}
    if course.faulty is not None:
        verdicts = judge(run, course.faulty)
        row["silent_s"] = {name: verdict.silent_s for name, verdict in verdicts.items()}
    for name, track in (("pf", run.pf), ("kf", run.kf)):
        row[name] = None if (found := figures(track, course)) is None else asdict(found)
    if row["pf"] is None or row["kf"] is None:
        return {"failed": "no pose that could be judged"}
    return row


def _counts(run: Run) -> dict[str, int]:
    kept = ("reinitializations", "exploration_events", "gate_rejections", "start_corrections")
    return {k: v for k, v in run.counts.items() if v and k.removeprefix("pf_") in kept}


def figures(track: Trajectory, course: Course) -> Figures | None:
    """The figures of a trajectory; None where nothing can be judged."""
    true = course.truth(track.stamp_s)
    rows = np.isfinite(true).all(axis=1) & (track.stamp_s > track.stamp_s[0] + SETTLED_S)
    if not rows.any():
        return None
    poses, true = track.poses[rows], true[rows]
    error = pose_errors(poses, true)
    position = np.hypot(error[:, 0], error[:, 1])
    along, lateral, yaw = np.sqrt((error**2).mean(axis=0)).tolist()
    assert track.covariance is not None
    consistency = nees(poses, true, track.covariance[rows])
    known = np.isfinite(consistency)
    return Figures(
        lateral, along, float(np.sqrt((position**2).mean())), float(np.degrees(yaw)),
        float(np.quantile(position, 0.95)),
        float(np.mean(consistency[known]) / 3.0) if known.any() else float("inf"),
        float((position > LOST_M).mean()),
    )  # fmt: skip
