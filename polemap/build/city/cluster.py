"""The workers of a Dask cluster."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, TypeVar

from polemap.drivelog.errors import ConfigError, PolemapError
from polemap.extras import need

J = TypeVar("J")

_RETRIES = 2


class DaskWorkers:
    """The workers of a Dask client; the jobs of one that is lost go to others."""

    def __init__(self, client: Any) -> None:
        self._client = client

    def finished(self, do: Callable[[J], Any], jobs: Sequence[J]) -> Iterator[tuple[int, Any]]:
        """See `polemap.drivelog.jobs.Workers`.

        Raises:
            PolemapError: what a job raised.
            RuntimeError: any other error of a job.
        """
        with warnings.catch_warnings():
            # a tile's landmarks and scans are what the job is about, however large
            warnings.filterwarnings("ignore", message="Sending large graph")
            # `retries` is for what failed by itself
            futures = {
                self._client.submit(do, job, pure=False, retries=_RETRIES): number
                for number, job in enumerate(jobs)
            }
        for future in _distributed().as_completed(list(futures)):
            if future.status == "error":
                error = future.exception()
                if isinstance(error, PolemapError):
                    raise error
                raise RuntimeError(f"a job of the cluster failed: {error!r}") from error
            yield futures[future], future.result()
            future.release()


@contextmanager
def open_cluster(scheduler: str) -> Iterator[DaskWorkers]:
    """The workers of a scheduler, by its address such as tcp://host:8786.

    Raises:
        ConfigError: it cannot be reached.
    """
    try:
        client = _distributed().Client(scheduler, timeout="10s")
    except (OSError, ValueError) as error:
        raise ConfigError(f"--scheduler {scheduler}: cannot be reached ({error})") from error
    with client:
        yield DaskWorkers(client)


def _distributed() -> Any:
    """Dask takes a second to import, which other runs need not wait for."""
    return need("dask.distributed")
