"""The poles of every frame of a drive: found in parallel, kept where a cache is given, tracked.

Frames do not depend on one another before tracking, so chunks of them are jobs; every job leaves
one file, so that a killed one goes on where it was.
"""

from __future__ import annotations

import hashlib
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from time import perf_counter
from typing import Any, Protocol, TypeVar

import numpy as np

from polemap import __version__
from polemap.config import PolemapConfig
from polemap.drivelog.atomic import scratch_folder
from polemap.drivelog.camera_motion import CameraTrack, track_camera
from polemap.drivelog.detections import Detections
from polemap.drivelog.drive import Drive
from polemap.drivelog.errors import InputError
from polemap.drivelog.jobs import Advance, LocalWorkers, run_jobs
from polemap.drivelog.odometry_choice import with_odometry
from polemap.drivelog.readers.registry import open_drive
from polemap.perception import scan_drive
from polemap.settings import Settings
from polemap.tools.detection_cache import (
    STAGES,
    drive_fingerprint,
    fingerprint,
    raw_scans,
    read_scans,
    write_scans,
)
from polemap.tools.progress import progress

FRAMES_A_TASK = 20
# What a detection depends on; the rest of the settings may change without detecting again.
_DETECTION_SETTINGS = ("stereo", "polemap.detection")


@dataclass(frozen=True, slots=True)
class Source:
    """A drive on the disk, or the laps of it that `Drive.lap` understands.

    Attributes:
        topics: mapping of the topics of a log.
        odometry: where its motion comes from, see `with_odometry`.
    """

    drive: str
    lap: str | None
    topics: str | None = None
    odometry: str = "auto"

    def open(self, seed: int = 0) -> Drive:
        """The drive; `seed` is for sensors that it lacks and that are derived."""
        return with_odometry(self.recorded(seed), self.odometry, self._follow)

    def recorded(self, seed: int = 0) -> Drive:
        """The drive with the odometry that it was recorded with."""
        drive = open_drive(Path(self.drive), seed=seed, topics=self.topics)
        return drive if self.lap is None else drive.lap(self.lap)

    def _follow(self, _drive: Drive) -> CameraTrack:
        return _camera_track(self.drive, self.lap, self.topics)


@lru_cache(maxsize=4)
def _camera_track(drive: str, lap: str | None, topics: str | None) -> CameraTrack:
    """The camera's way, followed once in a process: it does not depend on the seed."""
    recorded = Source(drive, lap, topics).recorded()
    with progress(len(recorded.frame_stamps_s), "following the camera") as advance:
        return track_camera(recorded, advance)


@dataclass(frozen=True, slots=True)
class DriveDetections:
    """Tracked scans, and the seconds that each stage took, by the scan's stamp."""

    scans: tuple[Detections, ...]
    spent_s: Mapping[str, Mapping[float, float]]

    def total_s(self) -> dict[str, list[float]]:
        """Seconds a scan by stage, and of all of them together as `perception`."""
        stages = {name: list(spent.values()) for name, spent in self.spent_s.items()}
        return {**stages, "perception": [sum(one) for one in zip(*stages.values(), strict=True)]}


class Job(Protocol):
    """Work that leaves one file."""

    @property
    def target(self) -> str:
        """The file."""

    @property
    def steps(self) -> int:
        """How much of a progress bar it is worth."""


_Job = TypeVar("_Job", bound=Job)


@dataclass(frozen=True, slots=True)
class DetectionJob:
    """Detections of the frames `rows` of a drive, to be kept at `target`."""

    source: Source
    settings: str
    rows: tuple[int, int]
    target: str

    @property
    def steps(self) -> int:
        """Frames."""
        return self.rows[1] - self.rows[0]


def detect_drive(
    source: Source,
    drive: Drive,
    settings: Settings,
    workers: int,
    cache: Path | None,
    advance: Advance,
) -> DriveDetections:
    """The tracked poles of a drive, from its images or from the poles that lie beside it.

    Args:
        source: where worker processes find `drive`.
        cache: folder that keeps detections; what is there is not detected again.
        advance: called with the number of frames that are done.

    Raises:
        InputError: the drive has neither images nor detected poles, or one cannot be read.
    """
    if not drive.has_frames:
        if not drive.scans:
            raise InputError(f"drive {drive.name}: it has neither images nor {drive.names.poles}")
        advance(len(drive.scans))
        return tracked(drive, drive.scans, settings.polemap)
    with scratch_folder() as fallback:
        known = drive_fingerprint(drive)
        jobs = detection_jobs(source, drive, known, settings, cache or fallback)
        drop_damaged(jobs, is_readable)
        run_missing(jobs, detect_frames, workers, advance)
        raw, spent_s = read_kept_scans([job.target for job in jobs])
        return tracked(drive, raw, settings.polemap, spent_s)


def tracked(
    drive: Drive,
    raw: Sequence[Detections],
    polemap: PolemapConfig,
    spent_s: Mapping[str, Mapping[float, float]] | None = None,
    every: int = 1,
) -> DriveDetections:
    """Every n-th raw scan, tracked as a drive of that frame rate would be."""
    moments = [perf_counter()]
    thinned = replace(drive, images=None, scans=tuple(raw[::every]))
    seen_here = drive.has_frames
    scans = scan_drive(
        thinned, polemap, lambda _: moments.append(perf_counter()), raw_stereo=seen_here
    )
    tracking = dict(zip((s.stamp_s for s in scans), np.diff(moments).tolist(), strict=True))
    return DriveDetections(tuple(scans), {**(spent_s or {}), "tracking": tracking})


def detection_jobs(
    source: Source, drive: Drive, known: str, settings: Settings, folder: Path
) -> list[DetectionJob]:
    """The jobs that find the poles of all frames of a drive, and keep them in `folder`.

    Args:
        known: fingerprint of the drive.
    """
    seen = detection_settings(settings)
    key = fingerprint(known, seen, __version__)
    text = settings.model_dump_json(include={"stereo", "polemap"})
    frames = len(drive.frame_stamps_s)
    jobs = []
    for first in range(0, frames, FRAMES_A_TASK):
        last = min(first + FRAMES_A_TASK, frames)
        target = str(folder / f"scans-{key}-{first:06d}.npz")
        jobs.append(DetectionJob(source, text, (first, last), target))
    return jobs


def detect_frames(job: DetectionJob) -> None:
    """Detect poles in the frames of a job and keep them."""
    settings = Settings.model_validate_json(job.settings)
    raw = raw_scans(_open(job.source), settings.polemap, settings.stereo, range(*job.rows))
    write_scans(Path(job.target), raw)


def read_kept_scans(
    files: Sequence[str],
) -> tuple[list[Detections], dict[str, dict[float, float]]]:
    """What the jobs kept: raw scans, and seconds by stage and stamp.

    Raises:
        InputError: a file is damaged.
    """
    scans: list[Detections] = []
    spent: dict[str, dict[float, float]] = {name: {} for name in STAGES}
    for file in files:
        part = read_scans(Path(file))
        if part is None:
            raise InputError(f"{file}: this kept part of a drive is damaged; delete it and rerun")
        scans += part.scans
        for scan, row in zip(part.scans, part.spent_s.tolist(), strict=True):
            for name, seconds in zip(STAGES, row, strict=True):
                spent[name][scan.stamp_s] = seconds
    return scans, spent


def is_readable(job: DetectionJob) -> bool:
    """Whether what a job kept can be read."""
    return read_scans(Path(job.target)) is not None


def drop_damaged(jobs: Sequence[_Job], is_whole: Callable[[_Job], bool]) -> None:
    """Delete the files of jobs that are there but damaged, so that these jobs are done again."""
    for job in jobs:
        path = Path(job.target)
        if path.is_file() and not is_whole(job):
            warnings.warn(f"{path}: damaged, and made again", stacklevel=2)
            path.unlink(missing_ok=True)


def detection_settings(settings: Settings) -> dict[str, Any]:
    """The settings that a detection depends on, and the content of a classifier of the user's."""
    tree = settings.model_dump(mode="json")
    found: dict[str, Any] = {}
    for name in _DETECTION_SETTINGS:
        part = tree
        for key in name.split("."):
            part = part[key]
        found[name] = part
    for key in ("model", "corner_model"):
        model = Path(getattr(settings.polemap.detection, key))
        if model.is_file():
            found[key] = hashlib.sha256(model.read_bytes()).hexdigest()
    return found


def run_missing(
    jobs: Sequence[_Job], do: Callable[[_Job], None], workers: int, advance: Advance
) -> None:
    """Do every job whose file is not there yet."""
    run_jobs(
        jobs,
        do,
        LocalWorkers(workers),
        done=lambda job: Path(job.target).is_file(),
        steps=lambda job: job.steps,
        advance=advance,
    )


@lru_cache(maxsize=2)
def _open(source: Source) -> Drive:
    return source.recorded()  # detecting needs no motion
