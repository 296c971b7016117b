"""Jobs: what is done is not done again, lost workers are replaced, errors come through."""

from __future__ import annotations

import os
import signal
from dataclasses import dataclass
from pathlib import Path

import pytest

from polemap.drivelog.errors import InputError, WorkerError
from polemap.drivelog.jobs import LocalWorkers, in_order, run_jobs

_given: list[int] = []


@dataclass(frozen=True)
class Square:
    folder: Path
    number: int

    @property
    def target(self) -> Path:
        return self.folder / f"{self.number}.txt"


def jobs(folder: Path, count: int = 4) -> list[Square]:
    return [Square(folder, number) for number in range(count)]


def is_done(job: Square) -> bool:
    return job.target.is_file()


def do(job: Square) -> int:
    with (job.folder / f"calls-{job.number}").open("a") as stream:
        stream.write(".")
    job.target.write_text(str(job.number**2))
    return job.number**2


def do_or_die_once(job: Square) -> int:
    mark = job.folder / "died"
    if job.number == 1 and not mark.exists():
        mark.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return do(job)


def do_or_die(job: Square) -> int:
    if job.number == 1:
        os.kill(os.getpid(), signal.SIGKILL)
    return do(job)


def do_badly(job: Square) -> int:
    if job.number == 1:
        raise InputError("job 1 is upside down")
    return do(job)


def take(*values: int) -> None:
    _given[:] = values


def add_given(job: Square) -> int:
    return job.number + sum(_given)


def calls(folder: Path) -> list[int]:
    return [len((folder / f"calls-{n}").read_text()) for n in range(4)]


@pytest.mark.parametrize("count", [1, 2])
def test_what_is_done_is_not_done_again(tmp_path: Path, count: int) -> None:
    steps: list[int] = []
    run_jobs(jobs(tmp_path)[:2], do, LocalWorkers(count), done=is_done)
    run_jobs(jobs(tmp_path), do, LocalWorkers(count), done=is_done, advance=steps.append)
    assert calls(tmp_path) == [1, 1, 1, 1]
    assert [job.target.read_text() for job in jobs(tmp_path)] == ["0", "1", "4", "9"]
    assert steps == [2, 1, 1]


@pytest.mark.parametrize("count", [1, 2])
def test_results_are_kept_here_where_asked_for(tmp_path: Path, count: int) -> None:
    kept: dict[int, int] = {}
    run_jobs(
        jobs(tmp_path),
        add_given,
        LocalWorkers(count, take, (10, 20)),
        done=is_done,
        keep=lambda job, result: kept.update({job.number: result}),
        steps=lambda job: job.number,
    )
    assert kept == {0: 30, 1: 31, 2: 32, 3: 33}


class Backwards:
    """Workers whose last job ends first."""

    def finished(self, do, jobs):
        for number in reversed(range(len(jobs))):
            yield number, do(jobs[number])


@pytest.mark.parametrize("workers", [Backwards(), LocalWorkers(1), LocalWorkers(2)])
def test_results_come_in_the_order_of_the_jobs(tmp_path: Path, workers) -> None:
    assert list(in_order(do, jobs(tmp_path), workers)) == [0, 1, 4, 9]


def test_a_lost_worker_is_replaced(tmp_path: Path) -> None:
    run_jobs(jobs(tmp_path), do_or_die_once, LocalWorkers(2), done=is_done)
    assert all(is_done(job) for job in jobs(tmp_path))


def test_workers_that_are_lost_again_and_again_are_named(tmp_path: Path) -> None:
    with pytest.raises(WorkerError, match=r"killed 3 times with \d jobs left.*fewer --workers"):
        run_jobs(jobs(tmp_path), do_or_die, LocalWorkers(2), done=is_done)


@pytest.mark.parametrize("count", [1, 2])
def test_the_error_of_a_job_comes_through_and_the_others_stay_done(
    tmp_path: Path, count: int
) -> None:
    with pytest.raises(InputError, match="job 1 is upside down"):
        run_jobs(jobs(tmp_path), do_badly, LocalWorkers(count), done=is_done)
    assert is_done(jobs(tmp_path)[0])
    run_jobs(jobs(tmp_path), do, LocalWorkers(count), done=is_done)
    assert all(is_done(job) for job in jobs(tmp_path))
