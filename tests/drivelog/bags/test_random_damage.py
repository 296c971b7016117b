"""Recordings with flipped bits, zeros and cut ends: read as far as they go, or one line."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.random import Generator

from polemap.drivelog.readers.registry import open_drive
from polemap.errors import PolemapError
from tests.drivelog.bags.recordings import (
    Ros,
    ros_messages,
    write_mcap,
    write_rosbag1,
    write_rosbag2,
)
from tests.drivelog.drives import write_small

FORMS = (
    "rosbag1", "rosbag1-BZ2", "rosbag1-LZ4", "SQLITE3", "SQLITE3-FILE", "SQLITE3-MESSAGE",
    "mcap-NONE", "mcap-ZSTD",
)  # fmt: skip


@pytest.fixture(scope="module")
def recordings(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("recordings")
    ros = Ros()
    said = ros_messages(open_drive(write_small(place / "drive")), ros)
    for form in FORMS:
        kind, _, compression = form.partition("-")
        if kind == "rosbag1":
            write_rosbag1(place / f"{form}.bag", said, ros, compression or None)
        elif kind == "mcap":
            write_mcap(place / f"{form}.mcap", said, ros, compression, chunk_size=16_000)
        else:
            write_rosbag2(place / form, said, ros, kind, compression or "NONE")
    return place


def flipped(content: bytearray, rng: Generator) -> bytearray:
    for _ in range(int(rng.integers(1, 12))):
        content[rng.integers(len(content))] ^= 1 << int(rng.integers(8))
    return content


def zeroed(content: bytearray, rng: Generator) -> bytearray:
    start = int(rng.integers(len(content)))
    count = min(int(rng.integers(1, 5000)), len(content) - start)
    content[start : start + count] = bytes(count)
    return content


def cut(content: bytearray, rng: Generator) -> bytearray:
    return content[: rng.integers(len(content))]


def read(path: Path) -> tuple[int, str | None]:
    """How many samples could be read, and what was said where none could."""
    try:
        return len(list(open_drive(path).samples())), None
    except PolemapError as error:
        return 0, str(error)


@pytest.mark.parametrize("damage", [flipped, zeroed, cut])
@pytest.mark.parametrize("form", FORMS)
def test_damage_anywhere_costs_rows_or_is_one_line(
    form: str,
    damage: Callable[[bytearray, Generator], bytearray],
    recordings: Path,
    tmp_path: Path,
) -> None:
    made = next(recordings.glob(f"{form}.*"), recordings / form)
    whole = len(list(open_drive(made).samples()))
    for seed in range(5):
        path = tmp_path / str(seed) / made.name
        path.parent.mkdir()
        if made.is_dir():
            shutil.copytree(made, path)
            file = max(path.iterdir(), key=lambda one: one.stat().st_size)
        else:
            file = Path(shutil.copy(made, path))
        file.write_bytes(damage(bytearray(file.read_bytes()), np.random.default_rng(seed)))
        count, refusal = read(path)
        assert count <= whole, seed
        assert refusal is None or (made.name in refusal and "\n" not in refusal), (seed, refusal)
