"""A task a drive on a Dask cluster; what is done is on the disk, so that a killed run resumes.

The detection in the images takes nearly all of the time and needs nothing but its own drive; then
the merging is spread over the same workers, a task a tile (`tiles`). Since merging orders drives by
their time, breaks ties by place and never cuts what belongs together, the map is the same, row for
row, as that of a single process.
"""

from __future__ import annotations

import hashlib
import json
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from polemap import __version__
from polemap.build.city.io import read_checkpoint, write_checkpoint
from polemap.build.city.tiles import Run
from polemap.build.drive_observations import DriveObservations
from polemap.drivelog.errors import ConfigError, PolemapError
from polemap.drivelog.frames import EarthFrame
from polemap.extras import need

_RETRIES = 2


@dataclass(frozen=True, slots=True)
class DriveTask:
    """One drive to detect poles in; small, so that it travels to a worker.

    Attributes:
        path: of the drive, as the worker sees it.
        name: of the drive in the map.
        lap: row of laps.csv, or None.
        settings: everything that the result depends on, as JSON.
    """

    path: str
    name: str
    lap: str | None
    seed: int
    frame: EarthFrame
    settings: str

    def key(self) -> str:
        """Names the computation: another drive, setting or version gives another key."""
        text = json.dumps(
            [__version__, self.path, self.name, self.lap, self.seed, str(self.frame), self.settings]
        )
        return hashlib.sha256(text.encode()).hexdigest()[:32]


Observe = Callable[[DriveTask], DriveObservations]


def observe_all(
    tasks: Sequence[DriveTask],
    observe: Observe,
    checkpoints: Path,
    *,
    workers: int | None = None,
    scheduler: str | None = None,
    client: Any = None,
    done: Callable[[int], None] | None = None,
) -> list[DriveObservations]:
    """What every drive contributes, computed in parallel, taken from checkpoints where it can be.

    Args:
        tasks: one a drive.
        observe: computes one; a plain function of a module, so that workers can import it.
        checkpoints: folder for the checkpoints.
        workers: local processes, where no scheduler is named.
        scheduler: address of a Dask scheduler, such as tcp://host:8786.
        client: an `open_client` to use instead of one of its own.
        done: is called with 1 after every drive.

    Raises:
        PolemapError: what `observe` raised; drives that were done stay done.
        ConfigError: the scheduler cannot be reached.
    """
    results: dict[str, DriveObservations] = {}
    open_tasks: list[DriveTask] = []
    for task in tasks:
        part = read_checkpoint(checkpoints / f"{task.key()}.npz", task.key())
        if part is None:
            open_tasks.append(task)
            continue
        results[task.key()] = part
        if done is not None:
            done(1)
    if open_tasks:
        count = min(workers or 1, len(open_tasks))
        own = open_client(count, scheduler) if client is None else nullcontext(client)
        with own as opened:
            for key, part in _run(opened, open_tasks, observe):
                write_checkpoint(part, key, checkpoints / f"{key}.npz")
                results[key] = part
                if done is not None:
                    done(1)
    return [results[task.key()] for task in tasks]


def _run(
    client: Any, tasks: Sequence[DriveTask], observe: Observe
) -> Iterator[tuple[str, DriveObservations]]:
    distributed = _distributed()
    # a task whose worker is lost goes to another one; `retries` is for what failed by itself
    futures = {
        client.submit(observe, task, key=f"{task.name}-{task.key()}", retries=_RETRIES): task
        for task in tasks
    }
    for future in distributed.as_completed(list(futures)):
        if future.status == "error":
            error = future.exception()
            if isinstance(error, PolemapError):
                raise error
            raise RuntimeError(f"drive {futures[future].name}: {error!r}") from error
        yield futures[future].key(), future.result()
        future.release()


def _distributed() -> Any:
    """Dask takes a second to import, which single-process runs need not wait for."""
    return need("dask.distributed")


def on_workers(client: Any, done: Callable[[int], None] | None = None) -> Run:
    """Runs the tasks of tiles on the workers of an `open_client`.

    Args:
        client: whose workers are to do it; the tasks of one that is lost go to others.
        done: is called with 1 after every task.
    """

    def run(function: Callable[[Any], Any], tasks: Sequence[Any]) -> list[Any]:
        with warnings.catch_warnings():
            # a tile's landmarks and scans are what the task is about, however large
            warnings.filterwarnings("ignore", message="Sending large graph")
            futures = [client.submit(function, t, pure=False, retries=_RETRIES) for t in tasks]
        for _ in _distributed().as_completed(futures):
            if done is not None:
                done(1)
        return list(client.gather(futures))

    return run


@contextmanager
def open_client(workers: int | None, scheduler: str | None = None) -> Iterator[Any]:
    """A Dask client: of the named scheduler, else of a cluster of local processes.

    Raises:
        ConfigError: the scheduler cannot be reached.
    """
    distributed = _distributed()
    if scheduler is not None:
        try:
            client = distributed.Client(scheduler, timeout="10s")
        except (OSError, ValueError) as error:
            raise ConfigError(f"--scheduler {scheduler}: cannot be reached ({error})") from error
        with client:
            yield client
        return
    with (
        distributed.LocalCluster(
            n_workers=max(1, workers or 1),
            threads_per_worker=1,
            processes=True,
            dashboard_address=None,
            host="127.0.0.1",
            silence_logs=40,
        ) as cluster,
        distributed.Client(cluster) as client,
    ):
        yield client
