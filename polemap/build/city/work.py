"""A job a drive; what is done is on the disk, so that a killed run resumes.

The detection in the images takes nearly all of the time and needs nothing but its own drive; then
the merging is spread over the same workers, a job a tile (`tiles`). Since merging orders drives by
their time, breaks ties by place and never cuts what belongs together, the map is the same, row for
row, as that of a single process.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, TypeVar

from polemap import __version__
from polemap.build.city.io import read_checkpoint, write_checkpoint
from polemap.build.city.tiles import Run
from polemap.build.drive_observations import DriveObservations
from polemap.drivelog.frames import EarthFrame
from polemap.drivelog.jobs import Advance, Workers, in_order, run_jobs


@dataclass(frozen=True, slots=True)
class DriveTask:
    """One drive to detect poles in; small, so that it travels to a worker.

    Attributes:
        path: of the drive, as the worker sees it.
        name: of the drive in the map.
        lap: row of laps.csv, or None.
        settings: everything that the result depends on, as JSON.
        topics: mapping of the topics of a log.
        odometry: where the motion comes from.
    """

    path: str
    name: str
    lap: str | None
    seed: int
    frame: EarthFrame
    settings: str
    topics: str | None = None
    odometry: str = "auto"

    def key(self) -> str:
        """Names the computation: another drive, setting or version gives another key."""
        parts = [__version__, self.path, self.name, self.lap, self.seed, str(self.frame)]
        more = [self.topics, self.odometry] if self.topics or self.odometry != "auto" else []
        text = json.dumps([*parts, self.settings, *more])
        return hashlib.sha256(text.encode()).hexdigest()[:32]


class Keyed(Protocol):
    """A job whose `key` names the computation."""

    def key(self) -> str:
        """Another drive, setting or version gives another."""
        ...


J = TypeVar("J", bound=Keyed)
T = TypeVar("T")


def observe_all(
    tasks: Sequence[J],
    observe: Callable[[J], DriveObservations],
    checkpoints: Path,
    workers: Workers,
    advance: Advance = lambda _steps: None,
) -> list[DriveObservations]:
    """What every drive contributes, computed in parallel, taken from checkpoints where it can be.

    Args:
        tasks: one a drive.
        observe: computes one; a plain function of a module, so that workers can import it.
        checkpoints: folder for the checkpoints.
        workers: who computes.
        advance: is called with 1 after every drive.

    Raises:
        PolemapError: what `observe` raised; drives that were done stay done.
    """
    return compute_all(
        tasks, observe, checkpoints, workers, read_checkpoint, write_checkpoint, advance
    )


def compute_all(
    tasks: Sequence[J],
    compute: Callable[[J], T],
    checkpoints: Path,
    workers: Workers,
    read: Callable[[Path, str], T | None],
    write: Callable[[T, str, Path], None],
    advance: Advance = lambda _steps: None,
) -> list[T]:
    """What `compute` gives for every drive, as `observe_all`.

    Args:
        tasks, checkpoints, workers, advance: as in `observe_all`.
        compute: a plain function of a module, so that workers can import it.
        read: the checkpoint at a path if it is of a key.
        write: a result with its key to a path.

    Raises:
        PolemapError: what `compute` raised; drives that were done stay done.
    """
    results: dict[str, T] = {}

    def place(task: J) -> Path:
        return checkpoints / f"{task.key()}.npz"

    def done(task: J) -> bool:
        part = read(place(task), task.key())
        if part is not None:
            results[task.key()] = part
        return part is not None

    def keep(task: J, part: T) -> None:
        write(part, task.key(), place(task))
        results[task.key()] = part

    run_jobs(tasks, compute, workers, done=done, keep=keep, advance=advance)
    return [results[task.key()] for task in tasks]


def on_workers(workers: Workers, advance: Advance = lambda _steps: None) -> Run:
    """Runs the tasks of tiles on workers.

    Args:
        workers: who is to do it.
        advance: is called with 1 after every task.
    """

    def run(function: Callable[[Any], Any], tasks: Sequence[Any]) -> list[Any]:
        results = []
        for result in in_order(function, tasks, workers):
            results.append(result)
            advance(1)
        return results

    return run
