"""One pass over a recording: counts and times of every topic, the numbers of the small ones.

Kept are 48 bytes a picture and 8 bytes a number, in flat arrays; nothing grows with the size of
the pictures.
"""

from __future__ import annotations

from array import array
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.readers.bags.container import (
    HEAD_BYTES,
    NOTHING,
    WHOLE,
    Channel,
    Container,
    Message,
    Walk,
)
from polemap.drivelog.readers.bags.decoding import (
    Decode,
    UnknownTypeError,
    decoder_of,
    head_stamp_ns,
    stamp_ns,
)
from polemap.drivelog.readers.bags.fields import COLUMNS, Extract, FieldError, by_path, extract_of
from polemap.drivelog.readers.bags.transforms import TransformTree, transforms_of
from polemap.drivelog.readers.bags.types import Kind, kind_of
from polemap.errors import PolemapError

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
_PLACE = 4  # file, block, offset, size


@dataclass(slots=True)
class Topic:
    """What one pass found of a topic.

    Attributes:
        channel: of its first message.
        count: messages of it, the undecodable ones included.
        first_log_ns, last_log_ns: when the first and the last were recorded.
        frame_id, child_frame_id: of the first message.
        first: the first message, of cameras and joints, and `first_data` its bytes; None of others.
        undecodable: messages that could not be read, and why the first could not.
    """

    channel: Channel
    kind: Kind | None
    columns: tuple[str, ...] = ()
    count: int = 0
    first_log_ns: int = 0
    last_log_ns: int = 0
    frame_id: str = ""
    child_frame_id: str = ""
    first: Any = None
    first_data: bytes = b""
    differs: int = 0
    undecodable: int = 0
    reason: str = ""
    other_types: list[str] = field(default_factory=list)
    _stamps: array[int] = field(default_factory=lambda: array("q"))
    _logs: array[int] = field(default_factory=lambda: array("q"))
    _values: array[float] = field(default_factory=lambda: array("d"))
    _places: array[int] = field(default_factory=lambda: array("q"))
    _counts: array[int] = field(default_factory=lambda: array("q"))

    @property
    def name(self) -> str:
        """The topic's name."""
        return self.channel.topic

    @property
    def stamps_ns(self) -> Integers:
        """`(n,)` stamps in the headers, 0 where there is none, in the order of recording."""
        return np.frombuffer(self._stamps, dtype=np.int64) if self._stamps else _none(np.int64)

    @property
    def logs_ns(self) -> Integers:
        """`(n,)` times of recording."""
        return np.frombuffer(self._logs, dtype=np.int64) if self._logs else _none(np.int64)

    @property
    def places(self) -> Integers:
        """`(n, 4)` file, block, offset and size of every picture."""
        flat = np.frombuffer(self._places, dtype=np.int64) if self._places else _none(np.int64)
        return flat.reshape(-1, _PLACE)

    @property
    def counts(self) -> Integers:
        """`(n,)` how many rows of `column` each message of several has."""
        return np.frombuffer(self._counts, dtype=np.int64) if self._counts else _none(np.int64)

    def column(self, name: str) -> Floats:
        """`(n,)` one of `columns`."""
        flat = np.frombuffer(self._values, dtype=np.float64) if self._values else _none(np.float64)
        return flat.reshape(-1, len(self.columns))[:, self.columns.index(name)]

    def rate_hz(self) -> float:
        """Messages a second by the times of recording; NaN for fewer than two."""
        span = self.last_log_ns - self.first_log_ns
        return (self.count - 1) / (span * 1e-9) if self.count > 1 and span > 0 else float("nan")


def _none(kind: Any) -> NDArray[Any]:
    return np.empty(0, dtype=kind)


@dataclass(frozen=True, slots=True)
class LogIndex:
    """A recording after one pass.

    Attributes:
        containers: its files; `Topic.places` counts them.
        topics: by name, in the order in which they appear.
        transforms: from /tf and /tf_static.
        damage: what was left out because a file is cut off or damaged.
        compression: of the chunks.
    """

    containers: tuple[Container, ...]
    topics: Mapping[str, Topic]
    transforms: TransformTree
    damage: tuple[str, ...]
    compression: tuple[str, ...]

    def read(self, topic: Topic, row: int) -> bytes:
        """The bytes of a picture's message."""
        file, block, offset, size = (int(value) for value in topic.places[row])
        return self.containers[file].read(block, offset, size)

    @property
    def span_s(self) -> float:
        """From the first to the last recorded message."""
        known = [topic for topic in self.topics.values() if topic.count]
        if not known:
            return 0.0
        last = max(topic.last_log_ns for topic in known)
        return (last - min(topic.first_log_ns for topic in known)) * 1e-9


def build_index(
    containers: Iterable[Container], fields: Mapping[str, tuple[str, ...]] | None = None
) -> LogIndex:
    """Walk every file once.

    Args:
        containers: the files in the order of recording.
        fields: further dotted paths by topic, for types that nothing here knows.

    Raises:
        InputError: a file that cannot be read at all.
    """
    files = tuple(containers)
    builder = _Builder(dict(fields or {}))
    for number, container in enumerate(files):
        builder.add_file(number, container)
    return LogIndex(
        files,
        builder.topics,
        builder.transforms,
        tuple(builder.damage),
        tuple(sorted(builder.compression)),
    )


@dataclass(slots=True)
class _Way:
    """How the messages of one channel are taken up."""

    topic: Topic
    decode: Decode | None = None
    extract: Extract | None = None
    head_stamp: Any = None


class _Builder:
    def __init__(self, fields: dict[str, tuple[str, ...]]) -> None:
        self.topics: dict[str, Topic] = {}
        self.transforms = TransformTree()
        self.damage: list[str] = []
        self.compression: set[str] = set()
        self._fields = fields

    def add_file(self, number: int, container: Container) -> None:
        walk = Walk(self._wanted)
        ways: list[_Way] = []
        for message in container.walk(walk):
            while len(ways) < len(walk.channels):
                ways.append(self._way(walk.channels[len(ways)]))
            self._take(ways[message.channel], message, number)
        while len(ways) < len(walk.channels):  # topics without a message are listed, too
            ways.append(self._way(walk.channels[len(ways)]))
        self.damage += walk.damage
        self.compression |= walk.compression

    def _wanted(self, channel: Channel) -> int:
        kind = kind_of(channel.type_name)
        if kind == "picture":
            return HEAD_BYTES if head_stamp_ns(channel) and not channel.zstd else WHOLE
        return WHOLE if kind is not None or channel.topic in self._fields else NOTHING

    def _way(self, channel: Channel) -> _Way:
        kind = kind_of(channel.type_name)
        topic = self.topics.get(channel.topic)
        if topic is None:
            topic = self.topics[channel.topic] = Topic(channel, kind)
            topic.columns = self._fields.get(channel.topic) or COLUMNS.get(kind or "picture", ())
        elif topic.channel.type_name != channel.type_name:
            if channel.type_name not in topic.other_types:
                topic.other_types.append(channel.type_name)
            return _Way(topic)
        way = _Way(topic)
        if kind is None and channel.topic not in self._fields:
            return way
        try:
            way.decode = decoder_of(channel)
        except UnknownTypeError as error:
            topic.reason = str(error)
            return way
        if channel.topic in self._fields:
            way.extract = by_path(topic.columns)
        elif kind is not None:
            way.extract = extract_of(kind)
        if kind == "picture":
            way.head_stamp = head_stamp_ns(channel)
        return way

    def _take(self, way: _Way, message: Message, file: int) -> None:
        topic = way.topic
        if not topic.count:
            topic.first_log_ns = message.log_ns
        topic.first_log_ns = min(topic.first_log_ns, message.log_ns)
        topic.last_log_ns = max(topic.last_log_ns, message.log_ns)
        topic.count += 1
        if way.decode is None:
            return
        try:
            self._decode(way, way.decode, message, file)
        except Exception as error:
            # libraries raise what their generated code raises; a message is no reason to stop
            if isinstance(error, MemoryError | PolemapError):
                raise
            topic.undecodable += 1
            why = (
                str(error) if isinstance(error, FieldError) else f"{type(error).__name__}: {error}"
            )
            topic.reason = topic.reason or why

    def _decode(self, way: _Way, decode: Decode, message: Message, file: int) -> None:
        topic = way.topic
        if topic.kind == "picture":
            stamp = (
                way.head_stamp(message.data) if way.head_stamp else stamp_ns(decode(message.data))
            )
            topic._places.extend((file, message.block, message.offset, message.size))
        else:
            content = decode(message.data)
            stamp = stamp_ns(content)
            if topic.kind == "transforms":
                self.transforms.add(transforms_of(content))
                return
            self._keep(way, content, message.data)
        topic._stamps.append(stamp)
        topic._logs.append(message.log_ns)

    def _keep(self, way: _Way, content: Any, data: bytes) -> None:
        topic = way.topic
        if not topic._stamps:
            header = getattr(content, "header", content)
            topic.frame_id = str(getattr(header, "frame_id", "")).lstrip("/")
            topic.child_frame_id = str(getattr(content, "child_frame_id", "")).lstrip("/")
            if topic.kind in ("camera", "joints"):
                topic.first, topic.first_data = content, data
            if topic.kind == "joints" and topic.name not in self._fields:
                count = len(content.velocity)
                topic.columns = tuple(f"velocity[{joint}]" for joint in range(count))
                way.extract = by_path(topic.columns)
        if topic.kind == "camera":
            topic.differs += not same_camera(topic.first, content)
        elif way.extract is not None:
            values = [float(value) for value in way.extract(content)]
            topic._values.extend(values)
            if topic.kind == "poles":
                topic._counts.append(len(values) // len(topic.columns))


def same_camera(first: Any, other: Any) -> bool:
    """Whether two messages of a camera's calibration say the same."""
    for upper in "KDRP":
        a, b = (getattr(m, upper.lower(), getattr(m, upper, ())) for m in (first, other))
        if not np.array_equal(np.asarray(a), np.asarray(b)):
            return False
    return True
