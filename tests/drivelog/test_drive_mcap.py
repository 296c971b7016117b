"""A drive as MCAP, read back by the reference libraries: mcap, its ROS 2 support, and rosbags."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import yaml
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader

from polemap.drivelog.drive import Drive
from polemap.drivelog.errors import InputError
from polemap.drivelog.frames import EarthFrame, geographic_from_grid
from polemap.drivelog.readers.bags.described import describe
from polemap.drivelog.readers.registry import open_drive
from polemap.drivelog.streams import SD_AT_DILUTION_ONE_M
from polemap.drivelog.writers.ros import messages as ros
from polemap.drivelog.writers.ros.drive import write_drive_mcap
from polemap.drivelog.writers.ros.mcap_file import mcap_file, nanoseconds
from polemap.stereo.rig import Mounting, rotation_from_angles
from tests.drivelog.drives import RIG, write_small


@pytest.fixture
def drive(tmp_path: Path) -> Drive:
    return open_drive(write_small(tmp_path / "drive"))


def decoded(path: Path) -> dict[str, list[Any]]:
    """Messages by topic, as (message record, content)."""
    found: dict[str, list[Any]] = {}
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        for _, channel, message, content in reader.iter_decoded_messages():
            found.setdefault(channel.topic, []).append((message, content))
    return found


def stamp_s(content: Any) -> float:
    return content.header.stamp.sec + content.header.stamp.nanosec / 1e9


def test_every_stream_comes_back_by_mcap(drive: Drive, tmp_path: Path) -> None:
    counts = write_drive_mcap(drive, tmp_path / "d.mcap")
    back = decoded(tmp_path / "d.mcap")
    assert {topic: len(rows) for topic, rows in back.items()} == counts
    odometry, gnss, reference = drive.odometry, drive.gnss, drive.reference
    assert odometry is not None
    assert gnss is not None
    assert reference is not None

    twists = back["/vehicle/twist"]
    assert [stamp_s(c) for _, c in twists] == pytest.approx(odometry.stamp_s, abs=1e-9)
    assert [m.log_time / 1e9 for m, _ in twists] == pytest.approx(odometry.arrival_s, abs=1e-6)
    assert [c.twist.linear.x for _, c in twists] == odometry.speed_mps.tolist()
    assert [c.twist.angular.z for _, c in twists] == odometry.yaw_rate_radps.tolist()

    fixes = [c for _, c in back["/gnss/fix"]]
    places = geographic_from_grid(drive.frame, np.stack([gnss.east_m, gnss.north_m], axis=1))
    assert [(c.latitude, c.longitude) for c in fixes] == [tuple(place) for place in places]
    sd = [np.sqrt(c.position_covariance[0]) for c in fixes]
    assert sd == pytest.approx(SD_AT_DILUTION_ONE_M * gnss.hdop)

    poses = [c for _, c in back["/reference"]]
    assert [c.pose.pose.position.x for c in poses] == reference.poses[:, 0].tolist()
    yaw = [2 * np.arctan2(c.pose.pose.orientation.z, c.pose.pose.orientation.w) for c in poses]
    assert yaw == pytest.approx(reference.poses[:, 2], abs=1e-12)
    assert poses[0].header.frame_id == "utm_32632"

    for row, (_, content) in enumerate(back["/stereo/right/image_rect/compressed"]):
        picture = cv2.imdecode(np.frombuffer(content.data, np.uint8), cv2.IMREAD_UNCHANGED)
        np.testing.assert_array_equal(picture, drive.read_frame(row).right)
    about = back["/stereo/right/camera_info"][0][1]
    assert -about.p[3] / about.p[0] == pytest.approx(RIG.baseline_m)
    assert (about.width, about.height, about.p[0]) == (RIG.width_px, RIG.height_px, RIG.focal_px)

    scans = back["/poles"]
    for (_, content), scan in zip(scans, drive.scans, strict=True):
        assert [(p.x_m, p.y_m) for p in content.poles] == [tuple(p) for p in scan.points_vehicle_m]


def test_log_times_rise_and_what_no_message_holds_is_attached(drive: Drive, tmp_path: Path) -> None:
    write_drive_mcap(drive, tmp_path / "d.mcap")
    with (tmp_path / "d.mcap").open("rb") as file:
        reader = make_reader(file)
        times = [m.log_time for _, _, m in reader.iter_messages(log_time_order=False)]
        attached = {a.name: a.data.decode() for a in reader.iter_attachments()}
    assert times == sorted(times)
    head = yaml.safe_load(attached["drive.yaml"])
    original = yaml.safe_load((tmp_path / "drive" / "drive.yaml").read_text())
    assert head == original
    assert ("laps.csv" in attached) == bool(drive.laps)


def test_rosbags_reads_every_message(drive: Drive, tmp_path: Path) -> None:
    counts = write_drive_mcap(drive, tmp_path / "d.mcap")
    seen: dict[str, int] = {}
    with AnyReader([tmp_path / "d.mcap"]) as reader:
        for connection, _, raw in reader.messages():
            reader.deserialize(raw, connection.msgtype)
            seen[connection.topic] = seen.get(connection.topic, 0) + 1
    assert seen == counts


def test_fixes_of_a_local_frame_are_positions(tmp_path: Path) -> None:
    local = open_drive(write_small(tmp_path / "l", frame=EarthFrame("local", name="yard")))
    write_drive_mcap(local, tmp_path / "l.mcap")
    back = decoded(tmp_path / "l.mcap")
    assert "/gnss/fix" not in back
    assert local.gnss is not None
    east = [c.pose.pose.position.x for _, c in back["/gnss/position"]]
    assert east == local.gnss.east_m.tolist()


def test_times_that_mcap_has_no_number_for(drive: Drive, tmp_path: Path) -> None:
    early = drive.between(0.0, 100.35)
    assert early.odometry is not None
    shifted = early.odometry.with_columns(
        stamp_s=early.odometry.stamp_s - 200.0, arrival_s=early.odometry.arrival_s - 200.0
    )
    with pytest.raises(InputError, match="counts nanoseconds from zero"):
        write_drive_mcap(replace(early, odometry=shifted), tmp_path / "d.mcap")
    assert not (tmp_path / "d.mcap").exists()
    with pytest.raises(InputError, match="beyond ROS's clock"):
        ros.time_of(2.0**31)
    # epoch times keep every bit that a double has
    assert nanoseconds(1700000000.1234567, "t") == 1700000000_123456717


@pytest.mark.parametrize("angles", [(0.1, -0.2, 0.3), (3.1, 0.0, 0.0), (1.0, 1.5, -3.0)])
def test_quaternions_turn_as_their_matrices(angles: tuple[float, float, float]) -> None:
    turn = rotation_from_angles(*angles)
    for matrix in (turn, Mounting(roll_rad=angles[0], yaw_rad=angles[2]).rotation()):
        x, y, z, w = ros.quaternion(matrix)
        back = np.array(
            [
                [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
                [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
                [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
            ]
        )
        np.testing.assert_allclose(back, matrix, atol=1e-12)


@pytest.mark.parametrize("frame", [EarthFrame("utm", 32632), EarthFrame("local", name="yard")])
def test_a_drive_comes_back_as_the_drive_that_it_was(frame: EarthFrame, tmp_path: Path) -> None:
    old = open_drive(write_small(tmp_path / "drive", frame=frame))
    write_drive_mcap(old, tmp_path / "d.mcap")
    new = open_drive(tmp_path / "d.mcap")
    for name in ("name", "frame", "wheelbase_m", "rig", "laps", "notes", "car"):
        assert getattr(new, name) == getattr(old, name), name
    np.testing.assert_array_equal(new.gnss_antenna_m, old.gnss_antenna_m)
    for stream in ("odometry", "gnss", "reference"):
        was, now = getattr(old, stream), getattr(new, stream)
        for column in type(was).__dataclass_fields__:
            np.testing.assert_allclose(getattr(now, column), getattr(was, column), atol=2e-9)
    assert new.frame_stamps_s == pytest.approx(old.frame_stamps_s, abs=1e-9)
    for row in range(len(old.frame_stamps_s)):
        np.testing.assert_array_equal(new.read_frame(row).left, old.read_frame(row).left)
    assert len(new.scans) == len(old.scans)
    for was, now in zip(old.scans, new.scans, strict=True):
        np.testing.assert_array_equal(now.points_vehicle_m, was.points_vehicle_m)
        np.testing.assert_array_equal(now.covariance_m2, was.covariance_m2)
        assert now.view is not None
        assert was.view is not None
        assert now.view.free_range_m == pytest.approx(was.view.free_range_m)


def test_a_damaged_description_is_told_with_its_recording(drive: Drive, tmp_path: Path) -> None:
    with mcap_file(tmp_path / "d.mcap") as file:
        file.attach("drive.yaml", "application/yaml", b"format_version: 1\nname: x\n")
        file.write("/tf_static", ros.transforms([]), 1.0)
    with pytest.raises(InputError, match=r"d\.mcap: attached drive\.yaml"):
        open_drive(tmp_path / "d.mcap")
    with pytest.raises(InputError, match=r"has no drive\.yaml attached"):
        describe({}, "d.mcap")
