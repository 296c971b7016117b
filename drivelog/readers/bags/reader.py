"""ROS bags and MCAP files as drives."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from typing import Any, Literal

from polemap.drivelog.drive import Drive
from polemap.drivelog.errors import InputError
from polemap.drivelog.readers.bags.build import Build
from polemap.drivelog.readers.bags.described import (
    HEAD,
    Description,
    attached_files,
    describe,
    own_mapping,
    with_description,
)
from polemap.drivelog.readers.bags.files import is_log, open_containers
from polemap.drivelog.readers.bags.guess import Guess, guess
from polemap.drivelog.readers.bags.index import LogIndex, build_index
from polemap.drivelog.readers.bags.kept_index import kept_or_walked
from polemap.drivelog.readers.bags.mapping_file import check_topics, read_mapping
from polemap.parsing.errors import named


class LogReader:
    """Reads rosbag1, rosbag2 (SQLite and MCAP) and MCAP, split or compressed."""

    name = "ros_mcap"
    takes_topics: Literal[True] = True

    def can_read(self, path: Path) -> bool:
        return is_log(path)

    def read(self, path: Path, *, seed: int = 0, topics: Path | None = None) -> Drive:
        """The drive; everything in it was measured, so that `seed` changes nothing.

        Args:
            path: the recording.
            seed: of nothing.
            topics: a mapping of topics; what it leaves out is guessed.

        Raises:
            InputError: no recording, or one that cannot be used; mistakes in the mapping.
        """
        index, made = survey(path, topics)
        known = _described(path) if topics is None else None
        if known is None:
            return Build(path, index, made).drive()
        read = Build(path, index, made, known.view).drive()
        return with_description(read, known.drive)


def survey(path: Path, topics: Path | None = None) -> tuple[LogIndex, Guess]:
    """What a recording holds, and what each of its topics is used for.

    Raises:
        InputError: no recording, damaged beyond reading, or mistakes in the mapping.
    """
    told = read_mapping(topics) if topics is not None else None
    fields = tuple(sorted((told.fields() if told else {}).items()))
    with named(path, InputError, "recording"):
        files = open_containers(path)
        index = _indexed(files, tuple(_version(file.path) for file in files), fields)
    if told is not None and topics is not None:
        check_topics(told, index, topics)
    known = _described(path) if told is None else None
    if known is not None:
        return index, guess(index, own_mapping(index.topics, known.drive))
    return index, guess(index, told)


def _described(path: Path) -> Description | None:
    """What is attached to a recording that `polemap convert` wrote; None of any other."""
    files = attached_files(path)
    return describe(files, str(path)) if HEAD in files else None


def _version(path: Path) -> tuple[int, int]:
    stat = path.stat()
    return stat.st_mtime_ns, stat.st_size


@lru_cache(maxsize=2)
def _indexed(files: tuple[Any, ...], _versions: Any, fields: tuple[Any, ...]) -> LogIndex:
    """One pass a recording: commands open a drive more than once, and one follows another."""
    wanted = dict(fields)
    return kept_or_walked(files, wanted, lambda: build_index(files, wanted))


def forget() -> None:
    """Drop what was kept of recordings, for files that change faster than their times tell."""
    _indexed.cache_clear()


reader = LogReader()
