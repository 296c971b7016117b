"""One localized run of some laps, and what the paper's figures need of it."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.departures.judge import DIVERGED, LOST_M, SETTLED_S
from benchmarks.figures.laps import RATE_HZ, Laps
from polemap.drivelog.detections import Detections
from polemap.evaluation.errors import pose_errors
from polemap.evaluation.repeatability import deviations, repeatability
from polemap.localize.replay import Run, replay
from polemap.perception import scan_drive
from polemap.settings import Settings
from polemap.vehicle.trajectory import Trajectory

Floats = NDArray[np.float64]

EVERY = (1, 2, 3, 4, 10)
"""Frames of 22 Hz that are looked at: all, or every n-th: 22, 11, 7.3, 5.5 and 2.2 Hz."""
PARTICLES = (50, 100, 200, 500, 1000, 2000)
PRINTED_PARTICLES = 1000
_CAUSES = "pf_reinitializations_"


def rate_hz(every: int) -> float:
    """Frames a second."""
    return RATE_HZ / every


def scans_of(laps: Laps, settings: Settings, every: int) -> tuple[Detections, ...]:
    """What the perception makes of every n-th scan; a lower rate is tracked as such."""
    drive = replace(laps.drive, scans=laps.drive.scans[::every])
    return tuple(scan_drive(drive, settings.polemap))


def run_of(
    laps: Laps, settings: Settings, scans: Sequence[Detections], particles: int, seed: int,
    clock: Callable[[], float] | None = None,
) -> Run:  # fmt: skip
    """A Monte Carlo run."""
    config = settings.localize.model_copy(update={"particles": particles})
    return replay(laps.drive, laps.pole_map, scans, config, seed=seed, clock=clock)


def measured(
    laps: Laps, settings: Settings, scans: Sequence[Detections], particles: int, seed: int
) -> dict[str, Any]:
    """Figures of a run: of both filters, restarts by cause, milliseconds an update."""
    begin = time.process_time()
    try:
        run = run_of(laps, settings, scans, particles, seed)
    except DIVERGED as error:
        return {"failed": " ".join(f"{type(error).__name__}: {error}".split())[:150]}
    spent_s = time.process_time() - begin
    causes = {
        key.removeprefix(_CAUSES): count
        for key, count in run.counts.items()
        if key.startswith(_CAUSES) and count
    }
    return {
        "pf": track_figures(laps, run.pf),
        "kf": track_figures(laps, run.kf),
        "restarts": causes,
        "cpu_ms": 1e3 * spent_s / len(scans),
    }


def track_figures(laps: Laps, track: Trajectory) -> dict[str, float]:
    """Repeatability and accuracy of a trajectory, in metres.

    `missing` is the share of the true stations of all laps at which it has no pose near the road,
    `lost` that of its poses more than `LOST_M` off.
    """
    found = deviations(laps.stretch, [track], laps.guides)
    figure = repeatability([found.masked(_starting(laps, track))])
    there = np.isfinite(deviations(laps.stretch, [laps.truth], laps.guides).lateral_m)
    true = laps.truth.at(track.stamp_s)
    rows = np.isfinite(true).all(axis=1) & (track.stamp_s > track.stamp_s[0] + SETTLED_S)
    error = pose_errors(track.poses[rows], true[rows])
    along, lateral, _ = np.sqrt((error**2).mean(axis=0)).tolist()
    off = np.hypot(error[:, 0], error[:, 1]) > LOST_M
    return {
        "repeatability_m": figure.sd_m,
        "missing": float((there & ~np.isfinite(found.lateral_m)).sum() / max(there.sum(), 1)),
        "lateral_m": lateral,
        "along_m": along,
        "lost": float(off.mean()),
    }


def _starting(laps: Laps, track: Trajectory) -> NDArray[np.bool_]:
    """Stations `(passes, stations)` of the first `SETTLED_S`, which are left out as in a report."""
    path = laps.stretch.path
    mask = np.zeros((len(laps.stretch.passes), len(path.station_m)), dtype=np.bool_)
    until_s = track.stamp_s[0] + SETTLED_S
    guide = laps.guides[0]
    mask[0] = np.interp(path.station_m, guide.station_m, guide.stamp_s) < until_s
    return mask
