"""What a map is built from, and how: in this process or by workers."""

from __future__ import annotations

import os
from collections.abc import Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from pathlib import Path

from polemap.build.build_map import BuiltMap, assemble_map, build_map, unique_names
from polemap.build.city.cluster import open_cluster
from polemap.build.city.tiles import TILE_M
from polemap.build.city.work import DriveTask, observe_all, on_workers
from polemap.drivelog.drive import Drive
from polemap.drivelog.frames import EarthFrame
from polemap.drivelog.jobs import LocalWorkers, Workers
from polemap.map.pole_map import PoleMap
from polemap.settings import Settings
from polemap.tools.drive_detection import Source
from polemap.tools.map_worker import observe_task, scan
from polemap.tools.progress import progress


@dataclass(frozen=True, slots=True)
class MapJob:
    """What a map is built from, how, and where to."""

    paths: list[Path]
    out: Path
    lap: str | None
    old: PoleMap | None
    topics: Path | None
    odometry: str
    seed: int
    workers: int | None
    scheduler: str | None
    align: bool
    index: bool
    slam: bool
    poses: Path | None
    settings: Settings
    update: Path | None = None

    @property
    def mapping(self) -> str | None:
        """The file that maps topics, found from every process."""
        return None if self.topics is None else os.path.realpath(self.topics)

    @property
    def checkpoints(self) -> Path:
        """Keeps the drives that are done, so that a killed build goes on."""
        return self.out.parent / f".{self.out.name}.checkpoints"

    @property
    def is_serial(self) -> bool:
        """Whether this process does it all."""
        return self.workers is None and self.scheduler is None

    def drives(self) -> list[Drive]:
        """The drives, opened; with their motion where this process detects their poles."""
        sources = [Source(str(p), self.lap, self.mapping, self.odometry) for p in self.paths]
        return [s.open(self.seed) if self.is_serial else s.recorded(self.seed) for s in sources]

    def build(self, drives: list[Drive]) -> BuiltMap:
        """The map of the drives, in this process or by workers: the same either way."""
        return _build(self, drives) if self.is_serial else _build_in_processes(self, drives)

    def tasks(self, drives: Sequence[Drive], frame: EarthFrame) -> list[DriveTask]:
        """A task a drive, for workers that open it themselves."""
        text = self.settings.model_dump_json()
        return [
            DriveTask(
                os.path.realpath(path), name, self.lap, self.seed, frame, text, self.mapping,
                self.odometry,
            )
            for path, name in zip(self.paths, unique_names(drives), strict=True)
        ]  # fmt: skip

    def pool(self) -> AbstractContextManager[Workers]:
        """The workers of the scheduler, or processes of this machine."""
        return open_workers(min(self.workers or 1, max(len(self.paths), 1)), self.scheduler)


def open_workers(workers: int | None, scheduler: str | None) -> AbstractContextManager[Workers]:
    """The workers of a scheduler, or processes of this machine."""
    if scheduler is not None:
        return open_cluster(scheduler)
    return nullcontext(LocalWorkers(workers or 1))


def _build(job: MapJob, drives: list[Drive]) -> BuiltMap:
    total = sum(len(d.frame_stamps_s) if d.has_frames else len(d.scans) for d in drives)
    with progress(total, "detecting poles") as advance:
        return build_map(
            drives,
            job.settings.polemap,
            lambda drive: scan(drive, job.settings, advance),
            update=job.old,
            align=job.align,
        )


def _build_in_processes(job: MapJob, drives: list[Drive]) -> BuiltMap:
    """A drive a worker; what they finished survives a killed run."""
    frame = job.old.frame if job.old is not None else drives[0].frame
    tasks = job.tasks(drives, frame)
    with job.pool() as workers:
        with progress(len(drives), "drives") as advance:
            parts = observe_all(tasks, observe_task, job.checkpoints, workers, advance)
        with progress(None, "merging tiles") as advance:
            return assemble_map(
                parts,
                job.settings.polemap.mapping,
                frame,
                update=job.old,
                align=job.align,
                run=on_workers(workers, advance),
                tile_m=TILE_M,
            )
