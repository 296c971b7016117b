"""Mappings that say what topics are for, and units."""

from __future__ import annotations

import sqlite3
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
import yaml
from rosbags.typesys import get_types_from_msg

from polemap.drivelog.errors import InputError, Mistakes
from polemap.drivelog.readers.bags.mapping_file import read_mapping
from polemap.drivelog.readers.registry import open_drive
from tests.drivelog.bags.recordings import Ros, write_mcap, write_rosbag2
from tests.drivelog.bags.streams import (
    ROS,
    Log,
    Opened,
    imus,
    pair,
    poses,
    stream,
    twists,
    uses,
)


def test_all_mistakes_of_a_mapping_are_told_with_their_lines(log: Log, tmp_path: Path) -> None:
    path, told = log(twists(), pair()), tmp_path / "topics.yaml"
    told.write_text(
        "format_version: 1\n"
        "vehicle: {wheelbase_m: -2}\n"
        "camera:\n"
        "  left: {image: /a, infos: /b}\n"
        "  right: {image: /a}\n"
        "odometry:\n"
        "  speed: {topic: /c, unit: furlongs}\n"
        "  wheel_radius: 0.3\n"
        "gnss: {antenna: {x_m: 1, y_m: 0, up_m: 2}}\n"
    )
    with pytest.raises(Mistakes) as caught:
        open_drive(path, topics=told)
    text = "\n".join(caught.value.mistakes)
    for part in ("line 2: vehicle.wheelbase_m", "line 4: camera.left.infos: unknown key",
                 "line 7: odometry.speed: unit 'furlongs' is unknown",
                 "line 8: odometry.wheel_radius", "did you mean 'wheel_radius_m'",
                 "line 9: gnss.topic: is missing", "line 9: gnss.antenna.up_m"):  # fmt: skip
        assert part in text


def test_topics_that_do_not_fit_are_told_all_at_once(log: Log, tmp_path: Path) -> None:
    path, told = log(twists(), pair(), imus()), tmp_path / "topics.yaml"
    told.write_text(
        "camera:\n  left: {image: /stereo/left/image_rec}\n  right: {image: /imu/data}\n"
        "odometry: {speed: {topic: /imu/data}}\nreference: {topic: /wheel/twist}\n"
    )
    with pytest.raises(Mistakes) as caught:
        open_drive(path, topics=told)
    text = "\n".join(caught.value.mistakes)
    for part in ("line 2: camera.left.image: no topic '/stereo/left/image_rec' was recorded",
                 "did you mean '/stereo/left/image_rect'",
                 "line 3: camera.right.image: '/imu/data' is of type sensor_msgs/msg/Imu",
                 "line 4: odometry.speed.topic", "which gives no speed",
                 "line 5: reference.topic", "which gives no reference"):  # fmt: skip
        assert part in text


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("", "holds no keys"),
        ("a: [", "not YAML"),
        ("odometry: {speed: {topic: /a, unit: rad/s}}", "needs wheel_radius_m"),
        ("odometry: {speed: {topic: /a, scale: 0}}", "scale is 0"),
        ("odometry: {speed: {topic: /a}, yaw_rate: {topic: /a, unit: km/h}}", "is not in km/h"),
        ("camera: {left: {image: /a}, right: {image: /a}}", "left and right are one topic"),
    ],
)
def test_a_mapping_that_cannot_be_is_told(text: str, reason: str, log: Log, tmp_path: Path) -> None:
    told = tmp_path / "topics.yaml"
    told.write_text(text)
    with pytest.raises(InputError, match=reason):
        open_drive(log(twists()), topics=told)


def test_a_folder_takes_no_topics(tmp_path: Path) -> None:
    (tmp_path / "drive.yaml").write_text(
        "format_version: 1\nname: a\nframe: {kind: local, name: b}\nvehicle: {wheelbase_m: 2.7}\n"
    )
    with pytest.raises(InputError, match="kind folder has no topics"):
        open_drive(tmp_path, topics=tmp_path / "topics.yaml")


def test_a_part_that_is_null_is_not_used(opened: Opened) -> None:
    drive = opened(twists(), poses(), reference=None)
    assert drive.reference is None
    assert drive.odometry is not None


@pytest.mark.parametrize(("unit", "factor"), [("km/h", 1 / 3.6), ("m/s", 1.0), ("mph", 0.44704)])
def test_units_signs_and_scales_of_a_mapping(unit: str, factor: float, opened: Opened) -> None:
    drive = opened(twists(), imus(), odometry={
        "speed": {"topic": "/wheel/twist", "unit": unit, "scale": -1.0},
        "yaw_rate": {"topic": "/imu/data", "unit": "deg/s", "scale": -2.0},
    })  # fmt: skip
    assert drive.odometry is not None
    np.testing.assert_allclose(drive.odometry.speed_mps, -5.0 * factor)
    np.testing.assert_allclose(drive.odometry.yaw_rate_radps, np.radians(-0.6))


def test_wheel_speeds_of_joints_become_metres_a_second(opened: Opened) -> None:
    kind = "sensor_msgs/msg/JointState"
    joints = stream("/joint_states", kind, lambda stamp, _: ROS.make(
        kind, ROS.header(stamp, ""), ["steer", "rl", "rr"], np.zeros(3),
        np.array([0.4, 10.0, 12.0]), np.zeros(3)))  # fmt: skip
    wheels = {"topic": "/joint_states", "fields": ["velocity[1]", "velocity[2]"], "unit": "rad/s"}
    drive = opened(joints, imus(), odometry={
        "speed": wheels, "yaw_rate": {"topic": "/imu/data"}, "wheel_radius_m": 0.3})  # fmt: skip
    assert drive.odometry is not None
    np.testing.assert_allclose(drive.odometry.speed_mps, 11.0 * 0.3)
    np.testing.assert_allclose(drive.odometry.yaw_rate_radps, 0.3)


def test_numbers_of_any_message_are_found_by_their_path(tmp_path: Path) -> None:
    ros = Ros()
    kind = "car_msgs/msg/Report"
    ros.store.register(get_types_from_msg("float64[2] wheels\nfloat64 turn", kind))
    said = stream("/can/report", kind, lambda _s, _r: ros.make(kind, np.array([36.0, 38.0]), 9.0))
    path = write_mcap(tmp_path / "log.mcap", said, ros)
    told = tmp_path / "topics.yaml"
    told.write_text(yaml.safe_dump({"odometry": {
        "speed": {"topic": "/can/report", "fields": ["wheels[0]", "wheels[1]"], "unit": "km/h"},
        "yaw_rate": {"topic": "/can/report", "fields": ["turn"], "unit": "deg/s"}}}))  # fmt: skip
    odometry = open_drive(path, topics=told).odometry
    assert odometry is not None
    np.testing.assert_allclose(odometry.speed_mps, 37.0 / 3.6)
    np.testing.assert_allclose(odometry.yaw_rate_radps, np.radians(9.0))
    # without a header the time of recording is all there is
    np.testing.assert_array_equal(odometry.stamp_s, odometry.arrival_s)


def test_a_type_without_a_definition_is_told(tmp_path: Path) -> None:
    ros = Ros()
    kind = "car_msgs/msg/Report"
    ros.store.register(get_types_from_msg("float64 turn", kind))
    path = write_rosbag2(tmp_path / "log", [
        *stream("/can/report", kind, lambda _s, _r: ros.make(kind, 9.0)), *twists()
    ], ros, "SQLITE3")  # fmt: skip
    forget_definitions(path / "log.db3")
    assert uses(path)["/can/report"] == "not used: nothing here reads this type"
    told = tmp_path / "topics.yaml"
    told.write_text("odometry: {speed: {topic: /can/report, fields: [turn]}}\n")
    with pytest.raises(InputError, match="holds no definition of car_msgs/msg/Report"):
        open_drive(path, topics=told)
    assert open_drive(path).odometry is not None  # known to every ROS distribution


def forget_definitions(path: Path) -> None:
    """As recorders before ROS 2 Iron wrote it."""
    with closing(sqlite3.connect(path)) as database:
        database.execute("DROP TABLE message_definitions")
        database.commit()


def test_a_tab_within_a_topic_hides_no_mistake(tmp_path: Path) -> None:
    file = tmp_path / "topics.yaml"
    file.write_text("format_version: 1\ngnss:\n  topic: /fi\tx\nnonsense: 1\n")
    with pytest.raises(InputError, match=r"line 4: .*nonsense"):
        read_mapping(file)
