"""Sweeps: the same recordings replayed under other settings, several seeds each."""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from polemap import __version__
from polemap.drivelog.drive import Drive
from polemap.drivelog.errors import InputError, PolemapError
from polemap.evaluation.results import RouteResult, SystemResult
from polemap.evaluation.route import filter_system, measure
from polemap.evaluation.routes import Recording
from polemap.evaluation.runs.io import Run
from polemap.settings import Settings
from polemap.tools.detection_cache import drive_fingerprint, fingerprint
from polemap.tools.drive_detection import (
    DetectionJob,
    Source,
    detect_frames,
    detection_jobs,
    detection_settings,
    drop_damaged,
    is_readable,
    run_missing,
)
from polemap.tools.report.sweep_jobs import ReplayJob, do_replay, is_whole, read_result, thinned
from polemap.tools.report.sweep_spec import Sweep, SweepValue, settings_of


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

    def causes(self) -> dict[str, int]:
        """Re-initializations by cause over all runs; empty where the runs do not say."""
        total: Counter[str] = Counter()
        for run in (run for group in self.runs for run in group):
            total.update(run.metrics.get("reinitializations_by_cause", {}))
        return dict(total)


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
    detections = list({job.target: job for plan in plans for job in plan.detections}.values())
    drop_damaged(detections, is_readable)
    with progress(sum(job.steps for job in detections), "detecting poles") as advance:
        run_missing(detections, detect_frames, workers, advance)
    replays = list({job.target: job for plan in plans for job in plan.replays()}.values())
    drop_damaged(replays, is_whole)
    with progress(len(replays), "replaying the sweep") as advance:
        run_missing(replays, do_replay, workers, advance)
    swept = []
    with progress(len(plans), "measuring the sweep") as advance:
        for plan in plans:
            swept += [_measured(plan, sweep) for sweep in sweeps]
            advance(1)
    return swept, notes


@dataclass(frozen=True, slots=True)
class _Plan:
    """All that a route needs: `runs[sweep name][value][run][recording]`.

    A run that the report has anyway stands there itself, in place of a job.
    """

    result: RouteResult
    frame_rate_hz: float
    detections: tuple[DetectionJob, ...]
    runs: dict[str, list[list[list[ReplayJob | Run]]]]

    def replays(self) -> list[ReplayJob]:
        ones = (one for sweep in self.runs.values() for v in sweep for run in v for one in run)
        return [one for one in ones if isinstance(one, ReplayJob)]


def _plan(
    result: RouteResult, sweeps: Sequence[Sweep], folder: Path, runs: int, seed: int
) -> _Plan:
    detections: dict[str, DetectionJob] = {}
    planned: dict[str, list[list[list[ReplayJob | Run]]]] = {
        sweep.name: [[[] for _ in range(runs)] for _ in sweep.values] for sweep in sweeps
    }
    rates = []
    for recording in result.route.recordings:
        source, drive, map_file = _input(recording)
        known = drive_fingerprint(drive)
        stamps = drive.frame_stamps_s if drive.has_frames else [s.stamp_s for s in drive.scans]
        rates.append(1.0 / float(np.median(np.diff(stamps))) if len(stamps) > 1 else 0.0)
        inputs = (known, _digest(map_file), __version__)
        for sweep in sweeps:
            for number, value in enumerate(sweep.values):
                settings = settings_of(recording.main.config, value.settings)
                text = _text(settings)
                jobs = (
                    detection_jobs(source, drive, known, settings, folder)
                    if drive.has_frames
                    else []
                )
                detections |= {job.target: job for job in jobs}
                own = _own_runs(recording, value, text)
                files = tuple(job.target for job in jobs)
                seen = bool(files) and detection_settings(settings)
                for run in range(runs):
                    key = fingerprint(*inputs, text, seen, value.every, seed + run)
                    job = ReplayJob(
                        source, str(map_file), text, files, value.every, seed + run,
                        str(folder / f"run-{key}.npz"),
                    )  # fmt: skip
                    planned[sweep.name][number][run].append(own.get(seed + run, job))
    return _Plan(result, float(np.mean(rates)), tuple(detections.values()), planned)


def _input(recording: Recording) -> tuple[Source, Drive, Path]:
    """Where a recording comes from, as its runs opened it, and its map."""
    main = recording.main
    if recording.drive is None or main.drive is None:
        raise InputError("its drive cannot be read any more")
    if main.map is None:
        raise InputError("it was localized without a map")
    if not main.map.exists():
        raise InputError(f"its map {main.map} is gone")
    topics = None if main.topics is None else str(main.topics)
    source = Source(str(main.drive), main.lap, topics, str(main.config.get("odometry", "auto")))
    return source, source.open(), main.map


def _own_runs(recording: Recording, value: SweepValue, settings: str) -> dict[int, Run]:
    """By seed, the runs of the report that a value would only repeat."""
    config = recording.main.config
    own = _text(settings_of(config, ()))
    if value.every != 1 or settings != own or config.get("polemap_version") != __version__:
        return {}
    return {run.seed: thinned(run) for run in recording.main.runs}


def _measured(plan: _Plan, sweep: Sweep) -> SweptRoute:
    values = []
    for value, groups in zip(sweep.values, plan.runs[sweep.name], strict=True):
        runs = tuple(tuple(_result(one) for one in group) for group in groups)
        systems = [filter_system(kind, kind, value.label, runs) for kind in ("pf", "kf")]
        pf, kf = (measure(plan.result, system) for system in systems)
        values.append(SweptValue(value, runs, pf, kf))
    return SweptRoute(sweep, plan.result, plan.frame_rate_hz, tuple(values))


def _result(one: ReplayJob | Run) -> Run:
    return read_result(Path(one.target), one.seed) if isinstance(one, ReplayJob) else one


def _text(settings: Settings) -> str:
    """What a replay may depend on: neither the simulator nor how maps are built."""
    return settings.model_dump_json(exclude={"simulate": True, "polemap": {"mapping"}})


def _digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()[:16]
