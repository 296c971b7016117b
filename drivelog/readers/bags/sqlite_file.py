"""SQLite files of rosbag2 (.db3), schemas 1 to 4.

Source: ros2/rosbag2, rosbag2_storage_sqlite3. Pictures are long rows: their first bytes are read
without the pages behind them.
"""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

from polemap.drivelog.errors import InputError
from polemap.drivelog.readers.bags.container import HEAD_BYTES, WHOLE, Channel, Message, Walk
from polemap.drivelog.readers.bags.types import ros_type
from polemap.parsing.errors import short

MAGIC = b"SQLite format 3\0"


@dataclass(frozen=True, slots=True)
class SqliteFile:
    """One .db3 file; `zstd` where every message is compressed by itself."""

    path: Path
    zstd: bool = False
    kind: str = "rosbag2 (sqlite3)"

    def walk(self, walk: Walk) -> Iterator[Message]:
        """Every message in the order of recording; see `Container`."""
        count = 0
        try:
            with closing(_connect(self.path)) as database:
                numbers = {topic: walk.add(channel) for topic, channel in _channels(database, self)}
                walk.compression.add("zstd per message" if self.zstd else "none")
                for message in _messages(database, numbers, walk, self.path):
                    count += 1
                    yield message
        except sqlite3.Error as error:
            what = f"damaged, or no rosbag2 database ({short(error)})"
            if not count:
                raise InputError(
                    f"{self.path}: {what}; restore it, or mend it with `sqlite3 FILE .recover`"
                ) from error
            walk.damage.append(f"{self.path.name}: {what}: read up to message {count}")

    def read(self, block: int, offset: int, size: int) -> bytes:
        """A message by its row; see `Container`."""
        try:
            with closing(_connect(self.path)) as database:
                row = database.execute("SELECT data FROM messages WHERE id = ?", (offset,))
                found = row.fetchone()
        except sqlite3.Error as error:
            raise InputError(
                f"{self.path}: damaged at message {offset} ({short(error)})"
            ) from error
        if found is None:
            raise InputError(f"{self.path}: message {offset} is gone; it changed while it was read")
        return bytes(found[0])


def _connect(path: Path) -> sqlite3.Connection:
    journal = path.with_name(path.name + "-wal")
    # a recording that goes on, or was killed, has messages in a file beside
    live = journal.is_file() and journal.stat().st_size > 0
    mode = "mode=ro" if live else "mode=ro&immutable=1"
    database = sqlite3.connect(f"{path.resolve().as_uri()}?{mode}", uri=True)
    database.text_factory = lambda data: data.decode("utf-8", "replace")
    return database


def _channels(database: sqlite3.Connection, source: SqliteFile) -> Iterator[tuple[int, Channel]]:
    tables = {name for (name,) in database.execute("SELECT name FROM sqlite_master")}
    if not {"topics", "messages"} <= tables:
        raise InputError(f"{source.path}: an SQLite database without topics and messages: no bag")
    definitions: dict[str, tuple[str, str]] = {}
    if "message_definitions" in tables:
        query = "SELECT topic_type, encoding, encoded_message_definition FROM message_definitions"
        definitions = {name: (encoding, text) for name, encoding, text in database.execute(query)}
    query = "SELECT id, name, type, serialization_format FROM topics ORDER BY id"
    for number, topic, type_name, encoding in database.execute(query):
        kind, text = definitions.get(type_name, ("", ""))
        yield (
            number,
            Channel(topic, ros_type(type_name), encoding, kind, text.encode(), source.zstd),
        )


def _messages(
    database: sqlite3.Connection, numbers: dict[int, int], walk: Walk, path: Path
) -> Iterator[Message]:
    whole = [number for number, at in numbers.items() if walk.bytes_wanted[at] == WHOLE]
    marks = ",".join(str(int(number)) for number in whole) or "NULL"
    query = (
        "SELECT id, topic_id, timestamp, length(data), "
        f"CASE WHEN topic_id IN ({marks}) THEN data END FROM messages ORDER BY id"
    )
    lost = 0
    for row, topic, log_ns, size, data in database.execute(query):
        channel = numbers.get(topic)
        if channel is None or size is None:
            lost += 1
            continue
        wanted = walk.bytes_wanted[channel]
        if data is None and wanted:
            with database.blobopen("messages", "data", row, readonly=True) as blob:
                data = blob.read(min(size, HEAD_BYTES))
        yield Message(channel, log_ns, bytes(data or b""), -1, row, size)
    if lost:
        walk.damage.append(f"{path.name}: {lost} messages without a topic left out")
