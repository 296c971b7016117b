"""`polemap map --update` with drives without a reference: first localized in the map."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import typer

from polemap.build.assemble import assemble_map
from polemap.build.build_map import BuiltMap, build_map, observe
from polemap.build.city.tiles import TILE_M
from polemap.build.city.work import DriveTask, observe_all, on_workers
from polemap.build.drive_observations import DriveObservations
from polemap.drivelog.detections import Detections
from polemap.drivelog.drive import Drive
from polemap.drivelog.errors import InputError
from polemap.drivelog.streams import ReferenceStream
from polemap.localize.replay import replay
from polemap.map.io import read_map
from polemap.map.pole_map import PoleMap
from polemap.settings import Settings
from polemap.tools.drive_detection import Source
from polemap.tools.map_job import MapJob
from polemap.tools.map_slam import lacks_reference
from polemap.tools.map_worker import scan
from polemap.tools.progress import progress

_KNOWN_M = 0.5  # an axis: worse poses would blur the map


@dataclass(frozen=True, slots=True)
class UpdateTask:
    """One drive to localize in a map, and to detect poles in; small, for a worker.

    Attributes:
        drive: the drive.
        pole_map: path of the map, as the worker sees it; sha256: of its content.
        asked: whether a drive that has a reference is localized too.
    """

    drive: DriveTask
    pole_map: str
    sha256: str
    asked: bool

    def key(self) -> str:
        """Names the computation, as that of `DriveTask`; with another map it is another."""
        text = f"{self.drive.key()} {self.sha256} {self.asked}"
        return hashlib.sha256(text.encode()).hexdigest()[:32]


def update_without_reference(
    job: MapJob, drives: Sequence[Drive], old: PoleMap
) -> tuple[BuiltMap, list[Drive]]:
    """Localize the drives in the old map, and bring it up to date from where they were.

    With `job.slam` those that have a reference are localized too. What the localizer does not know
    to `_KNOWN_M` has no part in the map. By workers, a drive a worker, the result is the same.

    Raises:
        FrameError, InputError: as localizing.
    """
    if job.is_serial:
        return _in_this_process(job, drives, old)
    return _by_workers(job, drives, old)


def _in_this_process(
    job: MapJob, drives: Sequence[Drive], old: PoleMap
) -> tuple[BuiltMap, list[Drive]]:
    placed, seen = [], {}
    for drive in drives:
        total = len(drive.frame_stamps_s) if drive.has_frames else len(drive.scans)
        with progress(total, "detecting poles") as advance:
            scans = scan(drive, job.settings, advance)
        if job.slam or lacks_reference(drive):
            with progress(None, "localizing in the old map"):
                drive = localized(drive, old, scans, job.settings, job.seed)
            assert drive.reference is not None
            _say(drive.name, drive.reference.sd_m)
        placed.append(drive)
        seen[id(drive)] = scans
    built = build_map(
        placed, job.settings.polemap, lambda drive: seen[id(drive)], update=old, align=job.align
    )
    return built, placed


def _by_workers(job: MapJob, drives: Sequence[Drive], old: PoleMap) -> tuple[BuiltMap, list[Drive]]:
    assert job.update is not None
    path = Path(os.path.realpath(job.update))
    digest = hashlib.sha256(path.read_bytes()).hexdigest()
    tasks = [UpdateTask(task, str(path), digest, job.slam) for task in job.tasks(drives, old.frame)]
    with job.pool() as workers:
        with progress(len(drives), "localizing in the old map") as advance:
            parts = observe_all(tasks, update_task, job.checkpoints, workers, advance)
        with progress(None, "merging tiles") as advance:
            built = assemble_map(
                parts, job.settings.polemap.mapping, old.frame, update=old, align=job.align,
                run=on_workers(workers, advance), tile_m=TILE_M,
            )  # fmt: skip
    placed = []
    for drive, part in zip(drives, parts, strict=True):
        if job.slam or lacks_reference(drive):
            drive = replace(drive, frame=old.frame, reference=_reference_of(part))
            assert drive.reference is not None
            _say(drive.name, drive.reference.sd_m)
        placed.append(drive)
    return built, placed


def update_task(task: UpdateTask) -> DriveObservations:
    """Localize one drive in the map, and give what it contributes."""
    one = task.drive
    settings = Settings.model_validate_json(one.settings)
    drive = Source(one.path, one.lap, one.topics, one.odometry).open(one.seed)
    scans = scan(drive, settings, lambda _steps: None)
    if task.asked or lacks_reference(drive):
        old = read_map(Path(task.pole_map), allow_empty=True)
        drive = localized(drive, old, scans, settings, one.seed)
    return observe(drive, one.name, scans, settings.polemap.mapping, one.frame)


def localized(
    drive: Drive, old: PoleMap, scans: Sequence[Detections], settings: Settings, seed: int
) -> Drive:
    """The drive with the localizer's poses as its reference, where they are known.

    Raises:
        InputError: they are known nowhere.
    """
    found = replay(replace(drive, images=None), old, scans, settings.localize, seed=seed).pf
    covariance = found.covariance
    assert covariance is not None
    sd_m = np.sqrt(np.maximum(np.trace(covariance[:, :2, :2], axis1=1, axis2=2) / 2.0, 1e-6))
    known = sd_m <= _KNOWN_M
    if not known.any():
        raise InputError(
            f"drive {drive.name}: it was nowhere localized in the map to {_KNOWN_M} m; update with "
            "drives that lie in the map, or solve for their poses without --update"
        )
    reference = ReferenceStream(found.stamp_s[known], found.poses[known], sd_m[known])
    return replace(drive, reference=reference)


def _reference_of(part: DriveObservations) -> ReferenceStream:
    """Where a worker localized its drive, at its scans."""
    seen, views = part.detections, part.detections.views
    if not len(seen.stamp_s):
        return ReferenceStream(views.stamp_s, views.poses, np.full(len(views.stamp_s), _KNOWN_M))
    order = np.argsort(seen.stamp_s, kind="stable")
    sd_m = np.interp(views.stamp_s, seen.stamp_s[order], seen.reference_sd_m[order])
    return ReferenceStream(views.stamp_s, views.poses, sd_m)


def _say(name: str, sd_m: np.ndarray) -> None:
    typer.echo(
        f"note: drive {name} was localized in the map: {len(sd_m)} of its scans are known to "
        f"{_KNOWN_M} m, {np.median(sd_m):.2f} m (median)"
    )
