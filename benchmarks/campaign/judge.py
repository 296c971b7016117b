"""Is what the localizer says of itself true? The measure of the campaign."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from benchmarks.campaign.detector_faults import Faulty
from polemap.localize.replay import Run
from polemap.vehicle.trajectory import Trajectory

Floats = NDArray[np.float64]

WRONG_M, WRONG_SD, FAR_M = 0.5, 3.0, 3.0
PATIENCE_S = 1.0


@dataclass(frozen=True, slots=True)
class Verdict:
    """What became of one run, for one of the two filters.

    Attributes:
        silent_s: seconds healthy while wrong, in stretches of more than `PATIENCE_S`.
        healthy: share of the poses that were called healthy.
        worst_m: largest error while healthy.
        delay_s: from the begin of the fault to the first pose called unhealthy; NaN where there is
            none, or the fault was there from the start.
        back_s: from the end of the fault until the poses stay right and healthy; infinite where
            they do not, NaN where the fault lasts.
        outcome: "unaffected", "degraded and reported", "silently wrong" or "refused".
    """

    silent_s: float
    healthy: float
    worst_m: float
    delay_s: float
    back_s: float
    outcome: str


def judge(run: Run, faulty: Faulty) -> dict[str, Verdict]:
    """Verdicts on the particle filter (`pf`) and the output filter (`kf`)."""
    order = sorted(run.updates, key=lambda update: update.estimate.stamp_s)
    particle = np.array([update.estimate.healthy for update in order], dtype=bool)
    output = np.array([not reason for reason in run.distrust], dtype=bool)
    return {"pf": _of(run.pf, particle, faulty), "kf": _of(run.kf, output, faulty)}


def _of(track: Trajectory, healthy: NDArray[np.bool_], faulty: Faulty) -> Verdict:
    stamps, poses, covariance = track.stamp_s, track.poses, track.covariance
    assert covariance is not None
    reference = faulty.case.drive.reference
    assert reference is not None
    truth = reference.at(stamps) if len(stamps) else np.empty((0, 3))
    known = np.isfinite(truth).all(axis=1)
    stamps, poses, covariance = stamps[known], poses[known], covariance[known]
    healthy, truth = healthy[known], truth[known]
    if not len(stamps):
        return Verdict(0.0, 0.0, 0.0, np.nan, np.inf, "refused")
    offset = poses[:, :2] - truth[:, :2]
    error = np.hypot(*offset.T)
    unit = offset / np.maximum(error, 1e-9)[:, None]
    stated = np.sqrt(np.einsum("ni,nij,nj->n", unit, covariance[:, :2, :2], unit))
    wrong = ((error > WRONG_M) & (error > WRONG_SD * stated)) | (error > FAR_M)
    silent = stretches(stamps, wrong & healthy, PATIENCE_S)
    settled = healthy & (error <= WRONG_M)
    last_bad = np.flatnonzero(~settled)
    back = 0.0
    if len(last_bad):
        last = last_bad[-1]
        back = np.inf if last == len(stamps) - 1 else max(0.0, stamps[last] - faulty.until_s)
    if not np.isfinite(faulty.until_s):
        back = float("nan")
    after = stamps >= faulty.from_s
    reported = bool((~healthy[after]).any())
    noticed = stamps[after & ~healthy]
    delay = float(noticed[0] - faulty.from_s) if len(noticed) and faulty.from_s > 0 else np.nan
    outcome = (
        "silently wrong" if silent > 0 else "degraded and reported" if reported else ("unaffected")
    )
    worst = float(error[healthy].max()) if healthy.any() else 0.0
    return Verdict(silent, float(healthy.mean()), worst, delay, float(back), outcome)


def stretches(stamps: Floats, flag: NDArray[np.bool_], longer_s: float) -> float:
    """Total length of the unbroken stretches of a flag that last for more than `longer_s`."""
    edges = np.diff(np.concatenate([[0], flag.astype(np.int8), [0]]))
    begins, ends = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1) - 1
    lengths = stamps[ends] - stamps[begins]
    return float(lengths[lengths > longer_s].sum())
