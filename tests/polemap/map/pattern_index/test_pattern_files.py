from __future__ import annotations

import json
import os
import shutil
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from polemap.drivelog.errors import InputError, OutputError
from polemap.map.io import read_map, write_map
from polemap.map.pattern_index.index import PatternIndex
from polemap.map.pattern_index.io import index_file, open_index, read_index, write_index
from tests.pole_maps import plain_map

ARRAYS = tuple(name for name in PatternIndex.__slots__ if name != "frame")
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
    """Write an index again with another head."""
    data = path.read_bytes()
    begin = len(b"polemap patterns\n")
    (size,) = struct.unpack_from("<Q", data, begin)
    head = json.loads(data[begin + 8 : begin + 8 + size])
    change(head)
    text = json.dumps(head).encode()
    path.write_bytes(data[:begin] + struct.pack("<Q", len(text)) + text + data[begin + 8 + size :])


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
