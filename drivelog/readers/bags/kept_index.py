"""What one pass over a large recording found, kept for the commands that follow.

It lies in the user's cache folder (`$XDG_CACHE_HOME/polemap/recordings`, else under `~/.cache`), is
known by the paths, sizes and times of the files, and is numbers and bytes only. A recording that
has changed is walked anew; an index that is damaged is as if it were not there.
"""

from __future__ import annotations

import hashlib
import json
import os
from array import array
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polemap import __version__
from polemap.drivelog.atomic import atomic_file
from polemap.drivelog.readers.bags.container import Channel, Container
from polemap.drivelog.readers.bags.decoding import decoder_of
from polemap.drivelog.readers.bags.index import LogIndex, Topic
from polemap.drivelog.readers.bags.transforms import TransformTree
from polemap.errors import PolemapError
from polemap.parsing.arrays import read_arrays
from polemap.parsing.json_text import parse_json

FORMAT = 1
# smaller recordings are walked in a second
KEPT_FROM_BYTES = 1 << 28
# an index has some ten MB for an hour of driving
MOST_KEPT = 24
_SERIES = {"_stamps": "q", "_logs": "q", "_places": "q", "_counts": "q", "_values": "d"}
_PLAIN = (
    "count", "first_log_ns", "last_log_ns", "frame_id", "child_frame_id", "differs",
    "undecodable", "reason",
)  # fmt: skip


def cache_folder() -> Path | None:
    """Where indexes are kept; None where the user has no home."""
    given = os.environ.get("XDG_CACHE_HOME", "")
    with suppress(RuntimeError):
        base = Path(given) if os.path.isabs(given) else Path.home() / ".cache"
        return base / "polemap" / "recordings"
    return None


def kept_or_walked(
    files: tuple[Container, ...],
    fields: Mapping[str, tuple[str, ...]],
    walk: Callable[[], LogIndex],
) -> LogIndex:
    """The index of a recording, from the cache where it has not changed since.

    Args:
        files: of the recording.
        fields: further dotted paths by topic; another index for each choice.
        walk: makes the index.

    Raises:
        InputError: of `walk`.
    """
    place = _place(files, fields)
    if place is None:
        return walk()
    with suppress(PolemapError, OSError, ValueError, LookupError, TypeError):
        found = _read(place, files)
        os.utime(place)
        return found
    index = walk()
    # a cache that cannot be written costs time, nothing else
    with suppress(PolemapError, OSError):
        place.parent.mkdir(parents=True, exist_ok=True)
        _write(place, index)
        _drop_oldest(place.parent)
    return index


def _place(files: tuple[Container, ...], fields: Mapping[str, tuple[str, ...]]) -> Path | None:
    """The file of an index; None for a recording that is small, unpacked each time or goes on."""
    folder = cache_folder()
    stats = [(file.path.resolve(), file.path.stat()) for file in files]
    packed = any(path.parent.name.startswith("polemap-") for path, _ in stats)
    goes_on = any(path.with_name(path.name + "-wal").exists() for path, _ in stats)
    if (
        folder is None
        or packed
        or goes_on
        or sum(stat.st_size for _, stat in stats) < KEPT_FROM_BYTES
    ):
        return None
    known = [(str(path), stat.st_size, stat.st_mtime_ns, stat.st_ino) for path, stat in stats]
    text = json.dumps([FORMAT, __version__, known, sorted(fields.items())])
    return folder / f"{hashlib.sha256(text.encode()).hexdigest()[:32]}.npz"


def _drop_oldest(folder: Path) -> None:
    kept = sorted(folder.glob("*.npz"), key=lambda file: file.stat().st_mtime_ns)
    for file in kept[:-MOST_KEPT]:
        file.unlink(missing_ok=True)


class _Store:
    """Series one behind another; a place is where one begins and how long it is."""

    def __init__(self) -> None:
        self.parts: dict[str, list[Any]] = {"q": [], "d": [], "b": []}
        self._ends = dict.fromkeys(self.parts, 0)

    def put(self, kind: str, values: Any) -> list[int]:
        begin = self._ends[kind]
        self._ends[kind] += len(values)
        self.parts[kind].append(values)
        return [begin, len(values)]

    def put_bytes(self, data: bytes) -> list[int]:
        return self.put("b", np.frombuffer(data, dtype=np.uint8))

    def arrays(self) -> dict[str, NDArray[Any]]:
        kinds = {"q": np.int64, "d": np.float64, "b": np.uint8}
        return {
            name: np.concatenate([np.asarray(part, dtype=kinds[name]) for part in parts])
            if parts
            else np.empty(0, dtype=kinds[name])
            for name, parts in self.parts.items()
        }


def _write(place: Path, index: LogIndex) -> None:
    store = _Store()
    topics = []
    for topic in index.topics.values():
        channel = topic.channel
        topics.append({
            "channel": [channel.topic, channel.type_name, channel.encoding,
                        channel.schema_encoding, channel.zstd],
            "schema": store.put_bytes(channel.schema),
            "kind": topic.kind, "columns": topic.columns, "other_types": topic.other_types,
            "first": None if topic.first is None else store.put_bytes(topic.first_data),
            **{name: getattr(topic, name) for name in _PLAIN},
            **{name: store.put(kind, getattr(topic, name)) for name, kind in _SERIES.items()},
        })  # fmt: skip
    pairs = [[*names, *map(float, moved), *map(float, turned)]
             for names, (moved, turned) in index.transforms.pairs.items()]  # fmt: skip
    head = {
        "topics": topics, "pairs": pairs, "moving": sorted(index.transforms.moving),
        "damage": index.damage, "compression": index.compression,
    }  # fmt: skip
    with atomic_file(place) as part, part.open("wb") as stream:
        arrays: dict[str, Any] = {"head": np.array(json.dumps(head)), **store.arrays()}
        np.savez(stream, **arrays)


def _read(place: Path, files: tuple[Container, ...]) -> LogIndex:
    if not place.is_file():
        raise LookupError(place)
    arrays = read_arrays(place)
    head: Any = parse_json(str(arrays["head"]))

    def part(kind: str, where: list[int]) -> NDArray[Any]:
        begin, length = where
        if not 0 <= begin <= begin + length <= len(arrays[kind]):
            raise LookupError("a series that is not there")
        return arrays[kind][begin : begin + length]

    topics: dict[str, Topic] = {}
    for one in head["topics"]:
        name, type_name, encoding, schema_encoding, zstd = one["channel"]
        schema = part("b", one["schema"]).tobytes()
        channel = Channel(name, type_name, encoding, schema_encoding, schema, zstd)
        topic = Topic(channel, one["kind"], tuple(one["columns"]))
        topic.other_types = list(one["other_types"])
        for field in _PLAIN:
            setattr(topic, field, one[field])
        for field, kind in _SERIES.items():
            setattr(topic, field, array(kind, part(kind, one[field]).tobytes()))
        if one["first"] is not None:
            topic.first_data = part("b", one["first"]).tobytes()
            topic.first = decoder_of(channel)(topic.first_data)
        topics[name] = topic
    transforms = TransformTree()
    for parent, child, *values in head["pairs"]:
        numbers = np.array(values, dtype=np.float64)
        transforms.pairs[parent, child] = numbers[:3], numbers[3:7]
    transforms.moving = {(parent, child) for parent, child in head["moving"]}
    return LogIndex(files, topics, transforms, tuple(head["damage"]), tuple(head["compression"]))
