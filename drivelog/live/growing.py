"""Bytes of a file that another program is still writing, or of a pipe."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from threading import Event
from typing import BinaryIO

from polemap.drivelog.errors import InputError

# how often a file that has ended is looked at again; a recorder's chunk is far longer
_LOOK_S = 0.02
_BLOCK = 1 << 18


class GrowingBytes:
    """Reads exactly as many bytes as are asked for, and waits for those that are not there yet.

    Attributes:
        cut: whether the stream ended inside a piece that was asked for.

    Raises:
        InputError: the file is missing, becomes shorter than what was read of it, or another takes
            its place.
    """

    def __init__(self, source: str, stop: Event, idle_s: float | None = None) -> None:
        """`source` is a file or - for standard input; `stop` ends the waiting, as `idle_s` does."""
        self._name = "standard input" if source == "-" else source
        self._stop, self._idle_s = stop, idle_s
        self._path = None if source == "-" else Path(source)
        self._buffer = bytearray()
        self._read_bytes = 0
        self.cut = False
        try:
            self._file: BinaryIO = (
                sys.stdin.buffer if self._path is None else self._path.open("rb", buffering=0)
            )
        except OSError as error:
            raise InputError(f"{source}: cannot be followed ({error.strerror})") from error

    @property
    def name(self) -> str:
        """The file, or what the pipe is called."""
        return self._name

    def peek(self, count: int) -> bytes:
        """The next bytes without taking them; fewer at the end of the stream."""
        while len(self._buffer) < count and self._fill():
            pass
        return bytes(self._buffer[:count])

    def read(self, count: int) -> bytes:
        """The next `count` bytes; at the end of the stream what is left of them."""
        data = self.peek(count)
        del self._buffer[: len(data)]
        self.cut = self.cut or 0 < len(data) < count
        return data

    def readline(self, limit: int) -> bytes:
        """The next line, its end included; more than `limit` bytes come in pieces."""
        start = 0
        while True:
            end = self._buffer.find(b"\n", start)
            if end >= 0 or len(self._buffer) >= limit:
                break
            start = len(self._buffer)
            if not self._fill():
                break
        length = min(end + 1 if end >= 0 else len(self._buffer), limit)
        line = bytes(self._buffer[:length])
        del self._buffer[:length]
        return line

    def close(self) -> None:
        """Let the file go."""
        if self._path is not None:
            self._file.close()

    def _fill(self) -> bool:
        """Wait for more bytes; False at the end of the stream."""
        waited_s = 0.0
        while not self._stop.is_set():
            try:
                data = self._some()
            except OSError as error:
                raise InputError(f"{self._name}: cannot be read ({error.strerror})") from error
            if data:
                self._buffer += data
                self._read_bytes += len(data)
                return True
            if self._path is None:
                return False  # the other end of the pipe is closed
            self._check_same(self._path)
            if self._idle_s is not None and waited_s >= self._idle_s:
                return False
            self._stop.wait(_LOOK_S)
            waited_s += _LOOK_S
        return False

    def _some(self) -> bytes:
        if self._path is None:
            return os.read(self._file.fileno(), _BLOCK)
        return self._file.read(_BLOCK) or b""

    def _check_same(self, path: Path) -> None:
        """What was opened will grow no more where another recording is written instead."""
        opened = os.fstat(self._file.fileno())
        if opened.st_size < self._read_bytes:
            raise InputError(
                f"{self._name}: has become shorter ({opened.st_size} bytes, {self._read_bytes} "
                "were read); another recording is written over it: start again"
            )
        try:
            named = path.stat()
        except OSError:
            return  # moved or deleted: its writer may still go on
        if not os.path.samestat(named, opened):
            raise InputError(
                f"{self._name}: another file has taken its place after {self._read_bytes} bytes: "
                "start again"
            )
