"""Sweeps: the same recordings replayed under other settings, several seeds each."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from drivelog.errors import InputError, PolemapError
from tools.report.evaluate import measure
from tools.report.results import RouteResult, System, SystemResult
from tools.report.routes import Recording
from tools.report.runs import Run
from tools.report.scan_cache import drive_fingerprint, fingerprint
from tools.report.sweep_jobs import (
    FRAMES_A_TASK,
    DetectJob,
    Input,
    ReplayJob,
    open_input,
    read_result,
    run_jobs,
)
from tools.report.sweep_spec import Sweep, SweepValue, settings_of
from tools.settings import Settings

Advance = Callable[[int], None]
# What a detection depends on; the rest of the settings may change without looking again.
_SEEN_BY = ("stereo", "polemap.detection")


@dataclass(frozen=True, slots=True)
class SweptValue:
    """One value on one route: `runs[run][recording]` and what they measure."""

    value: SweepValue
    runs: tuple[tuple[Run, ...], ...]
    pf: SystemResult
    kf: SystemResult

    def total(self, key: str) -> list[int]:
        """A count of metrics.json per run, over the recordings."""
        return [sum(int(run.metrics.get(key, 0)) for run in group) for group in self.runs]


@dataclass(frozen=True, slots=True)
class SweptRoute:
    """One sweep on one route."""

    sweep: Sweep
    result: RouteResult
    frame_rate_hz: float
    values: tuple[SweptValue, ...]


def run_sweeps(
    results: Sequence[RouteResult],
    sweeps: Sequence[Sweep],
    folder: Path,
    runs: int,
    seed: int,
    workers: int,
    progress: Callable[[int, str], Any],
) -> tuple[list[SweptRoute], list[str]]:
    """Replay every route under every value; returns the results, and why a route was left out.

    Args:
        folder: keeps detections and replays; what is there is not done again.
        runs: seeds seed ... seed + runs - 1 of every value.
        progress: context manager of a progress bar, given total and text.

    Raises:
        InputError: no route can be replayed.
    """
    notes: list[str] = []
    plans: list[_Plan] = []
    for result in results:
        try:
            plans.append(_plan(result, sweeps, folder, runs, seed))
        except PolemapError as error:
            notes.append(f"{result.route.name}: no sweep ({error})")
    if not plans:
        raise InputError("--sweep: no route can be replayed; " + "; ".join(notes))
    detect = list({job.target: job for plan in plans for job in plan.detect}.values())
    with progress(len(detect), "looking for poles") as advance:
        run_jobs(detect, workers, advance)
    replays = list({job.target: job for plan in plans for job in plan.replays()}.values())
    with progress(len(replays), "replaying the sweep") as advance:
        run_jobs(replays, workers, advance)
    swept = []
    with progress(len(plans), "measuring the sweep") as advance:
        for plan in plans:
            swept += [_measured(plan, sweep) for sweep in sweeps]
            advance(1)
    return swept, notes


@dataclass(frozen=True, slots=True)
class _Plan:
    """All jobs of a route: `replay[sweep name][value][run][recording]`."""

    result: RouteResult
    frame_rate_hz: float
    detect: tuple[DetectJob, ...]
    replay: dict[str, list[list[list[ReplayJob]]]]

    def replays(self) -> list[ReplayJob]:
        return [j for sweep in self.replay.values() for v in sweep for run in v for j in run]


def _plan(
    result: RouteResult, sweeps: Sequence[Sweep], folder: Path, runs: int, seed: int
) -> _Plan:
    detect: list[DetectJob] = []
    replays: dict[str, list[list[list[ReplayJob]]]] = {
        sweep.name: [[[] for _ in range(runs)] for _ in sweep.values] for sweep in sweeps
    }
    rates = []
    for recording in result.route.recordings:
        source = _input(recording)
        drive = open_input(source)
        known = drive_fingerprint(drive)
        stamps = drive.frame_stamps_s if drive.has_frames else [s.stamp_s for s in drive.scans]
        rates.append(1.0 / float(np.median(np.diff(stamps))) if len(stamps) > 1 else 0.0)
        map_key = fingerprint(Path(source.map).stat().st_size, _digest(Path(source.map)))
        for sweep in sweeps:
            for number, value in enumerate(sweep.values):
                settings = settings_of(recording.main.config, value.settings)
                text = settings.model_dump_json(exclude={"simulate"})
                files: list[str] = []
                if drive.has_frames:
                    jobs = _detect_jobs(source, settings, folder, known, len(drive.frame_stamps_s))
                    detect += jobs
                    files = [job.target for job in jobs]
                for run in range(runs):
                    key = fingerprint(known, map_key, text, files and _seen(settings),
                                      value.every, seed + run)  # fmt: skip
                    job = ReplayJob(
                        source, text, tuple(files), value.every, seed + run,
                        str(folder / f"run-{key}.npz"),
                    )  # fmt: skip
                    replays[sweep.name][number][run].append(job)
    return _Plan(result, float(np.mean(rates)), tuple(detect), replays)


def _input(recording: Recording) -> Input:
    main = recording.main
    if recording.drive is None or main.drive is None:
        raise InputError("its drive cannot be read any more")
    if main.map is None:
        raise InputError("it was localized without a map")
    if not main.map.is_file():
        raise InputError(f"its map {main.map} is gone")
    return Input(str(main.drive), main.lap, main.runs[0].seed, str(main.map))


def _detect_jobs(
    source: Input, settings: Settings, folder: Path, known: str, frames: int
) -> list[DetectJob]:
    key = fingerprint(known, _seen(settings))
    text = settings.model_dump_json(exclude={"simulate"})
    jobs = []
    for first in range(0, frames, FRAMES_A_TASK):
        last = min(first + FRAMES_A_TASK, frames)
        target = str(folder / f"scans-{key}-{first:06d}.npz")
        jobs.append(DetectJob(source, text, (first, last), target))
    return jobs


def _seen(settings: Settings) -> dict[str, Any]:
    tree = settings.model_dump(mode="json")
    found = {}
    for name in _SEEN_BY:
        part = tree
        for key in name.split("."):
            part = part[key]
        found[name] = part
    return found


def _measured(plan: _Plan, sweep: Sweep) -> SweptRoute:
    values = []
    for value, jobs in zip(sweep.values, plan.replay[sweep.name], strict=True):
        runs = tuple(tuple(read_result(Path(j.target), j.seed) for j in group) for group in jobs)
        systems = [
            System(kind, kind, value.label, tuple(tuple(getattr(r, kind) for r in g) for g in runs))
            for kind in ("pf", "kf")
        ]
        pf, kf = (measure(plan.result, system) for system in systems)
        values.append(SweptValue(value, runs, pf, kf))
    return SweptRoute(sweep, plan.result, plan.frame_rate_hz, tuple(values))


def _digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()[:16]
