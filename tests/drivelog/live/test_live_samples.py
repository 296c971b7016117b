"""A recording that grows, and lines of JSON, as the samples of the drive that they came from."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from threading import Event
from typing import Any

import cv2
import numpy as np
import pytest

from polemap.drivelog.detections import Detections
from polemap.drivelog.drive import Drive
from polemap.drivelog.errors import InputError
from polemap.drivelog.frames import EarthFrame
from polemap.drivelog.live.growing import GrowingBytes
from polemap.drivelog.live.json_lines import LONGEST_LINE, BadLine, read_lines
from polemap.drivelog.live.mcap_stream import StreamFile, StreamMessage, read_stream
from polemap.drivelog.live.pending import PendingFrame
from polemap.drivelog.live.topics import TopicSamples
from polemap.drivelog.readers.bags.described import (
    FIX,
    POLES,
    SIDES,
    TWIST,
    image_topic,
    own_mapping,
)
from polemap.drivelog.readers.bags.mapping import Mapping, OdometryPart, Signal
from polemap.drivelog.readers.registry import open_drive
from polemap.drivelog.samples import GnssFix, OdometrySample, ReferencePose, StereoFrame
from polemap.drivelog.writers.ros.drive import write_drive_mcap
from tests.drivelog.drives import VIEW, write_small

UTM = EarthFrame("utm", 32632)
LOCAL = EarthFrame("local", name="yard")


@pytest.fixture
def drive(tmp_path: Path) -> Drive:
    return open_drive(write_small(tmp_path / "drive"))


def source_of(path: Path) -> GrowingBytes:
    return GrowingBytes(str(path), Event(), idle_s=0.02)


def stream(path: Path) -> list[StreamMessage | StreamFile]:
    return list(read_stream(source_of(path)))


def samples_of(path: Path, drive: Drive) -> Iterator[Any]:
    known = (TWIST, FIX, *map(image_topic, SIDES))
    taken = TopicSamples(own_mapping(known, drive), drive.frame, poles=POLES, view=VIEW)
    for record in stream(path):
        if isinstance(record, StreamMessage):
            yield from taken.samples(record)


def test_a_recording_gives_the_samples_of_its_drive(drive: Drive, tmp_path: Path) -> None:
    write_drive_mcap(drive, tmp_path / "d.mcap")
    expected = [s for s in drive.samples() if not isinstance(s, ReferencePose)]
    found = list(samples_of(tmp_path / "d.mcap", drive))
    assert len(found) == len(expected)
    for now, was in zip(found, expected, strict=True):
        assert now.stamp_s == pytest.approx(was.stamp_s, abs=1e-9)
        assert now.arrival_s == pytest.approx(was.arrival_s, abs=1e-6)
        if isinstance(was, OdometrySample):
            assert (now.speed_mps, now.yaw_rate_radps) == (was.speed_mps, was.yaw_rate_radps)
        elif isinstance(was, GnssFix):
            assert now.east_m == pytest.approx(was.east_m, abs=1e-6)
            assert now.hdop == pytest.approx(was.hdop)
        elif isinstance(was, Detections):
            np.testing.assert_array_equal(now.points_vehicle_m, was.points_vehicle_m)
        else:
            assert isinstance(was, StereoFrame)
            assert isinstance(now, PendingFrame)
            np.testing.assert_array_equal(now.decoded().right, was.right)


def test_a_recording_that_ends_anywhere_gives_what_is_whole(drive: Drive, tmp_path: Path) -> None:
    write_drive_mcap(drive, tmp_path / "d.mcap")
    whole = (tmp_path / "d.mcap").read_bytes()
    all_of_it = stream(tmp_path / "d.mcap")
    for share in np.linspace(0.0, 0.99, 40):
        (tmp_path / "cut.mcap").write_bytes(whole[: int(share * len(whole))])
        found = stream(tmp_path / "cut.mcap")
        assert found == all_of_it[: len(found)]


def test_what_is_damaged_or_no_recording_is_one_error(drive: Drive, tmp_path: Path) -> None:
    write_drive_mcap(drive, tmp_path / "d.mcap")
    data = bytearray((tmp_path / "d.mcap").read_bytes())
    middle = len(data) // 3
    data[middle : middle + 400] = bytes(400)
    (tmp_path / "bad.mcap").write_bytes(data)
    with pytest.raises(InputError, match=r"bad\.mcap: damaged MCAP"):
        stream(tmp_path / "bad.mcap")
    (tmp_path / "no.mcap").write_bytes(b"these are words and no recording" * 40)
    with pytest.raises(InputError, match="damaged MCAP"):
        stream(tmp_path / "no.mcap")


def test_pictures_without_partner_are_counted(drive: Drive, tmp_path: Path) -> None:
    write_drive_mcap(drive, tmp_path / "d.mcap")
    taken = TopicSamples(own_mapping([*map(image_topic, SIDES)], drive), UTM)
    messages = [r for r in stream(tmp_path / "d.mcap") if isinstance(r, StreamMessage)]
    lefts = [one for one in messages if one.channel.topic == image_topic("left")]
    for copy in range(4):
        for one in lefts:
            shifted = bytearray(one.data)
            shifted[4:8] = (1000 + copy).to_bytes(4, "little")
            moved = StreamMessage(one.channel, one.log_s, bytes(shifted))
            assert list(taken.samples(moved)) == []
    assert taken.counts["left_pictures_without_partner"] == 4 * len(lefts) - 8


def test_units_and_a_yaw_rate_of_its_own_topic(drive: Drive, tmp_path: Path) -> None:
    write_drive_mcap(drive, tmp_path / "d.mcap")
    speed = Signal(topic=TWIST, unit="km/h", scale=-1.0)
    odometry = OdometryPart(speed=speed, yaw_rate=Signal(topic=TWIST, unit="deg/s"))
    taken = TopicSamples(Mapping(odometry=odometry), UTM)
    records = [r for r in stream(tmp_path / "d.mcap") if isinstance(r, StreamMessage)]
    found = [s for r in records for s in taken.samples(r)]
    assert drive.odometry is not None
    assert isinstance(found[0], OdometrySample)
    assert found[0].speed_mps == pytest.approx(-drive.odometry.speed_mps[0] / 3.6)
    assert found[0].yaw_rate_radps == pytest.approx(np.deg2rad(drive.odometry.yaw_rate_radps[0]))


def test_damaged_messages_are_counted(drive: Drive, tmp_path: Path) -> None:
    write_drive_mcap(drive, tmp_path / "d.mcap")
    taken = TopicSamples(own_mapping([TWIST], drive), UTM)
    record = next(r for r in stream(tmp_path / "d.mcap")
                  if isinstance(r, StreamMessage) and r.channel.topic == TWIST)  # fmt: skip
    assert list(taken.samples(StreamMessage(record.channel, 1.0, record.data[:9]))) == []
    assert taken.counts == {f"{TWIST} undecodable": 1}


LINES: list[dict[str, Any]] = [
    {"type": "odometry", "stamp_s": 1.0, "speed_mps": 8, "yaw_rate_radps": 0.1},
    {"type": "gnss", "stamp_s": 1.1, "latitude_deg": 49.0, "longitude_deg": 8.4, "hdop": 1.2},
    {"type": "gnss", "stamp_s": 1.2, "east_m": 4.0, "north_m": 5.0, "arrival_s": 1.3},
    {"type": "poles", "stamp_s": 1.3, "poles": [
        {"x_m": 9.0, "y_m": 3.0, "var_x_m2": 0.04, "var_y_m2": 0.02, "cov_xy_m2": 0.01}]},
    {"type": "poles", "stamp_s": 1.4, "poles": []},
]  # fmt: skip


def lines(tmp_path: Path, content: bytes, frame: EarthFrame = UTM) -> list[Any]:
    (tmp_path / "lines").write_bytes(content)
    return list(read_lines(source_of(tmp_path / "lines"), frame, VIEW))


def test_lines_of_json_are_samples(tmp_path: Path) -> None:
    text = "\n".join(map(json.dumps, LINES)) + "\n\n"
    odometry, fix, position, scan, empty = lines(tmp_path, text.encode())
    assert odometry.speed_mps == 8.0
    assert np.isnan(odometry.arrival_s)
    assert fix.hdop == 1.2
    assert 4e5 < fix.east_m < 6e5
    assert (position.east_m, position.arrival_s, position.hdop) == (4.0, 1.3, 1.0)
    np.testing.assert_array_equal(scan.covariance_m2[0], [[0.04, 0.01], [0.01, 0.02]])
    assert scan.view is VIEW
    assert np.isnan(scan.width_m[0])
    assert len(empty) == 0


def test_pictures_of_lines_are_read_when_they_are_looked_at(tmp_path: Path) -> None:
    picture = np.full((4, 6), 7, np.uint8)
    cv2.imwrite(str(tmp_path / "l.png"), picture)
    line = {"type": "frame", "stamp_s": 1.0, "left": f"{tmp_path}/l.png", "right": "gone.png"}
    (frame,) = lines(tmp_path, json.dumps(line).encode() + b"\n")
    with pytest.raises(InputError, match=r"gone\.png"):
        frame.decoded()


@pytest.mark.parametrize(
    ("line", "reason"),
    [
        (b"nonsense", "is no JSON"),
        (b"[1]", "is a list, an object was expected"),
        (b'{"type": "odometry"}', "stamp_s is missing"),
        (b'{"type": "lidar", "stamp_s": 1}', "known are odometry, gnss, poles, frame"),
        (b'{"type": "odometry", "stamp_s": 1, "speed_mps": "8", "yaw_rate_radps": 0}',
         "speed_mps is '8', no number"),
        (b'{"type": "odometry", "stamp_s": true}', "stamp_s is 'True', no number"),
        (b'{"type": "odometry", "stamp_s": NaN}', "stamp_s is nan"),
        (b'{"type": "odometry", "stamp_s": 1' + b"0" * 400 + b"}", "is beyond all numbers"),
        (b'{"type": "gnss", "stamp_s": 1, "east_m": 1, "north_m": 2, "hdop": 0}', "be positive"),
        (b'{"type": "gnss", "stamp_s": 1, "latitude_deg": 490, "longitude_deg": 8}', "nowhere"),
        (b'{"type": "poles", "stamp_s": 1, "poles": 3}', "is no list"),
        (b'{"type": "poles", "stamp_s": 1, "poles": [' + b"{}," * 300 + b"{}]}", "300 can be"),
        (b'{"type": "poles", "stamp_s": 1, "poles": [{"x_m": 1, "y_m": 1, "var_x_m2": 1,'
         b'"var_y_m2": 1, "cov_xy_m2": 2}]}', "not positive definite"),
        (b'{"type": "frame", "stamp_s": 1, "left": 3, "right": "r.png"}', "no path of an image"),
        (b"{" + b" " * LONGEST_LINE, "is longer than"),
        (b"[" * 100_000, "is no JSON"),
        (b"\xff\xfe\x00", "is no JSON"),
    ],
)  # fmt: skip
def test_a_line_that_is_no_sample_says_why(line: bytes, reason: str, tmp_path: Path) -> None:
    found = lines(tmp_path, line + b"\n" + json.dumps(LINES[0]).encode() + b"\n")
    assert isinstance(found[0], BadLine)
    assert reason in found[0].reason
    assert "line 1: " in found[0].reason
    assert isinstance(found[-1], OdometrySample)  # the next line is taken


def test_degrees_have_no_place_in_a_local_frame(tmp_path: Path) -> None:
    (bad,) = lines(tmp_path, json.dumps(LINES[1]).encode() + b"\n", LOCAL)
    assert "send east_m, north_m" in bad.reason
