"""Signals that end a command: one line, all tidied up, and the exit code that shells expect."""

from __future__ import annotations

import os
import signal
import sys
import threading
import weakref
from collections.abc import Iterator
from contextlib import contextmanager
from threading import Event
from types import FrameType

from polemap.drivelog.processes import end_children

_NAMES = ("SIGINT", "SIGTERM", "SIGHUP")
_SIGNALS = tuple(getattr(signal, name) for name in _NAMES if hasattr(signal, name))
_received: list[int] = []
_LOOK_AGAIN_S = 0.2


class Stopped(BaseException):
    """A signal asked the command to end; passes through `except Exception`."""


_raised: list[weakref.ref[Stopped]] = []


# Python's tracker of shared resources reports what an interrupted pool had not yet released, on the
# command's stderr and after its one line; it is a process of its own that reads this variable
_QUIET_TRACKER = "ignore:resource_tracker"


def install() -> None:
    """Turn the signals that ask for an end into `Stopped`; a second one ends at once."""
    given = os.environ.get("PYTHONWARNINGS")
    if _QUIET_TRACKER not in (given or ""):
        os.environ["PYTHONWARNINGS"] = f"{given},{_QUIET_TRACKER}" if given else _QUIET_TRACKER
    for number in _SIGNALS:
        # what the caller ignores (nohup) stays ignored
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, _stop)
    sys.unraisablehook = _unraisable


def _unraisable(what: sys.UnraisableHookArgs) -> None:
    """A signal that came in a finaliser is raised anew (`_look_again`); it needs no traceback."""
    if not isinstance(what.exc_value, Stopped):
        sys.__unraisablehook__(what)


def _stop(number: int, _frame: FrameType | None) -> None:
    if _received:
        # results are whole whenever the process ends, and the next run tidies up
        os._exit(128 + number)
    _received.append(number)
    end_children()
    _raise(number)


def _raise(number: int) -> None:
    """Raise `Stopped`, and look from time to time whether it is on its way.

    Some libraries swallow whatever is raised while they are imported. As long as the exception
    unwinds the stack, what is tidied up on the way included, it is alive; once it is gone without
    an end of the command, it is raised anew.

    Raises:
        Stopped: always.
    """
    stopped = Stopped(signal.Signals(number).name)
    _raised[:] = [weakref.ref(stopped)]
    if hasattr(signal, "setitimer"):
        signal.signal(signal.SIGALRM, _look_again)
        signal.setitimer(signal.ITIMER_REAL, _LOOK_AGAIN_S, _LOOK_AGAIN_S)
    try:
        raise stopped
    finally:
        del stopped  # the frame in its own traceback would keep it alive


def _look_again(_number: int, _frame: FrameType | None) -> None:
    if _raised and _raised[0]() is None:
        _raise(_received[0])


def finished() -> None:
    """The command has ended: nothing is raised any more."""
    if _raised and hasattr(signal, "setitimer"):
        signal.setitimer(signal.ITIMER_REAL, 0.0)
    _raised.clear()


@contextmanager
def asked_to_end(event: Event) -> Iterator[None]:
    """Inside the block a first signal sets `event`, so that work ends at a place of its choice.

    A second one ends the process at once. Does nothing where a thread calls it.
    """

    def ask(number: int, _frame: FrameType | None) -> None:
        if event.is_set() and _received:
            os._exit(128 + number)
        _received.append(number)
        event.set()

    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {number: signal.getsignal(number) for number in _SIGNALS}
    try:
        for number, handler in before.items():
            if handler is not signal.SIG_IGN:
                signal.signal(number, ask)
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def forget() -> None:
    """The signal that came was an ordinary end."""
    _received.clear()


def exit_code() -> int | None:
    """128 + the signal that came, 130 for Ctrl-C; None if none did."""
    return 128 + _received[0] if _received else None
