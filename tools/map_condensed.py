"""`polemap map --slam` at length: drives condensed one by one, then solved together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import typer

from polemap.build.assemble import assemble_map
from polemap.build.build_map import unique_names
from polemap.build.city.tiles import TILE_M, here
from polemap.build.city.work import DriveTask, compute_all, on_workers
from polemap.build.slam.condense import Condensed, condense
from polemap.build.slam.io import read_condensed, write_condensed
from polemap.build.slam.skeleton import solve_condensed
from polemap.build.slam.slam import check_fixed
from polemap.drivelog.drive import Drive
from polemap.extras import check_installed
from polemap.settings import Settings
from polemap.tools.drive_detection import Source
from polemap.tools.map_job import MapJob
from polemap.tools.map_slam import BuiltWithoutReference, motion_noise
from polemap.tools.map_worker import scan
from polemap.tools.progress import progress

_WHOLE_M = 10_000.0  # of way that is solved as one graph of all its keyframes


def is_long(drives: Sequence[Drive]) -> bool:
    """Whether drives are too long for one graph of all their keyframes."""
    return sum(map(_way_m, drives)) > _WHOLE_M


def _way_m(drive: Drive) -> float:
    odometry = drive.odometry
    if odometry is None or len(odometry) < 2:
        return 0.0
    return float(np.abs(odometry.speed_mps[:-1]) @ np.diff(odometry.stamp_s))


def condense_task(task: DriveTask) -> Condensed:
    """Detect the poles of one drive and condense it."""
    settings = Settings.model_validate_json(task.settings)
    drive = Source(task.path, task.lap, task.topics, task.odometry).open(task.seed)
    return _condense(drive, task, settings)


def _condense(drive: Drive, task: DriveTask, settings: Settings) -> Condensed:
    scans = scan(drive, settings, lambda _steps: None)
    return condense(
        task.name, drive, scans, settings.polemap.mapping, settings.polemap.slam,
        motion_noise(settings.localize), task.frame,
    )  # fmt: skip


def build_condensed(job: MapJob, drives: Sequence[Drive]) -> BuiltWithoutReference:
    """Condense every drive, solve for the poses of all, and build the map with them.

    What is condensed survives a killed run. Serial or by workers, the result is the same.

    Raises:
        MissingExtraError: gtsam is not installed.
        InputError: see `solve_condensed`.
    """
    check_installed("gtsam")
    check_fixed(unique_names(drives), [d.gnss is not None and len(d.gnss) > 0 for d in drives])
    frame = drives[0].frame
    tasks = job.tasks(drives, frame)
    opened = {task.key(): drive for task, drive in zip(tasks, drives, strict=True)}

    def condense_opened(task: DriveTask) -> Condensed:
        return _condense(opened[task.key()], task, job.settings)

    with job.pool() as workers:
        with progress(len(drives), "condensing drives") as advance:
            parts = compute_all(
                tasks, condense_opened if job.is_serial else condense_task, job.checkpoints,
                workers, read_condensed, write_condensed, advance,
            )  # fmt: skip
        if len(drives) > 1 or is_long(drives):
            typer.echo(f"note: {len(drives)} drives are solved as nodes 30 m apart (docs/slam.md)")
        with progress(None, "solving poses and poles"):
            result, observed = solve_condensed(
                parts, job.settings.polemap.mapping, job.settings.polemap.slam
            )
        with progress(None, "merging tiles") as advance:
            built = assemble_map(
                observed, job.settings.polemap.mapping, result.frame, align=job.align,
                run=here if job.is_serial else on_workers(workers, advance),
                tile_m=None if job.is_serial else TILE_M,
            )  # fmt: skip
    built = replace(built, pole_map=result.with_precision(built.pole_map))
    solved = tuple(
        replace(drive, frame=result.frame, reference=reference)
        for drive, reference in zip(drives, result.references, strict=True)
    )
    return BuiltWithoutReference(built, solved, result)
