"""Recordings that are cut off, damaged, incomplete or none: one line, or what they still hold."""

from __future__ import annotations

import shutil
import sqlite3
import struct
import sys
import tracemalloc
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
from rosbags.typesys import Stores

from polemap.drivelog.drive import Drive
from polemap.drivelog.errors import InputError
from polemap.drivelog.readers.bags import decoding, reader
from polemap.drivelog.readers.bags.container import LARGEST_CHUNK, decompress
from polemap.drivelog.readers.bags.described import attached_files
from polemap.drivelog.readers.registry import open_drive
from polemap.extras import MissingExtraError
from tests.drivelog.bags.recordings import (
    Ros,
    ros_messages,
    write_mcap,
    write_rosbag1,
    write_rosbag2,
)
from tests.drivelog.drives import write_small

Write = Callable[[Path], Path]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Drive:
    return open_drive(write_small(tmp_path_factory.mktemp("small") / "drive"))


@pytest.fixture(scope="module")
def logs(folder: Drive, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One recording of every kind, to be copied and damaged."""
    place = tmp_path_factory.mktemp("logs")
    ros, one = Ros(), Ros(Stores.ROS1_NOETIC)
    said, said_one = ros_messages(folder, ros), ros_messages(folder, one)
    write_rosbag1(place / "plain.bag", said_one, one)
    write_rosbag1(place / "lz4.bag", said_one, one, "LZ4")
    write_rosbag1(place / "bz2.bag", said_one, one, "BZ2")
    write_mcap(place / "zstd.mcap", said, ros, "ZSTD", chunk_size=4000)
    write_mcap(place / "plain.mcap", said, ros, "NONE", chunk_size=4000)
    write_rosbag2(place / "two", said, ros, "SQLITE3")
    return place


def stamps(drive: Drive) -> int:
    return sum(len(s) for s in (drive.odometry, drive.gnss, drive.reference) if s is not None)


@pytest.mark.parametrize("name", ["plain.bag", "zstd.mcap", "plain.mcap"])
@pytest.mark.parametrize("share", [0.4, 0.7])
def test_a_recording_that_was_cut_off_is_read_as_far_as_it_goes(
    name: str, share: float, logs: Path, tmp_path: Path
) -> None:
    path = tmp_path / name
    whole = (logs / name).read_bytes()
    path.write_bytes(whole[: int(share * len(whole))])
    drive = open_drive(path)
    assert 0 < stamps(drive) < stamps(open_drive(logs / name))
    assert [finding.kind for finding in drive.findings] == ["log_damaged"]
    assert "cut off" in drive.findings[0].value


def test_a_bag_without_its_index_is_read_whole(logs: Path, tmp_path: Path) -> None:
    path = tmp_path / "active.bag"
    whole = (logs / "lz4.bag").read_bytes()
    (index,) = struct.unpack_from("<Q", whole, whole.index(b"index_pos=") + 10)
    path.write_bytes(whole[:index].replace(struct.pack("<Q", index), bytes(8), 1))
    drive = open_drive(path)
    assert stamps(drive) == stamps(open_drive(logs / "lz4.bag"))
    assert not drive.findings


def test_a_damaged_chunk_is_left_out(logs: Path, tmp_path: Path) -> None:
    for name in ("bz2.bag", "zstd.mcap"):
        data = bytearray((logs / name).read_bytes())
        # the middle of the file is the middle of a chunk of noise
        data[len(data) // 2 : len(data) // 2 + 40] = bytes(40)
        (tmp_path / name).write_bytes(data)
        drive = open_drive(tmp_path / name)
        assert "left out" in drive.findings[0].value
        assert drive.findings[0].kind == "log_damaged"


@pytest.mark.parametrize("kind", ["odometry", "picture"])
def test_a_bit_that_flipped_in_a_plain_chunk_costs_the_chunk(
    kind: str, folder: Drive, tmp_path: Path
) -> None:
    """Without compression nothing but the checksum of the chunk tells it."""
    ros = Ros()
    path = write_mcap(
        tmp_path / "log.mcap", ros_messages(folder, ros), ros, "NONE", chunk_size=4000
    )
    whole = open_drive(path)
    data = bytearray(path.read_bytes())
    assert folder.odometry is not None
    wanted = {
        "odometry": struct.pack("<d", float(folder.odometry.speed_mps[3])),
        "picture": folder.read_frame(1).left[5:7].tobytes(),
    }[kind]
    data[data.index(wanted)] ^= 0x10
    path.write_bytes(data)
    reader.forget()
    drive = open_drive(path)
    (finding,) = (f for f in drive.findings if f.kind == "log_damaged")
    assert "checksum is wrong" in finding.value
    assert stamps(drive) + len(drive.frame_stamps_s) < stamps(whole) + len(whole.frame_stamps_s)


@pytest.mark.parametrize("summary", [True, False])
def test_channels_that_a_damaged_chunk_announced_are_told_once(
    summary: bool, folder: Drive, tmp_path: Path
) -> None:
    """The end of the file repeats them; without it their messages are lost, a line a channel."""
    ros = Ros()
    options = {} if summary else {"repeat_channels": False, "repeat_schemas": False}
    path = write_mcap(
        tmp_path / "log.mcap", ros_messages(folder, ros), ros, "NONE", chunk_size=4000, **options
    )
    whole = open_drive(path)
    data = bytearray(path.read_bytes())
    data[data.index(b"geometry_msgs")] ^= 0x01  # in the first chunk, where schemas stand
    path.write_bytes(data)
    reader.forget()
    drive = open_drive(path)
    said = [finding.value for finding in drive.findings if finding.kind == "log_damaged"]
    assert "checksum is wrong" in said[0]
    if summary:
        assert len(said) == 1
        assert 0.5 * stamps(whole) < stamps(drive) < stamps(whole)
    else:
        assert 1 < len(said) < 12
        assert all("what announced it is lost" in one for one in said[1:])


def test_an_sqlite_file_with_a_broken_end_is_read_up_to_there(logs: Path, tmp_path: Path) -> None:
    shutil.copytree(logs / "two", tmp_path / "two")
    path = tmp_path / "two" / "two.db3"
    data = bytearray(path.read_bytes())
    data[len(data) * 3 // 5 :] = bytes(len(data) - len(data) * 3 // 5)
    path.write_bytes(data)
    drive = open_drive(tmp_path / "two")
    assert 0 < stamps(drive) < stamps(open_drive(logs / "two"))
    assert "read up to message" in drive.findings[0].value


def refused(path: Path, reason: str) -> None:
    with pytest.raises(InputError, match=reason) as caught:
        open_drive(path)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("name", "content", "reason"),
    [
        ("a.mcap", b"", "is empty"),
        ("a.bag", b"nothing of the kind", "neither a ROS bag nor an MCAP file"),
        ("a.bag", b"#ROSBAG V1.2\n" + bytes(50), "version 1.2.*rosbag fix"),
        ("a.db3", b"SQLite format 3\0" + bytes(200), "damaged, or no rosbag2 database"),
        ("a.mcap", b"\x89MCAP0\r\n\x03" + struct.pack("<Q", 6) + b"\xff" * 6, "mcap recover"),
    ],
)
def test_what_is_no_recording_is_told(
    name: str, content: bytes, reason: str, tmp_path: Path
) -> None:
    (tmp_path / name).write_bytes(content)
    refused(tmp_path / name, reason)


def test_a_database_of_something_else_is_no_bag(tmp_path: Path) -> None:
    with closing(sqlite3.connect(tmp_path / "a.db3")) as database:
        database.execute("CREATE TABLE birds (name TEXT)")
        database.commit()
    refused(tmp_path / "a.db3", "without topics and messages")


def test_an_encrypted_bag_is_refused(logs: Path, tmp_path: Path) -> None:
    whole = (logs / "plain.bag").read_bytes()
    (length,) = struct.unpack_from("<I", whole, 13)
    field = b"encryptor=rosbag/AesCbcEncryptor"
    header = whole[17 : 17 + length] + struct.pack("<I", len(field)) + field
    path = tmp_path / "secret.bag"
    path.write_bytes(whole[:13] + struct.pack("<I", len(header)) + header + whole[17 + length :])
    refused(path, "encrypted with rosbag/AesCbcEncryptor.*rosbag decrypt")


@pytest.mark.parametrize(
    ("old", "new", "reason"),
    [
        ("two.db3", "gone.db3", "names 1 files that are not there .gone.db3."),
        ("relative_file_paths", "paths", "relative_file_paths.*ros2 bag reindex"),
        ("compression_mode: ''", "compression_mode: FILE", "compression_format is ''"),
        ("version: 9", "version: [", "metadata.yaml: not YAML"),
    ],
)
def test_wrong_metadata_is_told(
    old: str, new: str, reason: str, logs: Path, tmp_path: Path
) -> None:
    shutil.copytree(logs / "two", tmp_path / "two")
    place = tmp_path / "two" / "metadata.yaml"
    text = place.read_text()
    assert old in text, text
    place.write_text(text.replace(old, new))
    refused(tmp_path / "two", reason)


def test_metadata_that_names_no_files_is_told(tmp_path: Path) -> None:
    (tmp_path / "metadata.yaml").write_text(
        "rosbag2_bagfile_information: {relative_file_paths: []}\n"
    )
    refused(tmp_path, "names no files")


def test_files_of_a_killed_recorder_are_read_without_metadata(logs: Path, tmp_path: Path) -> None:
    shutil.copytree(logs / "two", tmp_path / "two")
    (tmp_path / "two" / "metadata.yaml").unlink()
    assert stamps(open_drive(tmp_path / "two")) == stamps(open_drive(logs / "two"))


def test_the_parts_of_a_split_recording_are_one_drive(folder: Drive, tmp_path: Path) -> None:
    """In the order of their numbers: part 10 after part 9."""
    ros = Ros()
    said = ros_messages(folder, ros)
    step = len(said) // 11 + 1
    for part in range(11):
        rows = said[part * step : (part + 1) * step]
        write_mcap(tmp_path / f"log_{part}.mcap", rows, ros)
    drive = open_drive(tmp_path)
    assert stamps(drive) == stamps(folder)
    np.testing.assert_array_equal(drive.read_frame(1).left, folder.read_frame(1).left)
    assert not drive.findings


def test_a_log_that_changes_under_the_drive_is_told(logs: Path, tmp_path: Path) -> None:
    for name in ("plain.bag", "two"):
        path = tmp_path / name
        (shutil.copytree if name == "two" else shutil.copy)(logs / name, path)
        drive = open_drive(path)
        if name == "two":
            with closing(sqlite3.connect(path / "two.db3")) as database:
                database.execute("DELETE FROM messages")
                database.commit()
        else:
            path.write_bytes(path.read_bytes()[:5000])
        with pytest.raises(InputError, match="changed while it was read"):
            drive.read_frame(2)


@pytest.mark.parametrize(
    ("compression", "size", "reason"),
    [
        ("lz4", 10, "damaged lz4"),
        ("zstd", 10, "damaged zstd"),
        ("bz2", 10, "damaged bz2"),
        ("none", 10, "damaged none chunk .8 bytes."),
        ("snappy", 10, "'snappy' is unknown"),
        ("zstd", LARGEST_CHUNK + 1, "more than can be held"),
    ],
)
def test_a_chunk_that_is_none_is_told(compression: str, size: int, reason: str) -> None:
    with pytest.raises(InputError, match=reason):
        decompress(b"no chunk", compression, size, "chunk at byte 7")


@pytest.mark.parametrize(
    ("name", "module"),
    [
        ("plain.bag", "rosbags"),
        ("lz4.bag", "lz4"),
        ("zstd.mcap", "zstandard"),
        ("plain.mcap", "mcap"),
        ("plain.mcap", "rosbags"),
        ("two", "rosbags"),
    ],
)
def test_a_package_that_is_missing_is_named(
    name: str, module: str, logs: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    reader.forget()
    decoding._decoder_of.cache_clear()
    for loaded in list(sys.modules):
        if loaded == module or loaded.startswith(f"{module}."):
            monkeypatch.delitem(sys.modules, loaded)
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(MissingExtraError, match=rf"needs {module}.*pip install 'polemap.bags.'"):
        open_drive(logs / name)
    reader.forget()
    decoding._decoder_of.cache_clear()


@pytest.mark.parametrize("left", [0, 3, 7, 11])
def test_a_recording_that_ends_in_the_head_of_a_chunk_is_read_as_far_as_it_goes(
    left: int, logs: Path, tmp_path: Path
) -> None:
    whole = (logs / "plain.mcap").read_bytes()
    at, chunks = 8, []
    while at + 9 < len(whole) - 8:
        code, length = struct.unpack_from("<BQ", whole, at)
        if code == 6:
            chunks.append(at)
        at += 9 + length
    # the third chunk says that it ends with times, size and checksum, and a part of the rest
    path = tmp_path / "cut.mcap"
    start = chunks[2] + 9
    short = struct.pack("<BQ", 6, 32 + left) + whole[start : start + 32 + left]
    path.write_bytes(whole[: chunks[2]] + short)
    drive = open_drive(path)
    assert 0 < stamps(drive) < stamps(open_drive(logs / "plain.mcap"))
    assert "log_damaged" in [finding.kind for finding in drive.findings]


def test_a_record_that_is_shorter_than_its_kind_describes_no_drive(tmp_path: Path) -> None:
    magic = b"\x89MCAP0\r\n"
    header = struct.pack("<BQII", 0x01, 8, 0, 0)
    short_index = struct.pack("<BQI", 0x0A, 4, 0)  # of an attachment, without its places
    footer = struct.pack("<BQQQI", 0x02, 20, len(magic + header), 0, 0)
    file = tmp_path / "short.mcap"
    file.write_bytes(magic + header + short_index + footer + magic)
    assert attached_files(file) == {}


@pytest.mark.parametrize("length", [1 << 31, 1 << 40, (1 << 63) - 1, (1 << 64) - 1])
def test_a_length_beyond_the_file_asks_for_no_memory(length: int, tmp_path: Path) -> None:
    magic = b"\x89MCAP0\r\n"
    header = struct.pack("<BQII", 0x01, 8, 0, 0)
    claimed = struct.pack("<BQ", 0x0A, length)  # an index that says it goes on and on
    footer = struct.pack("<BQQQI", 0x02, 20, len(magic + header), 0, 0)
    file = tmp_path / "long.mcap"
    file.write_bytes(magic + header + claimed + footer + magic)
    tracemalloc.start()
    assert attached_files(file) == {}
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 1 << 24
