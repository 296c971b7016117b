"""Worker processes that end when their parent does, and leave interrupts to it."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from contextlib import contextmanager, suppress
from multiprocessing import resource_tracker
from typing import Any


def follow_parent() -> None:
    """In a worker: end at once when the parent is gone, however it went.

    A worker that waits for work would wait forever: the other workers hold the pipe open.
    """
    parent = multiprocessing.parent_process()
    if parent is None:
        return

    def wait() -> None:
        parent.join()
        os._exit(1)

    threading.Thread(target=wait, name="follow-parent", daemon=True).start()


@contextmanager
def quiet_children() -> Iterator[None]:
    """While worker processes are started: Ctrl-C will be the parent's to act on, not theirs.

    A terminal sends it to all processes at once, and each worker would print a traceback.
    """
    block = {signal.SIGINT, *([signal.SIGHUP] if hasattr(signal, "SIGHUP") else [])}
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, block)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


class WorkerPool(ProcessPoolExecutor):
    """Fresh worker processes that end with their parent and leave Ctrl-C to it.

    Args:
        workers: their number.
        initializer: is called in each worker, with `initargs`, before it works.
    """

    def __init__(
        self,
        workers: int,
        initializer: Callable[..., object] | None = None,
        initargs: tuple[Any, ...] = (),
    ) -> None:
        with quiet_children():
            # it serves all workers, and must outlive a hang-up as well
            resource_tracker.ensure_running()
            super().__init__(
                workers,
                mp_context=multiprocessing.get_context("spawn"),
                initializer=_begin,
                initargs=(initializer, initargs),
            )

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Call `fn` in a worker process."""
        # a worker may be started for what is submitted
        with quiet_children():
            return super().submit(fn, *args, **kwargs)


def _begin(initializer: Callable[..., object] | None, initargs: tuple[Any, ...]) -> None:
    follow_parent()
    if initializer is not None:
        initializer(*initargs)


def end_children() -> None:
    """Terminate all worker processes of this one; what they had not finished is swept later."""
    for child in multiprocessing.active_children():
        with suppress(OSError, ValueError):
            child.terminate()
