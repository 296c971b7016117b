"""Recordings written by the reference libraries are the drives that they were written from."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rosbags.typesys import Stores

from polemap.drivelog.drive import Drive
from polemap.drivelog.readers.registry import open_drive
from tests.drivelog.bags.foxglove_recordings import foxglove_messages, write_foxglove
from tests.drivelog.bags.recordings import (
    Ros,
    ros_messages,
    write_mcap,
    write_rosbag1,
    write_rosbag2,
)
from tests.drivelog.drives import write_small


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Drive:
    """A small drive with pictures, odometry, fixes and reference, each later than measured."""
    drive = open_drive(write_small(tmp_path_factory.mktemp("small") / "drive"))
    return replace(drive, scans=(), laps=())


def rosbag1(compression: str | None = None) -> Callable[[Path, Drive], Path]:
    def write(path: Path, drive: Drive) -> Path:
        ros = Ros(Stores.ROS1_NOETIC)
        return write_rosbag1(path / "drive.bag", ros_messages(drive, ros), ros, compression)

    return write


def rosbag2(storage: str, compression: str = "NONE") -> Callable[[Path, Drive], Path]:
    def write(path: Path, drive: Drive) -> Path:
        ros = Ros()
        return write_rosbag2(path / "drive", ros_messages(drive, ros), ros, storage, compression)

    return write


def bare(compression: str, **options: bool) -> Callable[[Path, Drive], Path]:
    def write(path: Path, drive: Drive) -> Path:
        ros = Ros()
        said = ros_messages(drive, ros, png=True)
        return write_mcap(path / "drive.mcap", said, ros, compression, **options)

    return write


WRITERS = {
    "rosbag1": rosbag1(),
    "rosbag1 bz2": rosbag1("BZ2"),
    "rosbag1 lz4": rosbag1("LZ4"),
    "rosbag2 sqlite3": rosbag2("SQLITE3"),
    "rosbag2 sqlite3, messages": rosbag2("SQLITE3", "MESSAGE"),
    "rosbag2 sqlite3, file": rosbag2("SQLITE3", "FILE"),
    "rosbag2 mcap": rosbag2("MCAP"),
    "rosbag2 mcap, chunks": rosbag2("MCAP", "STORAGE"),
    "rosbag2 mcap, messages": rosbag2("MCAP", "MESSAGE"),
    "rosbag2 mcap, file": rosbag2("MCAP", "FILE"),
    "mcap zstd": bare("ZSTD"),
    "mcap lz4": bare("LZ4"),
    "mcap plain": bare("NONE"),
    "mcap without chunks": bare("NONE", use_chunking=False),
    "mcap without summary": bare("ZSTD", use_summary_offsets=False, use_statistics=False),
}


@pytest.mark.parametrize("kind", WRITERS)
def test_a_recording_is_the_drive_that_it_was_made_from(
    kind: str, folder: Drive, tmp_path: Path
) -> None:
    drive = open_drive(WRITERS[kind](tmp_path, folder))
    assert_same(drive, folder)
    assert not drive.problems
    assert not drive.findings


@pytest.mark.parametrize("encoding", ["protobuf", "json"])
def test_foxglove_messages_are_the_drive_that_they_were_made_from(
    encoding: str, folder: Drive, tmp_path: Path
) -> None:
    path = write_foxglove(tmp_path / "drive.mcap", foxglove_messages(folder), encoding)
    drive = open_drive(path)
    assert_same(drive, replace(folder, odometry=None, gnss_antenna_m=np.zeros(2)))
    assert not drive.problems


def assert_same(drive: Drive, folder: Drive) -> None:
    """Equal streams to a nanometre and pictures to the bit."""
    assert str(drive.frame) == str(folder.frame)
    assert drive.rig is not None
    assert folder.rig is not None
    for name in ("width_px", "height_px", "focal_px", "cx_px", "cy_px", "baseline_m"):
        assert getattr(drive.rig, name) == pytest.approx(getattr(folder.rig, name), abs=1e-12)
    a, b = drive.rig.vehicle_from_camera, folder.rig.vehicle_from_camera
    for name in ("x_m", "y_m", "z_m", "roll_rad", "pitch_rad", "yaw_rad"):
        assert getattr(a, name) == pytest.approx(getattr(b, name), abs=1e-12)
    np.testing.assert_allclose(drive.gnss_antenna_m, folder.gnss_antenna_m, atol=1e-12)
    np.testing.assert_array_equal(drive.frame_stamps_s, np.round(folder.frame_stamps_s, 9))
    np.testing.assert_array_equal(drive.frame_arrivals_s, np.round(folder.frame_arrivals_s, 9))
    for stream in ("odometry", "gnss", "reference"):
        ours, theirs = getattr(drive, stream), getattr(folder, stream)
        assert (ours is None) == (theirs is None), stream
        if ours is None or stream == "reference":
            continue
        for name, values in ours.arrays().items():
            np.testing.assert_allclose(values, getattr(theirs, name), atol=1e-9, rtol=0)
    assert drive.reference is not None
    assert folder.reference is not None
    np.testing.assert_array_equal(drive.reference.stamp_s, np.round(folder.reference.stamp_s, 9))
    np.testing.assert_allclose(drive.reference.poses, folder.reference.poses, atol=1e-9, rtol=0)
    for row in range(len(folder.frame_stamps_s)):
        ours, theirs = drive.read_frame(row), folder.read_frame(row)
        np.testing.assert_array_equal(ours.left, theirs.left)
        np.testing.assert_array_equal(ours.right, theirs.right)
