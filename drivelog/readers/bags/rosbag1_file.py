"""ROS 1 bags, format 2.0, with and without index.

Source: wiki.ros.org/Bags/Format/2.0. The index at the end is not needed: chunks follow each other
from the front, as `rosbag reindex` reads them.
"""

from __future__ import annotations

import io
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from polemap.drivelog.errors import InputError
from polemap.drivelog.readers.bags.container import (
    NOTHING,
    WHOLE,
    Channel,
    Message,
    Walk,
    cached_chunk,
    changed_ns,
    decompress,
    read_at,
)
from polemap.drivelog.readers.bags.types import ros_type

MAGIC = b"#ROSBAG V"
_VERSION = b"#ROSBAG V2.0\n"
_MESSAGE, _BAG, _CHUNK, _CONNECTION = 2, 3, 5, 7
_U32 = struct.Struct("<I")
_TIME = struct.Struct("<II")
_LARGEST_HEADER = 1 << 20
_LARGEST_DESCRIPTION = 64 << 20


@dataclass(frozen=True, slots=True)
class Rosbag1File:
    """One .bag file."""

    path: Path
    kind: str = "rosbag1"

    def walk(self, walk: Walk) -> Iterator[Message]:
        """Every message from front to back; see `Container`."""
        with self.path.open("rb", buffering=1 << 16) as file:
            version = file.read(len(_VERSION))
            if version != _VERSION:
                raise InputError(
                    f"{self.path}: bag of version {version[9:12].decode('ascii', 'replace')}, only "
                    "2.0 can be read; convert it with `rosbag fix`"
                )
            walker = _Walker(self, walk)
            yield from walker.records(file, len(_VERSION), self.path.stat().st_size, -1)

    def read(self, block: int, offset: int, size: int) -> bytes:
        """A message by its place; see `Container`."""
        if block < 0:
            return read_at(self.path, offset, size)
        chunk = cached_chunk(_load_chunk, self.path, block, changed_ns(self.path))
        return chunk[offset : offset + size]


class _CutError(Exception):
    """The file ends in the middle of a record."""


class _Walker:
    def __init__(self, source: Rosbag1File, walk: Walk) -> None:
        self._source, self._walk = source, walk
        self._channels: dict[int, int] = {}
        self._cut = False

    def records(self, file: BinaryIO, at: int, end: int, block: int) -> Iterator[Message]:
        """Messages between two positions of a file, or of a decompressed chunk."""
        try:
            while at < end:
                start = at
                fields, at = _header(file, at, end)
                (length,) = _U32.unpack(_exactly(file, 4, at, end))
                at += 4
                code = fields.get(b"op", b"\0")[0]
                if code == _CHUNK:
                    stop = min(at + length, end)
                    yield from self._chunk(file, fields, at, stop, start, at + length > end)
                if at + length > end:
                    raise _CutError
                if code == _MESSAGE:
                    message = self._message(file, fields, at, length, block)
                    if message is not None:
                        yield message
                elif code == _CONNECTION:
                    self._connection(file, fields, length)
                elif code == _BAG and fields.get(b"encryptor"):
                    name = fields[b"encryptor"].decode("utf-8", "replace")[:40]
                    raise InputError(
                        f"{self._source.path}: encrypted with {name}; decrypt it with "
                        "`rosbag decrypt`"
                    )
                at += length
                file.seek(at)
        except _CutError:
            if self._cut:  # said inside the chunk that it ends in
                return
            self._cut = True
            where = f"chunk at byte {block}" if block >= 0 else f"byte {at}"
            self._walk.damage.append(
                f"{self._source.path.name} ends in the middle of a record ({where}): the recording "
                "was cut off or is damaged"
            )

    def _chunk(
        self, file: BinaryIO, fields: dict[bytes, bytes], at: int, stop: int, block: int, cut: bool
    ) -> Iterator[Message]:
        compression = fields.get(b"compression", b"none").decode("utf-8", "replace")
        self._walk.compression.add(compression)
        if compression == "none":
            yield from self.records(file, at, stop, -1)
            return
        if cut:
            return
        try:
            size = _number(fields, b"size")
            raw = decompress(file.read(stop - at), compression, size, f"chunk at byte {block}")
        except InputError as error:
            self._walk.damage.append(f"{self._source.path.name}: left out: {error}")
            return
        yield from self.records(io.BytesIO(raw), 0, len(raw), block)

    def _message(
        self, file: BinaryIO, fields: dict[bytes, bytes], at: int, size: int, block: int
    ) -> Message | None:
        channel = self._channels.get(_number(fields, b"conn"))
        if channel is None:
            raise _CutError
        seconds, nanoseconds = _TIME.unpack(fields.get(b"time", b"").ljust(8, b"\0")[:8])
        wanted = self._walk.bytes_wanted[channel]
        data = b"" if wanted == NOTHING else file.read(size if wanted == WHOLE else wanted)
        log_ns = seconds * 1_000_000_000 + nanoseconds
        return Message(channel, log_ns, data[:size], block, at, size)

    def _connection(self, file: BinaryIO, fields: dict[bytes, bytes], length: int) -> None:
        number = _number(fields, b"conn")
        if number in self._channels or length > _LARGEST_DESCRIPTION:
            return
        content = _fields(file.read(length))
        # the topic as it was named by the publisher, before remapping, stands in the content
        topic = fields.get(b"topic", b"").decode("utf-8", "replace")
        self._channels[number] = self._walk.add(
            Channel(
                "/" + "/".join(part for part in topic.split("/") if part),
                ros_type(content.get(b"type", b"").decode("utf-8", "replace")),
                "ros1",
                "ros1msg",
                content.get(b"message_definition", b""),
            )
        )


def _exactly(file: BinaryIO, size: int, at: int, end: int) -> bytes:
    data = file.read(size) if at + size <= end else b""
    if len(data) != size:
        raise _CutError
    return data


def _header(file: BinaryIO, at: int, end: int) -> tuple[dict[bytes, bytes], int]:
    """Fields of the header at `at`, and where it ends."""
    (length,) = _U32.unpack(_exactly(file, 4, at, end))
    if length > _LARGEST_HEADER:
        raise _CutError
    return _fields(_exactly(file, length, at + 4, end)), at + 4 + length


def _fields(data: bytes) -> dict[bytes, bytes]:
    fields, at = {}, 0
    while at + 4 <= len(data):
        (size,) = _U32.unpack_from(data, at)
        name, _, value = data[at + 4 : at + 4 + size].partition(b"=")
        fields[name] = value
        at += 4 + size
    return fields


def _number(fields: dict[bytes, bytes], name: bytes) -> int:
    value = fields.get(name, b"")
    if len(value) != 4:
        raise _CutError
    return int(_U32.unpack(value)[0])


def _load_chunk(path: Path, block: int) -> bytes:
    """The chunk whose record begins at byte `block`, decompressed."""
    (length,) = _U32.unpack(read_at(path, block, 4))
    fields = _fields(read_at(path, block + 4, length))
    (stored,) = _U32.unpack(read_at(path, block + 4 + length, 4))
    data = read_at(path, block + 8 + length, stored)
    compression = fields[b"compression"].decode()
    size = _number(fields, b"size")
    return decompress(data, compression, size, f"{path}, chunk at byte {block}")
