"""Signals that end a command: one line, all tidied up, and the exit code that shells expect."""

from __future__ import annotations

import os
import signal
from types import FrameType

from polemap.drivelog.processes import end_children

_NAMES = ("SIGINT", "SIGTERM", "SIGHUP")
_SIGNALS = tuple(getattr(signal, name) for name in _NAMES if hasattr(signal, name))
_received: list[int] = []


class Stopped(BaseException):
    """A signal asked the command to end; passes through `except Exception`."""


def install() -> None:
    """Turn the signals that ask for an end into `Stopped`; a second one ends at once."""
    for number in _SIGNALS:
        # what the caller ignores (nohup) stays ignored
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, _stop)


def _stop(number: int, _frame: FrameType | None) -> None:
    if _received:
        # results are whole whenever the process ends, and the next run tidies up
        os._exit(128 + number)
    _received.append(number)
    end_children()
    raise Stopped(signal.Signals(number).name)


def exit_code() -> int | None:
    """128 + the signal that came, 130 for Ctrl-C; None if none did."""
    return 128 + _received[0] if _received else None
