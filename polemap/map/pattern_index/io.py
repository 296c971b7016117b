"""The index of patterns on the disk, beside its map: arrays that are mapped, not read.

`MAP.patterns` begins with a mark and the length of its head. The head is a JSON object: version,
frame, the digest of every tile, what the map's files were like (size, time of change, SHA-256 of
their bytes), and type, shape and place of every array, which follow as plain numbers. Behind them
stand the CRC-32 of every block of 64 KiB of the arrays, and one of mark, head and these: the last
is held against what is read at opening, the others where a block is first touched. An index whose
map has changed since, or of another version, is not used.
"""

from __future__ import annotations

import json
import math
import os
import struct
import weakref
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.atomic import atomic_file
from polemap.drivelog.errors import InputError, OutputError
from polemap.drivelog.frames import EarthFrame
from polemap.map.files.io import State, is_of, map_digests, map_state, require_map
from polemap.map.pattern_index.blocks import BLOCK, BlockSums, CheckedBlocks
from polemap.map.pattern_index.build import Run, TiledMap, build_index, here, kept_tiles
from polemap.map.pattern_index.index import PatternIndex
from polemap.map.pole_map import PoleMap
from polemap.parsing.errors import ParsingError, named
from polemap.parsing.json_text import parse_json

VERSION = 3
_MARK = b"polemap patterns\n"
_LENGTH, _SUM = struct.Struct("<Q"), struct.Struct("<I")
_ALIGNED = 64
_LARGEST_HEAD = 100_000_000
_REMEDY = "delete it and polemap map --index or polemap where builds it anew"
_ARRAYS = {
    "points_m": "<f8", "sd_m": "<f4", "width_m": "<f4", "cells": "<i8", "cell_first": "<i8",
    "shapes": "<u4", "shape_first": "<i8", "pole": "<u4", "direction": "<u2",
}  # fmt: skip


def index_file(map_file: Path) -> Path:
    """Where the index of a map stands: beside its file, or beside its folder."""
    return map_file.with_name(map_file.name + ".patterns")


def write_index(
    pole_map: PoleMap | TiledMap,
    map_file: Path,
    *,
    run: Run = here,
    state: State | None = None,
) -> PatternIndex:
    """Build the index of a map that stands in a file or folder, and write it beside it.

    Of an index that is there already, tiles whose poles are the same are taken over.

    Args:
        pole_map: what the file holds.
        run: see `build_index`.
        state: of the map before it was read, where that was not just now.

    Raises:
        InputError: a pole that stands nowhere on the earth, or a map that changes meanwhile.
        OutputError: the place cannot be written to.
    """
    path = index_file(map_file)
    check_replaceable(path)
    state = state or map_state(map_file)
    index, digests = build_index(pole_map, run=run, old=_old_tiles(path))
    hashed = map_digests(map_file)
    if map_state(map_file) != state:
        raise InputError(f"{map_file}: it has changed while its index was built; build it again")
    arrays = {
        name: np.ascontiguousarray(getattr(index, name), dtype) for name, dtype in _ARRAYS.items()
    }
    places, offset = {}, 0
    for name, array in arrays.items():
        places[name] = {"shape": list(array.shape), "offset": offset}
        offset += -(-array.nbytes // _ALIGNED) * _ALIGNED
    head = {
        "version": VERSION,
        "map": {name: known | {"sha256": hashed[name]} for name, known in state.items()},
        "frame": index.frame.to_dict(),
        "arrays": places,
        "bytes": offset,
        "tiles": {str(tile): digest for tile, digest in digests.items()},
    }
    text = json.dumps(head).encode()
    text += b" " * (-(len(_MARK) + _LENGTH.size + len(text)) % _ALIGNED)
    opening = _MARK + _LENGTH.pack(len(text)) + text
    blocks = BlockSums()
    with atomic_file(path, [map_file]) as part, part.open("wb") as stream:
        stream.write(opening)
        for array in arrays.values():
            for data in (array.data if array.size else b"", bytes(-array.nbytes % _ALIGNED)):
                blocks.add(data)
                stream.write(data)
        sums = blocks.sums().tobytes()
        stream.write(sums + _SUM.pack(zlib.crc32(sums, zlib.crc32(opening))))
    return index


def check_replaceable(path: Path) -> None:
    """Refuse to write an index where something else stands.

    Raises:
        OutputError: a file that is no index, or no file.
    """
    if not path.exists():
        return
    if not path.is_file() or (path.stat().st_size and not _is_marked(path)):
        raise OutputError(f"{path}: is no index of patterns and would be replaced; move it away")


def _is_marked(path: Path) -> bool:
    with path.open("rb") as stream:
        return stream.read(len(_MARK)) == _MARK


def read_index(map_file: Path) -> PatternIndex | None:
    """The index of a map, its arrays mapped from the disk; None where there is none for this map.

    Raises:
        InputError: it is damaged.
    """
    path = index_file(map_file)
    if not path.is_file():
        return None
    head, begin = _head(path)
    with named(path, InputError, "index of patterns"):
        if head["version"] != VERSION:
            return None
        sums = _sums(path, begin, head["bytes"])
        kept = {
            str(name): {key: one[key] for key in ("size", "modified_ns", "sha256")}
            for name, one in head["map"].items()
        }
    with named(map_file, InputError, "map"):
        if not is_of(kept, map_file):
            return None
    return _arrays(path, head, begin, sums)


def open_index(
    map_file: Path,
    load: Callable[[], PoleMap | TiledMap],
    *,
    say: Callable[[str], None],
    run: Run = here,
) -> PatternIndex:
    """The index of a map; built and kept beside it where it is missing, outdated or damaged.

    Where it cannot be kept it is built in memory.

    Args:
        load: opens the map's poles.
        say: is told why it must be built, and where it cannot be kept.

    Raises:
        InputError: the map cannot be read.
    """
    require_map(map_file)
    why = f"{map_file}: it has no index of patterns"
    try:
        index = read_index(map_file)
        if index is not None:
            return index
        if index_file(map_file).is_file():
            why = f"{index_file(map_file)}: is of another map, or of another version"
    except InputError as error:
        why = str(error)
    say(f"{why}; it is built now")
    try:
        with named(map_file, InputError, "map"):
            state = map_state(map_file)
        built = write_index(load(), map_file, run=run, state=state)
    except (OutputError, PermissionError) as error:
        say(f"{index_file(map_file)}: cannot be kept ({error}); built for this call only")
        return build_index(load(), run=run)[0]
    # mapped from the disk it takes no memory of its own
    return read_index(map_file) or built


def _head(path: Path) -> tuple[Any, int]:
    """The head of an index, and where its arrays begin; that of another version unchecked."""
    with named(path, InputError, "index of patterns"), path.open("rb") as stream:
        mark, length = stream.read(len(_MARK)), stream.read(_LENGTH.size)
        if mark != _MARK or len(length) != _LENGTH.size:
            raise InputError(f"{path}: is no index of patterns; {_REMEDY}")
        (size,) = _LENGTH.unpack(length)
        text = stream.read(min(size, _LARGEST_HEAD))
        if len(text) != size:
            raise InputError(f"{path}: its head is cut off; {_REMEDY}")
        try:
            head = parse_json(text.decode())
        except (ParsingError, ValueError) as error:
            raise InputError(f"{path}: its head is damaged ({error}); {_REMEDY}") from error
        wanted = {"version", "map", "frame", "arrays", "bytes", "tiles"}
        if not isinstance(head, dict) or not wanted <= set(head):
            raise InputError(f"{path}: its head lacks entries; {_REMEDY}")
        return head, stream.tell()


def _arrays(path: Path, head: Any, begin: int, sums: NDArray[np.uint32]) -> PatternIndex:
    with named(path, InputError, "index of patterns"):
        long = int(head["bytes"])
        data = np.memmap(path, np.uint8, "r", begin, (long,)) if long else np.empty(0, np.uint8)
        arrays: dict[str, NDArray[Any]] = {}
        places: dict[str, tuple[int, int]] = {}
        for name, dtype in _ARRAYS.items():
            shape = tuple(int(n) for n in head["arrays"][name]["shape"])
            offset = int(head["arrays"][name]["offset"])
            size = math.prod(shape) * np.dtype(dtype).itemsize
            if min(shape) < 0 or not 0 <= offset <= long - size:
                raise InputError(f"{path}: its {name} lies outside the file; {_REMEDY}")
            places[name] = offset, math.prod(shape[1:]) * np.dtype(dtype).itemsize
            # views of one mapping: pages that are mapped twice count twice
            arrays[name] = data[offset : offset + size].view(dtype).reshape(shape)
        blocks = CheckedBlocks((str(path), _REMEDY), data, sums, places, _watch(path))
        index = PatternIndex(frame=_frame(head, path), **arrays, blocks=blocks)
        _check(index, path)
        return index


def _sums(path: Path, begin: int, long: Any) -> NDArray[np.uint32]:
    """The checksums of the blocks, which stand behind so many bytes of arrays."""
    if not isinstance(long, int):
        raise InputError(f"{path}: its head is damaged (bytes {long!r}); {_REMEDY}")
    count = -(-long // BLOCK)
    expected = begin + long + count * _SUM.size + _SUM.size
    size = path.stat().st_size
    if size != expected:
        raise InputError(f"{path}: has {size} bytes, its head tells of {expected}; {_REMEDY}")
    with path.open("rb") as stream:
        opening = stream.read(begin)
        stream.seek(begin + long)
        sums, last = stream.read(count * _SUM.size), stream.read()
    if _SUM.pack(zlib.crc32(sums, zlib.crc32(opening))) != last:
        raise InputError(f"{path}: its head or its checksums are damaged; {_REMEDY}")
    return np.frombuffer(sums, "<u4")


def _watch(path: Path) -> Callable[[], bool]:
    """Says whether the bytes of the file that is open now are written over. A file that is
    replaced by a rename, or deleted, stays what it was for those who have it open."""
    file = os.open(path, os.O_RDONLY)
    known = os.fstat(file)

    def changed() -> bool:
        now = os.fstat(file)
        return (now.st_size, now.st_mtime_ns) != (known.st_size, known.st_mtime_ns)

    weakref.finalize(changed, os.close, file)
    return changed


def _frame(head: Any, path: Path) -> EarthFrame:
    try:
        return EarthFrame.from_dict(head["frame"])
    except InputError as error:
        raise InputError(f"{path}: its head is damaged ({error}); {_REMEDY}") from error


def _check(index: PatternIndex, path: Path) -> None:
    n = len(index.points_m)
    same = index.points_m.shape == (n, 2) and len(index.sd_m) == n and len(index.width_m) == n
    same &= len(index.pole) == len(index.direction)
    for starts, values, last in (
        (index.cell_first, index.cells, n),
        (index.shape_first, index.shapes, len(index.pole)),
    ):
        same &= len(starts) == len(values) + 1 and starts[0] == 0 and starts[-1] == last
    if not same:
        raise InputError(f"{path}: its arrays do not belong together; {_REMEDY}")


def _old_tiles(path: Path) -> Any:
    """Triangles by digest of the index that stands there; None where it is of no use."""
    if not path.is_file():
        return None
    try:
        head, begin = _head(path)
        if head["version"] != VERSION:
            return None
        with named(path, InputError, "index of patterns"):
            index = _arrays(path, head, begin, _sums(path, begin, head["bytes"]))
            assert index.blocks is not None
            index.blocks.check_all()
            return kept_tiles(index, head["tiles"])
    except InputError:
        return None  # what cannot be read costs no more than finding it again
