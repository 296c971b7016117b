"""Many jobs on many workers: what is done is kept and not done again, whoever is interrupted.

Detection, Monte Carlo runs, sweeps and the drives of a city all go through `run_jobs`. A job leaves
its result on the disk, whole or not at all, by itself or through `keep`; a run that was killed goes
on from there. Where the work is done is up to the workers: this machine's processes, or whatever
offers `finished` (a Dask cluster, see `polemap.build.city.cluster`).
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import as_completed
from concurrent.futures.process import BrokenProcessPool
from typing import Any, Protocol, TypeVar

from polemap.drivelog.errors import WorkerError
from polemap.drivelog.processes import WorkerPool

Advance = Callable[[int], None]
Initializer = Callable[..., object]
J = TypeVar("J")

_LOST_AT_MOST = 2


class Workers(Protocol):
    """Who does jobs."""

    def finished(self, do: Callable[[J], Any], jobs: Sequence[J]) -> Iterator[tuple[int, Any]]:
        """The number of every job and what `do` gave for it, as they end.

        Raises:
            Exception: what a job raised; jobs that were not begun are dropped.
        """
        ...


class LocalWorkers:
    """Processes of this machine, one thread each; for one worker or one job, this process itself.

    They end with their parent, leave Ctrl-C to it, and a lost one (killed for its memory, say) is
    replaced: what it worked on is done again.

    Args:
        count: of processes.
        initializer: is called in each, with `initargs`, before it works; for what all jobs share.
    """

    def __init__(
        self,
        count: int,
        initializer: Initializer | None = None,
        initargs: tuple[Any, ...] = (),
    ) -> None:
        self._count, self._initializer, self._initargs = count, initializer, initargs

    def finished(self, do: Callable[[J], Any], jobs: Sequence[J]) -> Iterator[tuple[int, Any]]:
        """See `Workers`.

        Raises:
            WorkerError: worker processes were lost again and again.
        """
        if self._count == 1 or len(jobs) < 2:
            if self._initializer is not None:
                self._initializer(*self._initargs)
            for number, job in enumerate(jobs):
                yield number, do(job)
            return
        # one thread a process: the processes share the cores among themselves
        for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
            os.environ.setdefault(name, "1")
        left = dict(enumerate(jobs))
        for lost in range(_LOST_AT_MOST + 1):
            try:
                for number, result in self._round(do, left.copy()):
                    del left[number]
                    yield number, result
                return
            except BrokenProcessPool as error:
                if lost == _LOST_AT_MOST:
                    raise WorkerError(
                        f"worker processes were killed {lost + 1} times with {len(left)} jobs "
                        "left; is the memory short? Try fewer --workers"
                    ) from error

    def _round(self, do: Callable[[J], Any], jobs: dict[int, J]) -> Iterator[tuple[int, Any]]:
        count = min(self._count, len(jobs))
        with WorkerPool(count, self._initializer, self._initargs) as pool:
            futures = {pool.submit(do, job): number for number, job in jobs.items()}
            try:
                for future in as_completed(futures):
                    yield futures[future], future.result()
            except BaseException:
                pool.shutdown(wait=True, cancel_futures=True)
                raise


def in_order(do: Callable[[J], Any], jobs: Sequence[J], workers: Workers) -> Iterator[Any]:
    """What `do` gives for every job, in the order of the jobs; see `run_jobs` for both."""
    early: dict[int, Any] = {}
    due = 0
    for number, result in workers.finished(do, jobs):
        early[number] = result
        while due in early:
            yield early.pop(due)
            due += 1


def run_jobs(
    jobs: Sequence[J],
    do: Callable[[J], Any],
    workers: Workers,
    *,
    done: Callable[[J], bool],
    keep: Callable[[J, Any], None] | None = None,
    steps: Callable[[J], int] = lambda _job: 1,
    advance: Advance = lambda _steps: None,
) -> None:
    """Do every job that is not done yet.

    Args:
        jobs: in the order in which they are to be begun.
        do: does one; a plain function of a module, so that workers can import it.
        workers: who does them.
        done: whether the result of a job is there from a run before.
        keep: keeps in this process what `do` gave; without it `do` keeps its result by itself.
        steps: how much of the progress a job is.
        advance: called with the steps that are done.
    """
    todo = [job for job in jobs if not done(job)]
    advance(sum(map(steps, jobs)) - sum(map(steps, todo)))
    for number, result in workers.finished(do, todo):
        if keep is not None:
            keep(todo[number], result)
        advance(steps(todo[number]))
