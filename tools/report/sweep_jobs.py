"""The replays of a sweep: every job leaves one file, so that a killed sweep resumes."""

from __future__ import annotations

import json
import time
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np

from polemap.config import PolemapConfig
from polemap.drivelog.atomic import atomic_file
from polemap.drivelog.detections import Detections
from polemap.drivelog.errors import InputError
from polemap.evaluation.run_metrics import run_metrics
from polemap.evaluation.runs.io import Run
from polemap.localize.replay import replay
from polemap.map.city.city_map import CityMap
from polemap.map.city.io import open_map
from polemap.map.pole_map import PoleMap
from polemap.parsing.arrays import read_arrays
from polemap.parsing.errors import ParsingError, named
from polemap.parsing.json_text import parse_json, plain_values
from polemap.settings import Settings
from polemap.tools.drive_detection import Source, read_kept_scans, tracked
from polemap.vehicle.trajectory import Trajectory

OUTPUT_SPACING_M = 0.1


@dataclass(frozen=True, slots=True)
class ReplayJob:
    """One localized replay, kept at `target`; `detections` are the files of its detections."""

    source: Source
    map: str
    settings: str
    detections: tuple[str, ...]
    every: int
    seed: int
    target: str

    @property
    def steps(self) -> int:
        return 1


def do_replay(job: ReplayJob) -> None:
    """Do one job and keep its result."""
    settings = Settings.model_validate_json(job.settings)
    drive = replace(job.source.open(job.seed), images=None, scans=())
    scans = _tracked(job.source, settings.polemap.model_dump_json(), job.detections, job.every)
    begin = time.perf_counter()
    run = replay(
        drive,
        _map(job.map, job.source),
        scans,
        settings.localize,
        seed=job.seed,
        clock=time.perf_counter,
    )
    metrics = {**run_metrics(run, drive), "replay_s": time.perf_counter() - begin}
    kf = run.kf.thinned(OUTPUT_SPACING_M)
    with atomic_file(Path(job.target)) as part, part.open("wb") as stream:
        np.savez_compressed(
            stream,
            pf_stamp_s=run.pf.stamp_s,
            pf_poses=run.pf.poses,
            kf_stamp_s=kf.stamp_s,
            kf_poses=kf.poses,
            metrics=np.array(json.dumps(plain_values(metrics))),
        )


def read_result(path: Path, seed: int) -> Run:
    """What a replay job kept.

    Raises:
        InputError: the file is damaged.
    """
    with named(path, InputError, "kept part of a sweep"):
        kept = read_arrays(path)
        metrics = parse_json(str(kept["metrics"]))
        if not isinstance(metrics, dict):
            raise ParsingError("its metrics are no object")
        return Run(
            seed=seed,
            pf=Trajectory(kept["pf_stamp_s"], kept["pf_poses"]),
            kf=Trajectory(kept["kf_stamp_s"], kept["kf_poses"]),
            health={},
            timings={},
            metrics=metrics,
        )


def is_whole(job: ReplayJob) -> bool:
    """Whether what a replay job kept can be read."""
    try:
        read_result(Path(job.target), job.seed)
    except InputError:
        return False
    return True


def thinned(run: Run) -> Run:
    """A run of a run folder as `read_result` would give it."""
    return replace(run, kf=run.kf.thinned(OUTPUT_SPACING_M))


@lru_cache(maxsize=2)
def _map(path: str, source: Source) -> PoleMap | CityMap:
    return open_map(Path(path), frame=source.open().frame)


@lru_cache(maxsize=2)
def _tracked(
    source: Source, polemap: str, detections: tuple[str, ...], every: int
) -> tuple[Detections, ...]:
    drive = source.open()
    raw = read_kept_scans(detections)[0] if detections else drive.scans
    return tracked(drive, raw, PolemapConfig.model_validate_json(polemap), every=every).scans
