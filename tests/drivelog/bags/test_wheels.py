"""Wheels with a topic each, recorded and followed, and video, which is not read but said."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from threading import Event
from typing import Any

import numpy as np
import pytest
import yaml
from rosbags.typesys import get_types_from_msg

from polemap.drivelog.drive import Drive
from polemap.drivelog.errors import InputError
from polemap.drivelog.frames import EarthFrame
from polemap.drivelog.live.growing import GrowingBytes
from polemap.drivelog.live.mcap_stream import StreamMessage, read_stream
from polemap.drivelog.live.topics import TopicSamples
from polemap.drivelog.readers.bags.mapping import OdometryPart, Signal
from polemap.drivelog.readers.bags.mapping_file import read_mapping
from polemap.drivelog.readers.bags.reader import survey
from polemap.drivelog.readers.registry import open_drive
from polemap.drivelog.samples import OdometrySample
from tests.drivelog.bags import streams as topics
from tests.drivelog.bags.recordings import Ros, Said, write_mcap

FLOAT = "std_msgs/msg/Float64"
TRACK_M, RADIUS_M = 1.6, 0.3


def wheel(side: int, late_ns: int = 0) -> list[Said]:
    """A wheel of a car at 6 m/s + 0.5 m/s^2 that turns left at 0.25 rad/s, in rad/s."""

    def turn(row: float) -> float:
        return (6.0 + 0.05 * row + side * 0.25 * TRACK_M / 2.0) / RADIUS_M

    name = "right" if side > 0 else "left"
    said = topics.stream(f"/wheel/{name}", FLOAT, lambda _s, row: topics.ROS.make(FLOAT, turn(row)))
    return [Said(one.log_ns + late_ns, one.topic, one.type_name, one.content) for one in said]


def part(**other: Any) -> dict[str, Any]:
    signals = {"speed": "/wheel/left", "right_wheel": "/wheel/right"}
    told = {role: {"topic": topic, "unit": "rad/s"} for role, topic in signals.items()}
    return {**told, "wheel_radius_m": RADIUS_M, **other}


def test_two_wheels_give_speed_and_yaw_rate(opened: Callable[..., Drive]) -> None:
    drive = opened(wheel(-1), wheel(1), odometry=part(track_m=TRACK_M))
    assert drive.odometry is not None
    rows = np.arange(topics.COUNT)
    np.testing.assert_allclose(drive.odometry.speed_mps, 6.0 + 0.05 * rows, atol=1e-9)
    np.testing.assert_allclose(drive.odometry.yaw_rate_radps, 0.25, atol=1e-9)


def test_wheels_that_are_not_measured_at_once_meet_at_the_stamps_of_the_left(
    opened: Callable[..., Drive],
) -> None:
    drive = opened(wheel(-1), wheel(1, late_ns=40_000_000), odometry=part(track_m=TRACK_M))
    assert drive.odometry is not None
    assert drive.problems["odometry_without_right_wheel"] == 1  # before the first of the right
    # the right one says at a stamp what the car did 0.04 s earlier: 0.05 m/s * 0.4 less
    np.testing.assert_allclose(drive.odometry.yaw_rate_radps, 0.25 - 0.02 / TRACK_M, atol=1e-6)
    # known when the later of the two around it had arrived
    assert np.all(drive.odometry.arrival_s >= drive.odometry.stamp_s)


def test_two_wheels_with_the_yaw_rate_of_an_imu(opened: Callable[..., Drive]) -> None:
    told = part(yaw_rate={"topic": "/imu/data"})
    drive = opened(wheel(-1), wheel(1), topics.imus(rate=0.3), odometry=told)
    assert drive.odometry is not None
    np.testing.assert_allclose(drive.odometry.yaw_rate_radps, 0.3)
    assert drive.odometry.speed_mps[0] == pytest.approx(6.0)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"right_wheel": None}, "track_m needs right_wheel"),
        ({"track_m": None}, "right_wheel needs track_m, or yaw_rate"),
        ({"yaw_rate": {"topic": "/imu/data"}}, "both give the yaw rate"),
        ({"wheel_radius_m": None}, "needs wheel_radius_m"),
        ({"right_wheel": {"topic": "/wheel/left"}}, "are one topic"),
        ({"right_wheel": {"topic": "/wheel/rigth"}}, "no topic '/wheel/rigth' was recorded"),
    ],
)
def test_what_two_wheels_lack_is_told(
    change: dict[str, Any], message: str, opened: Callable[..., Drive]
) -> None:
    with pytest.raises(InputError, match=message):
        opened(wheel(-1), wheel(1), odometry={**part(track_m=TRACK_M), **change})


def test_a_wheel_whose_numbers_are_all_unusable_is_told(opened: Callable[..., Drive]) -> None:
    nothing = topics.stream("/wheel/right", FLOAT, lambda _s, _r: topics.ROS.make(FLOAT, np.nan))
    with pytest.raises(InputError, match=r"odometry.right_wheel: its topic holds no message"):
        opened(wheel(-1), nothing, odometry=part(track_m=TRACK_M))


def test_a_part_that_was_made_by_hand_is_checked_too(log: Callable[..., Path]) -> None:
    signal = Signal(topic="/wheel/left")
    with pytest.raises(ValueError, match="right_wheel needs track_m"):
        OdometryPart(speed=signal, right_wheel=Signal(topic="/wheel/right"))


def test_two_wheels_are_followed(log: Callable[..., Path], tmp_path: Path) -> None:
    path = log(wheel(-1), wheel(1))
    (tmp_path / "t.yaml").write_text(yaml.safe_dump({"odometry": part(track_m=TRACK_M)}))
    taken = TopicSamples(read_mapping(tmp_path / "t.yaml"), EarthFrame("local", name="y"))
    assert taken.topics == ["/wheel/left", "/wheel/right"]
    records = read_stream(GrowingBytes(str(path), Event(), idle_s=0.02))
    found = [
        sample
        for record in records
        if isinstance(record, StreamMessage)
        for sample in taken.samples(record)
    ]
    assert len(found) == topics.COUNT - 1
    assert taken.counts["odometry_without_right_wheel"] == 1
    assert isinstance(found[-1], OdometrySample)
    # the right wheel is the last one that was heard, a tenth of a second older
    assert found[-1].speed_mps == pytest.approx(6.0 + 0.05 * 11 - 0.025, abs=1e-9)
    assert found[-1].yaw_rate_radps == pytest.approx(0.25 - 0.05 / TRACK_M, abs=1e-9)


def test_video_is_named(tmp_path: Path) -> None:
    ros = Ros()
    kind = "foxglove_msgs/msg/CompressedVideo"
    text = "builtin_interfaces/Time timestamp\nstring frame_id\nuint8[] data\nstring format"
    ros.store.register(get_types_from_msg(text, kind))
    time = ros.make("builtin_interfaces/msg/Time", 1, 0)
    frame = ros.make(kind, time, "cam", np.zeros(9, np.uint8), "h264")
    said = topics.stream("/cam/left", kind, lambda _s, _r: frame)
    path = write_mcap(tmp_path / "log.mcap", [*said, *topics.twists()], ros)
    assert survey(path)[1].uses["/cam/left"].startswith("not used: a video: only single pictures")
    (finding,) = (f for f in open_drive(path).findings if f.kind == "video_not_read")
    assert "image_transport republish" in finding.line()
