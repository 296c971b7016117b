"""Bytes and times of a stream that is still being written."""

from __future__ import annotations

import threading
import time
from pathlib import Path
from threading import Event

import pytest

from polemap.drivelog.errors import InputError
from polemap.drivelog.live.arrival import StreamTime
from polemap.drivelog.live.growing import GrowingBytes


def test_bytes_are_waited_for(tmp_path: Path) -> None:
    place = tmp_path / "growing"
    place.write_bytes(b"abc")
    source = GrowingBytes(str(place), Event(), idle_s=5.0)

    def write() -> None:
        time.sleep(0.1)
        with place.open("ab") as file:
            file.write(b"defg")

    writer = threading.Thread(target=write)
    writer.start()
    assert source.peek(2) == b"ab"
    assert source.read(5) == b"abcde"
    writer.join()
    assert source.read(2) == b"fg"
    assert not source.cut
    source.close()


def test_a_stream_that_rests_or_is_stopped_ends(tmp_path: Path) -> None:
    place = tmp_path / "growing"
    place.write_bytes(b"abc")
    resting = GrowingBytes(str(place), Event(), idle_s=0.05)
    assert resting.read(8) == b"abc"
    assert resting.cut
    stop = Event()
    stop.set()
    assert GrowingBytes(str(place), stop).read(8) == b""


def test_a_file_that_is_written_over_is_told(tmp_path: Path) -> None:
    place = tmp_path / "growing"
    place.write_bytes(b"abcdef")
    source = GrowingBytes(str(place), Event(), idle_s=1.0)
    assert source.read(6) == b"abcdef"
    place.write_bytes(b"a")
    with pytest.raises(InputError, match="has become shorter"):
        source.read(1)
    with pytest.raises(InputError, match="cannot be followed"):
        GrowingBytes(str(tmp_path / "missing"), Event())


def test_a_file_whose_place_another_takes_is_told(tmp_path: Path) -> None:
    place, other = tmp_path / "growing", tmp_path / "other"
    place.write_bytes(b"abcdef")
    other.write_bytes(b"ghijklmn")
    source = GrowingBytes(str(place), Event(), idle_s=0.1)
    assert source.read(6) == b"abcdef"
    other.replace(place)
    with pytest.raises(InputError, match="another file has taken its place after 6 bytes"):
        source.read(1)
    # one that is moved away may still grow
    source = GrowingBytes(str(place), Event(), idle_s=0.1)
    with place.open("ab") as writer:
        place.rename(other)
        writer.write(b"op")
    assert source.read(11) == b"ghijklmnop"


def test_lines_come_whole_or_in_pieces_of_the_limit(tmp_path: Path) -> None:
    place = tmp_path / "lines"
    place.write_bytes(b"one\n" + b"x" * 25 + b"\nlast")
    source = GrowingBytes(str(place), Event(), idle_s=0.05)
    lines = [source.readline(10) for _ in range(5)]
    assert lines == [b"one\n", b"x" * 10, b"x" * 10, b"xxxxx\n", b"last"]
    assert source.readline(10) == b""


def test_the_least_delayed_sample_sets_the_clock() -> None:
    now = [100.0]
    clock = StreamTime(lambda: now[0])
    assert clock.now_s() is None
    clock.note(5.0)
    now[0] += 1.0
    clock.note(5.5)  # half a second under way
    assert clock.now_s() == pytest.approx(6.0)
    now[0] += 1.0
    clock.note(7.4)  # less delayed than all before
    assert clock.now_s() == pytest.approx(7.4)


def test_one_wild_stamp_moves_no_clock_and_a_step_does() -> None:
    now = [100.0]
    clock = StreamTime(lambda: now[0])
    clock.note(5.0)
    clock.note(1e9)
    clock.note(5.2)
    assert clock.began_s == 5.0
    clock.note(5.0)
    assert clock.now_s() == pytest.approx(5.2)
    for _ in range(4):
        clock.note(2000.0)
    assert clock.now_s() == pytest.approx(5.2)
    clock.note(2000.1)  # the fifth that agrees: the recorder's clock was set
    assert clock.now_s() == pytest.approx(2000.1)
    assert clock.began_s == pytest.approx(2000.1)
