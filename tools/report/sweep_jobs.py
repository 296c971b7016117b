"""The work of a sweep in processes: every job leaves one file, so that a killed sweep resumes."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass, replace
from functools import lru_cache
from multiprocessing import get_context
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np

from drivelog.atomic import atomic_file
from drivelog.drive import Drive, open_drive
from drivelog.errors import InputError
from drivelog.samples import PoleScan
from localize.replay import replay
from polemap.io import read_map
from polemap.landmark_map import PoleMap
from tools.report.runs import Run
from tools.report.scan_cache import raw_scans, read_scans, tracked_scans, write_scans
from tools.report.trajectory import Trajectory
from tools.settings import Settings

FRAMES_A_TASK = 60
OUTPUT_SPACING_M = 0.1


@dataclass(frozen=True, slots=True)
class Input:
    """What a job reads: a drive (or a lap of it), as a run opened it, and the map."""

    drive: str
    lap: str | None
    drive_seed: int
    map: str


@dataclass(frozen=True, slots=True)
class DetectJob:
    """Detections of the frames `rows` of an input, to be kept at `target`."""

    source: Input
    settings: str
    rows: tuple[int, int]
    target: str


@dataclass(frozen=True, slots=True)
class ReplayJob:
    """One localized replay, to be kept at `target`; `scans` are the files of its detections."""

    source: Input
    settings: str
    scans: tuple[str, ...]
    every: int
    seed: int
    target: str


def run_jobs(
    jobs: Sequence[DetectJob | ReplayJob], workers: int, advance: Callable[[int], None]
) -> None:
    """Do every job whose file is not there yet."""
    todo = [job for job in jobs if not Path(job.target).is_file()]
    advance(len(jobs) - len(todo))
    if not todo:
        return
    if workers == 1:
        for job in todo:
            do_job(job)
            advance(1)
        return
    # One thread a process: the processes share the cores among themselves.
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        os.environ.setdefault(name, "1")
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        futures = [pool.submit(do_job, job) for job in todo]
        try:
            for future in as_completed(futures):
                future.result()
                advance(1)
        except BaseException:
            pool.shutdown(wait=True, cancel_futures=True)
            raise


def do_job(job: DetectJob | ReplayJob) -> None:
    """Do one job and keep its result."""
    settings = Settings.model_validate_json(job.settings)
    drive, pole_map = _open(job.source)
    if isinstance(job, DetectJob):
        rows = range(*job.rows)
        write_scans(Path(job.target), raw_scans(drive, settings.polemap, settings.stereo, rows))
        return
    scans = _tracked(job.source, job.settings, job.scans, job.every)
    begin = time.perf_counter()
    run = replay(
        replace(drive, images=None, scans=()),
        pole_map,
        scans,
        settings.localize,
        seed=job.seed,
        clock=time.perf_counter,
    )
    metrics = {**run.metrics, "replay_s": time.perf_counter() - begin}
    kf = Trajectory(run.kf.stamps_s, run.kf.poses).thinned(OUTPUT_SPACING_M)
    with atomic_file(Path(job.target)) as part, part.open("wb") as stream:
        np.savez_compressed(
            stream,
            pf_stamp_s=run.pf.stamps_s,
            pf_poses=run.pf.poses,
            kf_stamp_s=kf.stamp_s,
            kf_poses=kf.poses,
            metrics=np.array(json.dumps(_plain(metrics))),
        )


def read_result(path: Path, seed: int) -> Run:
    """What a replay job kept.

    Raises:
        InputError: the file is damaged.
    """
    try:
        with np.load(path, allow_pickle=False) as kept:
            return Run(
                seed=seed,
                pf=Trajectory(kept["pf_stamp_s"], kept["pf_poses"]),
                kf=Trajectory(kept["kf_stamp_s"], kept["kf_poses"]),
                health={},
                timings={},
                metrics=json.loads(str(kept["metrics"])),
            )
    except (OSError, ValueError, EOFError, KeyError, BadZipFile):
        raise InputError(
            f"{path}: this kept part of a sweep is damaged; delete it and rerun"
        ) from None


def open_input(source: Input) -> Drive:
    """The drive as the run opened it."""
    drive = open_drive(Path(source.drive), seed=source.drive_seed)
    return drive.lap(source.lap) if source.lap is not None else drive


@lru_cache(maxsize=4)
def _open(source: Input) -> tuple[Drive, PoleMap]:
    drive = open_input(source)
    return drive, read_map(Path(source.map), frame=drive.frame)


@lru_cache(maxsize=4)
def _tracked(
    source: Input, settings: str, files: tuple[str, ...], every: int
) -> tuple[PoleScan, ...]:
    drive, _ = _open(source)
    raw: list[PoleScan] = []
    for file in files:
        part = read_scans(Path(file))
        if part is None:
            raise InputError(f"{file}: this kept part of a sweep is damaged; delete it and rerun")
        raw += part
    if not drive.has_frames:
        raw = list(drive.scans)
    return tuple(tracked_scans(drive, raw, every, Settings.model_validate_json(settings).polemap))


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, np.generic):
        return _plain(value.item())
    if isinstance(value, float) and not np.isfinite(value):
        return None
    return value
