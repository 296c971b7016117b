"""What a path is: a bag, an MCAP file, or a folder of either, told by the first bytes."""

from __future__ import annotations

import re
import tempfile
from functools import lru_cache
from pathlib import Path
from typing import Any

from polemap.drivelog.errors import InputError
from polemap.drivelog.readers.bags import mcap_file, rosbag1_file, sqlite_file
from polemap.drivelog.readers.bags.container import Container, changed_ns
from polemap.extras import need
from polemap.parsing.errors import named, short
from polemap.parsing.yaml_text import read_yaml

_ZSTD = b"\x28\xb5\x2f\xfd"
_ENDINGS = (".bag", ".mcap", ".db3")
_METADATA = "metadata.yaml"
_SHOWN = 3


def is_log(path: Path) -> bool:
    """Whether a path is a recording, by its first bytes or, for a folder, by what lies in it."""
    if path.is_dir():
        return _is_rosbag2(path) or bool(_parts(path) or _empty_parts(path))
    # a file that only has the name of one is told what is wrong with it
    return path.is_file() and (_magic(path) is not None or path.suffix in _ENDINGS)


def open_containers(path: Path) -> tuple[Container, ...]:
    """The files of a recording in the order of recording.

    Raises:
        InputError: one is missing, empty, of another kind than the others or no recording.
    """
    if path.is_file():
        return (_container(path, zstd=False),)
    if _is_rosbag2(path):
        return _rosbag2(path)
    # a recorder that was killed may leave an empty part after whole ones
    return tuple(_container(part, zstd=False) for part in _parts(path) or _empty_parts(path))


def _is_rosbag2(path: Path) -> bool:
    file = path / _METADATA
    if not file.is_file():
        return False
    with file.open("rb") as stream:
        return b"rosbag2_bagfile_information" in stream.read(4096)


def _parts(folder: Path) -> list[Path]:
    """Files of a folder that are recordings by their ending and first bytes, in natural order."""
    found = [
        file for file in folder.iterdir()
        if file.suffix in _ENDINGS or file.name.endswith(tuple(f"{e}.zstd" for e in _ENDINGS))
    ]  # fmt: skip
    found = [file for file in found if file.is_file() and _magic(file) is not None]
    return sorted(found, key=lambda file: _natural(file.name))


def _empty_parts(folder: Path) -> list[Path]:
    """Files of a folder that are called as recordings and hold nothing."""
    found = [file for file in folder.iterdir() if file.suffix in _ENDINGS and file.is_file()]
    return sorted(file for file in found if file.stat().st_size == 0)


def _natural(name: str) -> list[tuple[int, str]]:
    """So that part 10 follows part 9."""
    parts = re.split(r"(\d{1,18})", name)
    return [(int(part), "") if part.isdigit() else (-1, part) for part in parts]


def _magic(path: Path) -> str | None:
    """The kind of a file by its first bytes, `zstd` for a compressed one."""
    try:
        with path.open("rb") as file:
            head = file.read(16)
    except OSError:
        return None
    for start, kind in (
        (mcap_file.MAGIC, "mcap"),
        (rosbag1_file.MAGIC, "rosbag1"),
        (sqlite_file.MAGIC, "sqlite3"),
    ):
        if head.startswith(start):
            return kind
    # any file may be compressed; of a recording the name says what is inside
    inside = path.name.endswith(tuple(f"{ending}.zstd" for ending in _ENDINGS))
    return "zstd" if head.startswith(_ZSTD) and inside else None


def _container(path: Path, *, zstd: bool) -> Container:
    kind = _magic(path)
    if kind == "zstd":
        return _container(_unpacked(path, changed_ns(path)), zstd=zstd)
    if kind == "mcap":
        return mcap_file.McapFile(path, zstd)
    if kind == "rosbag1":
        return rosbag1_file.Rosbag1File(path)
    if kind == "sqlite3":
        return sqlite_file.SqliteFile(path, zstd)
    if path.stat().st_size == 0:
        raise InputError(f"{path}: is empty; the recorder wrote nothing into it")
    raise InputError(f"{path}: neither a ROS bag nor an MCAP file by its first bytes; restore it")


def _rosbag2(folder: Path) -> tuple[Container, ...]:
    place = folder / _METADATA
    try:
        with named(place, InputError, "rosbag2 metadata"):
            tree: Any = read_yaml(place)
        head: Any = tree["rosbag2_bagfile_information"]
        names = [Path(str(name)).name for name in head["relative_file_paths"]]
        mode = str(head.get("compression_mode") or "").lower()
        form = str(head.get("compression_format") or "")
    except (KeyError, TypeError, AttributeError) as error:
        raise InputError(
            f"{place}: no rosbag2 metadata ({short(error)} missing); `ros2 bag reindex` writes it "
            "anew, or move it away: the files are then read without it"
        ) from error
    if mode in ("file", "message") and form != "zstd":
        raise InputError(f"{place}: compression_format is '{form[:20]}', only zstd can be read")
    missing = [name for name in names if not (folder / name).is_file()]
    if missing:
        shown = ", ".join(missing[:_SHOWN])
        raise InputError(
            f"{place}: names {len(missing)} files that are not there ({shown}); restore them, or "
            "write it anew with `ros2 bag reindex`"
        )
    if not names:
        raise InputError(f"{place}: names no files; nothing was recorded")
    return tuple(_container(folder / name, zstd=mode == "message") for name in names)


@lru_cache(maxsize=64)
def _unpacked(path: Path, _change: int) -> Path:
    """A decompressed copy of a file that is compressed as a whole; it goes when the process ends.

    Raises:
        InputError: damaged, or the disk is full.
    """
    zstandard: Any = need("zstandard")
    target = Path(_scratch().name) / f"{abs(hash(path)):x}-{path.stem}"
    try:
        with path.open("rb") as packed, target.open("wb") as plain:
            zstandard.ZstdDecompressor().copy_stream(packed, plain)
    except zstandard.ZstdError as error:
        raise InputError(f"{path}: damaged ({short(error)}); restore the file") from error
    except OSError as error:
        raise InputError(
            f"{path}: cannot be unpacked to {target.parent} ({error.strerror}); set TMPDIR to a "
            "folder with room for it"
        ) from error
    return target


@lru_cache(maxsize=1)
def _scratch() -> tempfile.TemporaryDirectory[str]:
    return tempfile.TemporaryDirectory(prefix="polemap-")
