"""What the three containers (rosbag1, MCAP, SQLite of rosbag2) have in common.

A container is walked once from front to back, without its index, so that one whose recording was
cut off is read as far as it goes. Of a picture only the first bytes are read then; its place is
kept and it is read again when it is needed.
"""

from __future__ import annotations

import bz2
import io
import lzma
import os
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple, Protocol

from polemap.drivelog.errors import InputError
from polemap.extras import need
from polemap.parsing.errors import short

# of a picture's message, enough for its stamp and the name of its frame
HEAD_BYTES = 512
WHOLE, NOTHING = -1, 0
# a chunk is held in memory as a whole; recorders write 0.8 to 4 MB
LARGEST_CHUNK = 1 << 30
_RAISED = (
    EOFError, LookupError, OSError, RuntimeError, ValueError, lzma.LZMAError, zlib.error,
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class Channel:
    """What is known of a stream of messages before the first one.

    Attributes:
        type_name: as `pkg/msg/Type` for ROS, else as the schema names it.
        encoding: `cdr`, `ros1`, `protobuf`, `json` or what else the container says.
        schema_encoding: `ros2msg`, `ros2idl`, `ros1msg`, `protobuf`, `jsonschema` or empty.
        schema: definition of the message, empty where the container has none.
        zstd: whether each message is compressed by itself.
    """

    topic: str
    type_name: str
    encoding: str
    schema_encoding: str = ""
    schema: bytes = b""
    zstd: bool = False


class Message(NamedTuple):
    """One message of a walk.

    Attributes:
        channel: index into `Walk.channels`.
        log_ns: when it was recorded.
        data: as much of it as was asked for.
        block: where its compressed chunk begins in the file, -1 for none.
        offset: of the message in the chunk, or in the file (SQLite: its row).
        size: bytes of it.
    """

    channel: int
    log_ns: int
    data: bytes
    block: int
    offset: int
    size: int


@dataclass(slots=True)
class Walk:
    """What a walk has met so far.

    Attributes:
        channels: grow as they are met.
        wanted: how many bytes of the messages of a channel are asked for.
        damage: why the walk ended before the file did, or which parts it passed over.
        compression: names of the compressions met.
    """

    wanted: Callable[[Channel], int]
    channels: list[Channel] = field(default_factory=list)
    bytes_wanted: list[int] = field(default_factory=list)
    damage: list[str] = field(default_factory=list)
    compression: set[str] = field(default_factory=set)

    def add(self, channel: Channel) -> int:
        """Take up a channel; its index."""
        self.channels.append(channel)
        self.bytes_wanted.append(self.wanted(channel))
        return len(self.channels) - 1


class Container(Protocol):
    """One file of a recording."""

    @property
    def path(self) -> Path:
        """The file."""

    @property
    def kind(self) -> str:
        """What it is called."""

    def walk(self, walk: Walk) -> Iterator[Message]:
        """Every message from front to back.

        Raises:
            InputError: it is no such file, is encrypted or damaged beyond its first part.
        """
        ...

    def read(self, block: int, offset: int, size: int) -> bytes:
        """A message whose place is known from a walk.

        Raises:
            InputError: the file has changed since.
        """
        ...


class SizedFile(io.BufferedReader):
    """A file that never makes room for more than it still holds, whatever length is asked for.

    Libraries ask for as many bytes as a record says; a damaged one says any number.
    """

    def __init__(self, path: Path) -> None:
        super().__init__(io.FileIO(path))
        self._size = os.fstat(self.fileno()).st_size

    def read(self, size: int | None = -1, /) -> bytes:
        left = max(self._size - self.tell(), 0)
        return super().read(left if size is None or size < 0 else min(size, left))


def read_at(path: Path, offset: int, size: int) -> bytes:
    """Bytes of a file; it is opened anew, so that processes share no position in it.

    Raises:
        InputError: it has become shorter, or is gone.
    """
    try:
        with path.open("rb", buffering=0) as file:
            data = os.pread(file.fileno(), size, offset)
            while 0 < len(data) < size:  # the kernel gives at most 2 GB at once
                more = os.pread(file.fileno(), size - len(data), offset + len(data))
                if not more:
                    break
                data += more
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from error
    if len(data) != size:
        raise InputError(f"{path}: ends before byte {offset + size}; it changed while it was read")
    return data


def decompress(data: bytes, compression: str, size: int, place: str) -> bytes:
    """A chunk of `size` bytes.

    Raises:
        InputError: it says it is larger than can be held, is of an unknown compression, or damaged.
    """
    if size > LARGEST_CHUNK:
        raise InputError(
            f"{place}: a chunk of {size / 1e6:.0f} MB is more than can be held; record with "
            "smaller chunks"
        )
    try:
        if compression in ("", "none"):
            raw = data
        elif compression == "lz4":
            decoder: Any = need("lz4.frame").LZ4FrameDecompressor()
            raw = decoder.decompress(data, size + 1)
        elif compression == "zstd":
            zstandard = need("zstandard")
            with zstandard.ZstdDecompressor().stream_reader(data) as stream:
                raw = stream.read(size + 1)
        elif compression == "bz2":
            raw = bz2.BZ2Decompressor().decompress(data, size + 1)
        else:
            raise InputError(
                f"{place}: compression '{compression[:20]}' is unknown; known are lz4, zstd, bz2"
            )
    except _RAISED as error:
        raise InputError(f"{place}: damaged {compression} chunk ({short(error)})") from error
    except Exception as error:  # zstandard's own error derives from nothing narrower
        if type(error).__module__.split(".")[0] not in ("zstd", "zstandard", "lz4"):
            raise
        raise InputError(f"{place}: damaged {compression} chunk ({short(error)})") from error
    if len(raw) != size:
        raise InputError(f"{place}: damaged {compression or 'plain'} chunk ({len(raw)} bytes)")
    return raw


@lru_cache(maxsize=2)
def cached_chunk(load: Callable[[Path, int], bytes], path: Path, block: int, _change: int) -> bytes:
    """The chunk at `block`; the pictures of a pair mostly lie in one or in two neighbours."""
    return load(path, block)


def changed_ns(path: Path) -> int:
    """When a file was last written; part of the key of what is kept of it."""
    try:
        return path.stat().st_mtime_ns
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from error
