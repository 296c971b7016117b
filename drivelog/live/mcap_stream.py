"""Messages of an MCAP file that has no index yet: every chunk as soon as it is complete."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from polemap.drivelog.errors import InputError
from polemap.drivelog.live.growing import GrowingBytes
from polemap.drivelog.readers.bags.container import Channel
from polemap.drivelog.readers.bags.types import ros_type
from polemap.extras import need
from polemap.parsing.errors import short

MAGIC = b"\x89MCAP0\r\n"
# recorders write chunks of 0.8 to 4 MB, a raw stereo pair of large cameras has 50 MB
_LARGEST_RECORD = 1 << 30
_RAISED = (ValueError, LookupError, struct.error, zlib.error, UnicodeDecodeError, MemoryError)


@dataclass(frozen=True, slots=True)
class StreamMessage:
    """A message as bytes; `log_s` is when it was recorded."""

    channel: Channel
    log_s: float
    data: bytes


@dataclass(frozen=True, slots=True)
class StreamFile:
    """A file attached to the recording."""

    name: str
    data: bytes


def read_stream(source: GrowingBytes) -> Iterator[StreamMessage | StreamFile]:
    """Messages and attachments in the order of the file, until it is finished or cut off.

    Raises:
        InputError: no MCAP, or damaged.
        MissingExtraError: mcap is not installed.
    """
    reading: Any = need("mcap.stream_reader")
    records: Any = need("mcap.records")
    ends: tuple[type[Exception], ...] = (need("mcap.exceptions").EndOfFile,)
    schemas: dict[int, Any] = {}
    channels: dict[int, Channel] = {}
    reader = reading.StreamReader(source, record_size_limit=_LARGEST_RECORD, validate_crcs=True)
    try:
        for record in reader.records:
            if isinstance(record, records.Message):
                channel = channels.get(record.channel_id)
                if channel is not None:
                    yield StreamMessage(channel, record.log_time / 1e9, record.data)
            elif isinstance(record, records.Schema):
                schemas[record.id] = record
            elif isinstance(record, records.Channel):
                channels[record.id] = _channel(record, schemas.get(record.schema_id))
            elif isinstance(record, records.Attachment):
                yield StreamFile(record.name, bytes(record.data))
            elif isinstance(record, records.DataEnd | records.Footer):
                return
    except ends:
        return
    except Exception as error:
        # the compressors' errors derive from nothing narrower
        if source.cut:
            return
        if isinstance(error, _RAISED) or type(error).__module__.split(".")[0] in (
            "mcap", "zstd", "zstandard", "lz4", "_block", "_frame",
        ):  # fmt: skip
            raise InputError(f"{source.name}: damaged MCAP ({short(error)})") from error
        raise


def _channel(record: Any, schema: Any) -> Channel:
    return Channel(
        record.topic,
        ros_type(schema.name if schema else ""),
        record.message_encoding,
        schema.encoding if schema else "",
        bytes(schema.data) if schema else b"",
    )
