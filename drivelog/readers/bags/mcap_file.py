"""MCAP files, chunked or not, with and without summary.

Source: MCAP file format specification, version 0; schema and channel records are read by `mcap`.
"""

from __future__ import annotations

import io
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

from polemap.drivelog.errors import InputError
from polemap.drivelog.readers.bags.container import (
    NOTHING,
    WHOLE,
    Channel,
    Message,
    SizedFile,
    Walk,
    cached_chunk,
    changed_ns,
    decompress,
    read_at,
)
from polemap.drivelog.readers.bags.types import ros_type
from polemap.extras import need

MAGIC = b"\x89MCAP0\r\n"
_FOOTER, _SCHEMA, _CHANNEL, _MESSAGE, _CHUNK, _DATA_END = 0x02, 0x03, 0x04, 0x05, 0x06, 0x0F
_RECORD = struct.Struct("<BQ")
_MESSAGE_HEAD = struct.Struct("<HIQQ")
_CHUNK_HEAD = struct.Struct("<QQQII")
# records that describe: schemas of whole robots have a few hundred kB
_LARGEST_DESCRIPTION = 64 << 20
_PIECE = 1 << 20


@dataclass(frozen=True, slots=True)
class McapFile:
    """One MCAP file; `zstd` where rosbag2 compressed every message by itself."""

    path: Path
    zstd: bool = False
    kind: str = "MCAP"

    def walk(self, walk: Walk) -> Iterator[Message]:
        """Every message from front to back; see `Container`."""
        with self.path.open("rb", buffering=1 << 16) as file:
            if file.read(len(MAGIC)) != MAGIC:
                raise InputError(f"{self.path}: no MCAP file (its first bytes are others)")
            yield from _Walker(self, walk).records(file, self.path.stat().st_size)

    def read(self, block: int, offset: int, size: int) -> bytes:
        """A message by its place; see `Container`."""
        if block < 0:
            return read_at(self.path, offset, size)
        chunk = cached_chunk(_load_chunk, self.path, block, changed_ns(self.path))
        return chunk[offset : offset + size]


class _Walker:
    """Channels and schemas met so far; chunks may refer to those of chunks before."""

    def __init__(self, source: McapFile, walk: Walk) -> None:
        self._source, self._walk = source, walk
        self._schemas: dict[int, Any] = {}
        self._channels: dict[int, int] = {}
        self._unknown: set[int] = set()
        self._summary_read = False
        self._records, self._streams = need("mcap.records"), need("mcap.data_stream")

    def records(self, file: BinaryIO, end: int) -> Iterator[Message]:
        """Messages of the data section."""
        at = len(MAGIC)
        while True:
            head = file.read(_RECORD.size)
            if len(head) < _RECORD.size:
                self._cut(at)
                return
            code, length = _RECORD.unpack(head)
            at += _RECORD.size
            if code in (_FOOTER, _DATA_END):
                return
            if at + length > end:
                if code == _CHUNK:
                    yield from self._cut_chunk(file, at, end)
                self._cut(at)
                return
            if code == _CHUNK:
                yield from self._chunk(file, at, length)
            elif code == _MESSAGE:
                message = self._message(file, at, length, -1)
                if message is not None:
                    yield message
            else:
                self._describe(code, file, length)
            at += length
            file.seek(at)

    def _cut(self, at: int) -> None:
        self._walk.damage.append(
            f"{self._source.path.name} ends at byte {at} in the middle: the recording was cut off"
        )

    def _cut_chunk(self, file: BinaryIO, at: int, end: int) -> Iterator[Message]:
        """What a last chunk still holds; nothing if it is compressed."""
        _, _, _, _, name_length = _CHUNK_HEAD.unpack(file.read(_CHUNK_HEAD.size).ljust(32, b"\0"))
        if name_length == 0 and at + _CHUNK_HEAD.size + 8 < end:
            start = at + _CHUNK_HEAD.size + 8
            file.seek(start)
            yield from self._inside(file, start, end - start, -1, cut=True)

    def _chunk(self, file: BinaryIO, at: int, length: int) -> Iterator[Message]:
        head = file.read(_CHUNK_HEAD.size)
        if len(head) < _CHUNK_HEAD.size:
            self._damaged(at, "too short")
            return
        _, _, size, crc, name_length = _CHUNK_HEAD.unpack(head)
        rest = file.read(min(name_length, 64) + 8)
        if len(rest) < 8:
            self._damaged(at, "too short")
            return
        compression = rest[:-8].decode("utf-8", "replace")
        (stored,) = struct.unpack("<Q", rest[-8:])
        start = at + _CHUNK_HEAD.size + len(rest)
        if start + stored > at + length:
            self._damaged(at, "its length is wrong")
            return
        self._walk.compression.add(compression or "none")
        if not compression:
            if crc and crc != _crc_of(file, stored):
                self._damaged(at, "its checksum is wrong")
                return
            file.seek(start)
            yield from self._inside(file, start, stored, -1)
            return
        try:
            raw = decompress(file.read(stored), compression, size, f"chunk at byte {at}")
            _check(raw, crc, at)
        except InputError as error:
            self._damaged(at, str(error))
            return
        yield from self._inside(io.BytesIO(raw), 0, len(raw), at)

    def _from_summary(self, number: int) -> int | None:
        """A channel whose chunk was left out, as the end of the file repeats it."""
        if not self._summary_read:
            self._summary_read = True
            reader: Any = need("mcap.reader")
            with SizedFile(self._source.path) as file:
                try:
                    summary = reader.make_reader(file).get_summary()
                except (need("mcap.exceptions").McapError, ValueError, struct.error, OSError):
                    summary = None
            if summary is not None:
                for schema in summary.schemas.values():
                    self._schemas.setdefault(schema.id, schema)
                for channel in summary.channels.values():
                    self._announce(channel)
        return self._channels.get(number)

    def _damaged(self, at: int, why: str) -> None:
        self._walk.damage.append(f"{self._source.path.name}: chunk at byte {at} left out: {why}")

    def _inside(
        self, file: BinaryIO, start: int, length: int, block: int, *, cut: bool = False
    ) -> Iterator[Message]:
        """Messages of a chunk's content; of one that is cut off the last record is not whole."""
        at, end = start, start + length
        while at + _RECORD.size <= end:
            code, size = _RECORD.unpack(file.read(_RECORD.size))
            at += _RECORD.size
            if at + size > end:
                if not cut:
                    self._damaged(max(block, at), "a record in it is longer than it")
                return
            if code == _MESSAGE:
                message = self._message(file, at, size, block)
                if message is not None:
                    yield message
            else:
                self._describe(code, file, size)
            at += size
            file.seek(at)

    def _message(self, file: BinaryIO, at: int, length: int, block: int) -> Message | None:
        if length < _MESSAGE_HEAD.size:
            self._damaged(at, "a message shorter than its head")
            return None
        number, _, log_ns, _ = _MESSAGE_HEAD.unpack(file.read(_MESSAGE_HEAD.size))
        channel = self._channels.get(number)
        if channel is None:
            channel = self._from_summary(number)
        if channel is None:
            if number not in self._unknown:
                self._unknown.add(number)
                self._walk.damage.append(
                    f"{self._source.path.name}: messages of channel {number} left out, from byte "
                    f"{at} on: what announced it is lost"
                )
            return None
        wanted, size = self._walk.bytes_wanted[channel], length - _MESSAGE_HEAD.size
        data = b"" if wanted == NOTHING else file.read(size if wanted == WHOLE else wanted)
        return Message(channel, log_ns, data[:size], block, at + _MESSAGE_HEAD.size, size)

    def _describe(self, code: int, file: BinaryIO, length: int) -> None:
        if code not in (_SCHEMA, _CHANNEL) or length > _LARGEST_DESCRIPTION:
            return
        stream = self._streams.ReadDataStream(io.BytesIO(file.read(length)))
        try:
            record = getattr(self._records, "Schema" if code == _SCHEMA else "Channel").read(stream)
        except (need("mcap.exceptions").McapError, ValueError, struct.error) as error:
            raise InputError(
                f"{self._source.path}: damaged before its messages ({error}); restore the file, "
                "or mend it with `mcap recover`"
            ) from error
        if code == _SCHEMA:
            self._schemas[record.id] = record
        else:
            self._announce(record)

    def _announce(self, record: Any) -> None:
        """Take up a channel record."""
        if record.id in self._channels:
            return
        schema = self._schemas.get(record.schema_id)
        self._channels[record.id] = self._walk.add(
            Channel(
                record.topic,
                ros_type(schema.name if schema else ""),
                record.message_encoding,
                schema.encoding if schema else "",
                bytes(schema.data) if schema else b"",
                self._source.zstd,
            )
        )


def _crc_of(file: BinaryIO, length: int) -> int:
    """CRC-32 of the next bytes, some at a time."""
    crc = 0
    while length > 0 and (data := file.read(min(length, _PIECE))):
        crc, length = zlib.crc32(data, crc), length - len(data)
    return crc


def _check(raw: bytes, crc: int, at: int) -> None:
    if crc and zlib.crc32(raw) != crc:
        raise InputError(f"chunk at byte {at}: its checksum is wrong")


def _load_chunk(path: Path, block: int) -> bytes:
    """The chunk whose record's content begins at byte `block`, decompressed and checked."""
    _, _, size, crc, name_length = _CHUNK_HEAD.unpack(read_at(path, block, _CHUNK_HEAD.size))
    rest = read_at(path, block + _CHUNK_HEAD.size, name_length + 8)
    (stored,) = struct.unpack("<Q", rest[-8:])
    data = read_at(path, block + _CHUNK_HEAD.size + len(rest), stored)
    raw = decompress(data, rest[:-8].decode(), size, f"{path}, chunk at byte {block}")
    _check(raw, crc, block)
    return raw
