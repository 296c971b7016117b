from __future__ import annotations

import json
import os
import shutil
import struct
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from polemap.drivelog.errors import InputError, OutputError
from polemap.map.io import read_map, write_map
from polemap.map.pattern_index.index import PatternIndex
from polemap.map.pattern_index.io import (
    _ARRAYS,
    _head,
    index_file,
    open_index,
    read_index,
    write_index,
)
from polemap.map.pattern_index.triples import BITS
from tests.pole_maps import plain_map

ARRAYS = tuple(name for name in PatternIndex.__slots__ if name not in ("frame", "blocks"))
POINTS = np.random.default_rng(3).uniform(0.0, 150.0, (80, 2))


@pytest.fixture
def indexed(tmp_path: Path) -> Path:
    """A map with its index beside it."""
    file = tmp_path / "town.geojson"
    write_map(plain_map(POINTS), file)
    write_index(read_map(file), file)
    return file


def reopened(file: Path) -> tuple[PatternIndex, list[str]]:
    said: list[str] = []
    return open_index(file, lambda: read_map(file), say=said.append), said


def test_what_is_read_is_what_was_built_and_is_not_loaded(indexed: Path) -> None:
    built = write_index(read_map(indexed), indexed)
    index = read_index(indexed)
    assert index is not None
    assert isinstance(index.pole, np.memmap)
    assert index.frame == built.frame
    for name in ARRAYS:
        np.testing.assert_array_equal(getattr(index, name), getattr(built, name))


def test_it_is_opened_again_without_a_word(indexed: Path) -> None:
    assert reopened(indexed)[1] == []


def test_a_map_that_was_only_copied_keeps_its_index(indexed: Path, tmp_path: Path) -> None:
    other = tmp_path / "elsewhere" / indexed.name
    other.parent.mkdir()
    shutil.copy(indexed, other)
    shutil.copy(index_file(indexed), index_file(other))
    os.utime(other, ns=(1, 1))
    assert read_index(other) is not None


def test_the_index_of_a_map_that_changed_is_built_anew(indexed: Path) -> None:
    write_map(plain_map(POINTS[:-1] + 0.1), indexed)
    assert read_index(indexed) is None
    index, said = reopened(indexed)
    assert len(index) == len(POINTS) - 1
    assert "is of another map" in said[0]
    assert reopened(indexed)[1] == []


def test_a_map_without_index_gets_one(tmp_path: Path) -> None:
    file = tmp_path / "town.geojson"
    write_map(plain_map(POINTS), file)
    assert read_index(file) is None
    assert "it has no index of patterns; it is built now" in reopened(file)[1][0]


@pytest.mark.parametrize("points", [np.empty((0, 2)), POINTS[:1]])
def test_maps_without_triangles_keep_an_index(points: np.ndarray, tmp_path: Path) -> None:
    file = tmp_path / "town.geojson"
    write_map(plain_map(points), file)
    write_index(plain_map(points), file)
    index = read_index(file)
    assert index is not None
    assert len(index) == len(points)


def patched(path: Path, change: Callable[[dict[str, Any]], None]) -> None:
    """Write an index again with another head, and the checksum that belongs to it."""
    data = path.read_bytes()
    begin = len(b"polemap patterns\n")
    (size,) = struct.unpack_from("<Q", data, begin)
    head = json.loads(data[begin + 8 : begin + 8 + size])
    change(head)
    text = json.dumps(head).encode()
    opening = data[:begin] + struct.pack("<Q", len(text)) + text
    rest = data[begin + 8 + size : -4]
    sums = rest[head["bytes"] :] if isinstance(head.get("bytes"), int) else b""
    path.write_bytes(opening + rest + struct.pack("<I", zlib.crc32(sums, zlib.crc32(opening))))


def cut(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-40])


def longer(path: Path) -> None:
    path.write_bytes(path.read_bytes() + b"more")


def head_cut(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:60])


def mark_alone(path: Path) -> None:
    path.write_bytes(b"polemap patterns\n")


def head_noise(path: Path) -> None:
    data = bytearray(path.read_bytes())
    data[30:60] = b"\xff" * 30
    path.write_bytes(data)


def head_poor(path: Path) -> None:
    patched(path, lambda head: head.pop("arrays"))


def head_odd(path: Path) -> None:
    patched(path, lambda head: head.update(arrays=[]))


def map_odd(path: Path) -> None:
    patched(path, lambda head: head.update(map=3))


def no_frame(path: Path) -> None:
    patched(path, lambda head: head.update(frame={"kind": "moon"}))


def beyond(path: Path) -> None:
    patched(path, lambda head: head["arrays"]["pole"].update(offset=10**9))


def negative(path: Path) -> None:
    patched(path, lambda head: head["arrays"]["pole"].update(shape=[-1]))


def shifted(path: Path) -> None:
    patched(path, lambda head: head["arrays"]["shape_first"].update(offset=0))


def shorter(path: Path) -> None:
    patched(path, lambda head: head["arrays"]["sd_m"].update(shape=[3]))


@pytest.mark.parametrize(
    "damage",
    [
        cut,
        longer,
        head_cut,
        mark_alone,
        head_noise,
        head_poor,
        head_odd,
        map_odd,
        no_frame,
        beyond,
        negative,
        shifted,
        shorter,
    ],
)
def test_a_damaged_index_is_one_line_and_is_built_anew(
    indexed: Path, damage: Callable[[Path], None]
) -> None:
    damage(index_file(indexed))
    with pytest.raises(InputError, match=r"town\.geojson\.patterns") as caught:
        read_index(indexed)
    assert "\n" not in str(caught.value)
    index, said = reopened(indexed)
    assert len(index) == len(POINTS)
    assert said[0].endswith("it is built now")
    assert reopened(indexed)[1] == []


def asked_everywhere(index: PatternIndex | None) -> None:
    """Use every number of an index."""
    assert index is not None
    index.within(np.full(2, 75.0), 200.0)
    every = np.zeros((1, 3), dtype=np.int64)
    index.hits(*index.ranges(every, every + 2**BITS - 1))
    _ = index.sd_typical_m, index.widths_m(len(index))


def test_any_flipped_bit_of_the_arrays_is_told_by_the_query_that_touches_it(indexed: Path) -> None:
    path = index_file(indexed)
    whole = path.read_bytes()
    head, begin = _head(path)
    asked_everywhere(reopened(indexed)[0])
    for name, dtype in _ARRAYS.items():
        array = head["arrays"][name]
        size = np.prod(array["shape"]) * np.dtype(dtype).itemsize
        for part in (0.0, 0.3, 0.99):
            data = bytearray(whole)
            data[begin + array["offset"] + int(part * size)] ^= 16
            path.write_bytes(data)
            with pytest.raises(InputError, match=r"town\.geojson\.patterns: .*delete it"):
                asked_everywhere(read_index(indexed))


def test_a_flipped_bit_of_head_or_checksums_is_told_at_opening(indexed: Path) -> None:
    path = index_file(indexed)
    whole = path.read_bytes()
    head, begin = _head(path)
    for at in (*range(20, begin, 41), begin + head["bytes"], len(whole) - 1):
        data = bytearray(whole)
        data[at] ^= 1
        path.write_bytes(data)
        said: list[str] = []
        open_index(indexed, lambda: read_map(indexed), say=said.append)
        assert len(said) == 1, at  # damaged, of another version, or of another map
        assert said[0].startswith(f"{path}: ")
        assert said[0].endswith("it is built now")


def test_of_a_damaged_index_no_tile_is_kept(indexed: Path) -> None:
    path = index_file(indexed)
    whole = path.read_bytes()
    head, begin = _head(path)
    data = bytearray(whole)
    data[begin + head["arrays"]["direction"]["offset"]] ^= 64
    path.write_bytes(data)
    write_index(read_map(indexed), indexed)
    assert path.read_bytes()[begin:-4] == whole[begin:-4]


def test_only_the_blocks_that_are_touched_are_checked(tmp_path: Path) -> None:
    file = tmp_path / "town.geojson"
    points = np.random.default_rng(4).uniform(0.0, 3000.0, (9000, 2))
    write_map(plain_map(points), file)
    index = write_index(read_map(file), file)
    path = index_file(file)
    head, begin = _head(path)
    data = bytearray(path.read_bytes())
    data[begin + head["arrays"]["points_m"]["offset"] + 6000 * 16 + 3] ^= 1
    path.write_bytes(data)
    opened = read_index(file)
    assert opened is not None
    near, far = index.points_m[0], index.points_m[6000]
    assert len(opened.within(near, 20.0))
    with pytest.raises(InputError, match="block 1 of"):
        opened.within(far, 20.0)


@pytest.mark.parametrize("write_over", [lambda path: path.write_bytes(b""), cut, longer])
def test_an_index_that_is_written_over_while_it_is_open_is_told(
    indexed: Path, write_over: Callable[[Path], None]
) -> None:
    index = read_index(indexed)
    assert index is not None
    write_over(index_file(indexed))
    with pytest.raises(InputError, match=r"\.patterns: it was written over while it was in use"):
        index.within(np.full(2, 75.0), 50.0)


@pytest.mark.parametrize("put", [os.unlink, lambda path: write_index(plain_map(POINTS), path)])
def test_an_index_that_is_replaced_or_deleted_stays_open(
    indexed: Path, put: Callable[[Path], None]
) -> None:
    index = read_index(indexed)
    assert index is not None
    put(index_file(indexed) if put is os.unlink else indexed)
    asked_everywhere(index)


def test_an_index_of_another_version_is_not_used(indexed: Path) -> None:
    patched(index_file(indexed), lambda head: head.update(version=0))
    assert read_index(indexed) is None
    assert "of another version" in reopened(indexed)[1][0]


def test_a_map_that_went_away_is_named(indexed: Path) -> None:
    indexed.unlink()
    with pytest.raises(InputError, match=r"town\.geojson: cannot be read"):
        read_index(indexed)


def test_what_is_no_index_is_left_alone(tmp_path: Path) -> None:
    file = tmp_path / "town.geojson"
    write_map(plain_map(POINTS), file)
    index_file(file).write_text("my patterns for knitting", encoding="utf-8")
    with pytest.raises(InputError, match="is no index of patterns"):
        read_index(file)
    with pytest.raises(OutputError, match="is no index of patterns and would be replaced"):
        write_index(plain_map(POINTS), file)
