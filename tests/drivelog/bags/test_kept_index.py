"""The index of a large recording is kept: the same drive without a second pass."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from polemap.drivelog.drive import Drive
from polemap.drivelog.readers.bags import kept_index, reader
from polemap.drivelog.readers.registry import open_drive
from tests.drivelog.bags.recordings import Ros, ros_messages, write_mcap, write_rosbag2
from tests.drivelog.drives import write_small


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setattr(kept_index, "KEPT_FROM_BYTES", 0)
    reader.forget()
    return tmp_path / "cache" / "polemap" / "recordings"


@pytest.fixture(params=["mcap", "sqlite3"])
def recording(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    return written(tmp_path / "log.mcap", request.param)


def written(path: Path, kind: str = "mcap") -> Path:
    drive = open_drive(write_small(path.parent / f"{path.name}-drive"))
    said = ros_messages(replace(drive, scans=(), laps=()), ros := Ros())
    if kind == "mcap":
        return write_mcap(path, said, ros)
    return write_rosbag2(path, said, ros, "SQLITE3")


def no_walk(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_arguments: object) -> None:
        raise AssertionError("walked again")

    monkeypatch.setattr(reader, "build_index", refuse)


def anew(path: Path) -> Drive:
    reader.forget()
    return open_drive(path)


def test_the_same_drive_without_a_second_pass(
    recording: Path, cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    first = anew(recording)
    assert len(list(cache.iterdir())) == 1
    no_walk(monkeypatch)
    again = anew(recording)
    assert first.odometry is not None
    assert again.odometry is not None
    assert first.gnss is not None
    assert again.gnss is not None
    assert first.reference is not None
    assert again.reference is not None
    assert np.array_equal(first.odometry.speed_mps, again.odometry.speed_mps)
    assert np.array_equal(first.gnss.east_m, again.gnss.east_m)
    assert np.array_equal(first.reference.poses, again.reference.poses)
    assert first.rig == again.rig
    assert first.notes == again.notes
    assert first.problems == again.problems
    a, b = first.read_frame(0), again.read_frame(0)
    assert np.array_equal(a.left, b.left)
    assert np.array_equal(a.right, b.right)


def test_a_changed_recording_is_walked_anew(recording: Path, cache: Path) -> None:
    anew(recording)
    file = recording if recording.is_file() else next(recording.glob("*.db3"))
    os.utime(file, (1.0, 1.0))
    anew(recording)
    assert len(list(cache.iterdir())) == 2


@pytest.mark.parametrize("damage", ["cut", "zeros", "empty", "head"])
def test_a_damaged_index_is_as_none(damage: str, tmp_path: Path, cache: Path) -> None:
    place = written(tmp_path / "log.mcap")
    first = anew(place)
    (kept,) = cache.iterdir()
    data = kept.read_bytes()
    if damage == "head":
        with np.load(kept) as arrays:
            parts = {name: arrays[name] for name in arrays.files if name != "head"}
        np.savez(kept, head=np.array('{"topics": [{}], "pairs": 3}'), **parts)
    else:
        kept.write_bytes(
            {"cut": data[: len(data) // 2], "zeros": bytes(len(data))}.get(damage, b"")
        )
    again = anew(place)
    assert first.duration_s == again.duration_s
    assert kept.read_bytes()[:1] == data[:1]
    assert kept.stat().st_size == len(data)


def test_a_place_that_cannot_be_written_costs_nothing_but_time(tmp_path: Path, cache: Path) -> None:
    place = written(tmp_path / "log.mcap")
    cache.parent.parent.write_text("a file where the folder should be")
    assert anew(place).has_frames


def test_the_oldest_indexes_go(
    tmp_path: Path, cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(kept_index, "MOST_KEPT", 2)
    place = written(tmp_path / "log.mcap")
    for second in range(4):
        os.utime(place, (second, second))
        anew(place)
    assert len(list(cache.iterdir())) == 2


def test_small_recordings_and_those_that_go_on_are_not_kept(
    tmp_path: Path, cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    place = written(tmp_path / "log.mcap")
    (tmp_path / "log.mcap-wal").touch()
    anew(place)
    (tmp_path / "log.mcap-wal").unlink()
    monkeypatch.setattr(kept_index, "KEPT_FROM_BYTES", 1 << 28)
    anew(place)
    assert not cache.exists()


def test_without_a_home_nothing_is_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", "relative")
    monkeypatch.setattr(Path, "home", lambda: (_ for _ in ()).throw(RuntimeError("no home")))
    assert kept_index.cache_folder() is None
