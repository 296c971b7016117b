"""What workers run in the tests of parallel building: importable by their name."""

from __future__ import annotations

import os
import signal
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from polemap.build.city.work import DriveTask, observe_all
from polemap.build.config import MappingConfig
from polemap.build.drive_observations import DriveObservations, observe_drive
from polemap.drivelog.errors import InputError
from polemap.drivelog.jobs import LocalWorkers
from tests.polemap.town import FRAME, drive_through, make_town, route


def observe(task: DriveTask) -> DriveObservations:
    """A short drive through a small town; `task.path` is a folder in which each call is noted."""
    (Path(task.path) / f"{task.name}.{time.time_ns()}").touch()
    town = make_town(np.random.default_rng(1), 1)
    rng = np.random.default_rng(task.seed)
    drive = drive_through(town, rng, start_s=1000.0 * task.seed, poses=route(1)[:300], vans=0)
    return observe_drive(task.name, FRAME, drive.scans, drive.reference, MappingConfig(), FRAME)


def calls(folder: Path, name: str) -> int:
    return len(list(folder.glob(f"{name}.*")))


def observe_but_die_once(task: DriveTask) -> DriveObservations:
    """The first worker that gets the second drive is killed while it works on it."""
    if task.seed == 2 and calls(Path(task.path), task.name) == 0:
        observe(task)
        os.kill(os.getpid(), signal.SIGKILL)
    return observe(task)


def die_once(function: Callable[[Any], Any], folder: Path, task: Any) -> Any:
    """The first worker that begins a task of this function is killed."""
    mark = folder / f"{function.__name__}.begun"
    if not mark.exists():
        mark.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return function(task)


def observe_but_hang(task: DriveTask) -> DriveObservations:
    """The second drive takes for ever, so that its coordinator can be killed."""
    if task.seed == 2:
        time.sleep(600.0)
    return observe(task)


def observe_badly(task: DriveTask) -> DriveObservations:
    raise InputError(f"drive {task.name}: it is upside down")


def tasks(folder: Path) -> list[DriveTask]:
    return [DriveTask(str(folder), f"day {i}", None, i, FRAME, "{}") for i in (1, 2)]


if __name__ == "__main__":
    where = Path(sys.argv[1])
    observe_all(tasks(where), observe_but_hang, where / "checkpoints", LocalWorkers(2))
