"""An MCAP file of ROS 2 messages, filled one message at a time."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO

from polemap.drivelog.errors import InputError
from polemap.drivelog.writers.ros.types import message_types, type_of
from polemap.extras import need

_LARGEST_NS = 2**64 - 1


class McapFile:
    """Writes messages in the order of the calls; log times should rise."""

    def __init__(self, file: BinaryIO) -> None:
        writer: Any = need("mcap.writer")
        need("zstandard")  # mcap compresses with it
        self._writer = writer.Writer(file, compression=writer.CompressionType.ZSTD)
        self._writer.start(profile="ros2", library="polemap")
        self._types = message_types()
        self._schemas: dict[str, int] = {}
        self._channels: dict[tuple[str, str], int] = {}
        self._written: Counter[int] = Counter()

    @property
    def counts(self) -> dict[str, int]:
        """Messages by topic."""
        return {topic: self._written[number] for (topic, _), number in self._channels.items()}

    def write(self, topic: str, message: Any, log_s: float, stamp_s: float | None = None) -> None:
        """Append a message.

        Args:
            log_s: when it became known; `stamp_s` (the same, where not given) when it was made.

        Raises:
            InputError: a time before zero or not finite, which MCAP has no number for.
        """
        channel = self._channel(topic, type_of(message))
        log_ns = nanoseconds(log_s, topic)
        self._writer.add_message(
            channel_id=channel,
            log_time=log_ns,
            publish_time=log_ns if stamp_s is None else nanoseconds(stamp_s, topic),
            sequence=self._written[channel],
            data=self._types.serialize(message),
        )
        self._written[channel] += 1

    def attach(self, name: str, media_type: str, content: bytes) -> None:
        """Put a whole file into this one."""
        self._writer.add_attachment(
            create_time=0, log_time=0, name=name, media_type=media_type, data=content
        )

    def describe(self, name: str, values: Mapping[str, str]) -> None:
        """Add a record of named texts."""
        self._writer.add_metadata(name, dict(values))

    def finish(self) -> None:
        """Write the index; the file is whole from here on."""
        self._writer.finish()

    def _channel(self, topic: str, type_name: str) -> int:
        if (topic, type_name) in self._channels:
            return self._channels[topic, type_name]
        if type_name not in self._schemas:
            self._schemas[type_name] = self._writer.register_schema(
                name=type_name,
                encoding="ros2msg",
                data=self._types.definition(type_name).encode("utf-8"),
            )
        channel: int = self._writer.register_channel(
            topic=topic, message_encoding="cdr", schema_id=self._schemas[type_name]
        )
        self._channels[topic, type_name] = channel
        return channel


@contextmanager
def mcap_file(part: Path) -> Iterator[McapFile]:
    """A writer to `part`, which the caller puts in place; it is finished where the block ends well.

    Raises:
        MissingExtraError: mcap, rosbags or zstandard is not installed.
    """
    with part.open("wb") as file:
        writer = McapFile(file)
        yield writer
        writer.finish()


def nanoseconds(time_s: float, place: str) -> int:
    """Seconds as the whole nanoseconds of ROS and MCAP, exactly rounded.

    Raises:
        InputError: before zero, not finite or beyond the numbers of MCAP.
    """
    if not 0.0 <= time_s <= _LARGEST_NS / 1e9:
        raise InputError(
            f"{place}: a time of {time_s:.6g} s; MCAP counts nanoseconds from zero on, so shift "
            "the drive's stamps"
        )
    whole = int(time_s)
    return whole * 1_000_000_000 + round((time_s - whole) * 1e9)
