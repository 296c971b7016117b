"""Which kinds of drives can be read, and the door to all of them: `open_drive`."""

from __future__ import annotations

import os
import warnings
from functools import cache
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Literal, Protocol, cast

from polemap.drivelog.drive import Drive
from polemap.drivelog.errors import InputError
from polemap.errors import PolemapError
from polemap.parsing.errors import named
from polemap.plugins import READERS, load_plugins, short


class Reader(Protocol):
    """One way in which drives are stored; found through the entry points `polemap.readers`."""

    @property
    def name(self) -> str:
        """What the kind of drive is called."""

    def can_read(self, path: Path) -> bool:
        """Whether the path looks like a drive of this kind; touches little."""
        ...

    def read(self, path: Path, *, seed: int) -> Drive:
        """The drive; `seed` is for sensors that have to be derived.

        Raises:
            InputError: anything in it that cannot be used, with file, place and value.
        """
        ...


# an installation that is older than the checkout it points to does not list the newest of these
_OWN = {
    "folder": "polemap.drivelog.readers.folder:reader",
    "kitti_odometry": "polemap.drivelog.readers.kitti_odometry:reader",
    "kitti_raw": "polemap.drivelog.readers.kitti_raw:reader",
    "ros_mcap": "polemap.drivelog.readers.bags.reader:reader",
}


class TopicReader(Reader, Protocol):
    """A reader of recordings with named topics, which a mapping assigns to the streams."""

    takes_topics: Literal[True]

    def read(self, path: Path, *, seed: int, topics: Path | None = None) -> Drive:
        """The drive, by the mapping in the file `topics`; see `Reader`."""
        ...


@cache
def readers() -> tuple[Reader, ...]:
    """Every reader, ours and those of installed packages; looked for once, which takes 20 ms."""
    own = {name: EntryPoint(name, value, READERS).load() for name, value in _OWN.items()}
    others = load_plugins(READERS, ("name", "can_read", "read"), frozenset(own))
    return tuple(sorted((own | dict(others)).values(), key=lambda reader: str(reader.name)))


def reader_of(path: Path) -> Reader | None:
    """The reader that knows a path; None if none does.

    A plug-in that fails is warned of and passed over.
    """
    for reader in readers():
        try:
            if reader.can_read(path):
                return reader
        except PolemapError:
            raise
        except Exception as error:
            if type(reader).__module__.startswith("polemap."):
                raise
            warnings.warn(
                f"reader '{reader.name}' fails at {path} ({short(error)}) and is passed over",
                stacklevel=2,
            )
    return None


def open_drive(path: str | Path, *, seed: int = 0, topics: str | Path | None = None) -> Drive:
    """Open a drive, of whatever kind it is.

    Args:
        path: folder or file.
        seed: of the noise in sensors that a kind of drive lacks and its reader derives.
        topics: mapping of the topics of a ROS bag or MCAP file; without it they are guessed.

    Raises:
        InputError: no such path, no reader knows it, or something in it cannot be used.
    """
    path = Path(path)
    with named(path, InputError, "drive"):
        if not os.path.exists(path):
            raise InputError(f"{path}: no such drive")
        reader = reader_of(path)
        if reader is not None:
            if topics is None:
                return reader.read(path, seed=seed)
            if not getattr(reader, "takes_topics", False):
                raise InputError(
                    f"{path}: a drive of kind {reader.name} has no topics; --topics is for ROS "
                    "bags and MCAP files"
                )
            return cast(TopicReader, reader).read(path, seed=seed, topics=Path(topics))
    kinds = ", ".join(reader.name for reader in readers())
    raise InputError(
        f"{path}: not a drive that can be read (kinds: {kinds}); a plain drive folder holds a "
        "drive.yaml"
    )
