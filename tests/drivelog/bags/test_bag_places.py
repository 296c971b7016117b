"""Fixes, references and speeds of recordings."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from polemap.drivelog.errors import InputError
from polemap.drivelog.frames import EarthFrame
from polemap.drivelog.readers.bags.describe import describe_topics
from polemap.drivelog.readers.bags.reader import survey
from polemap.drivelog.readers.registry import open_drive
from polemap.stereo.rig import Mounting
from tests.drivelog.bags.recordings import write_mcap
from tests.drivelog.bags.streams import (
    CAMERA_AXES,
    COUNT,
    IMU,
    PLACE,
    ROS,
    UTM,
    Opened,
    fixes,
    imus,
    mountings,
    odometry,
    poses,
    stream,
    twists,
)


def test_fixes_that_are_none_are_counted_and_the_covariance_is_used(opened: Opened) -> None:
    status = np.zeros(COUNT)
    status[2:5] = -1
    drive = opened(fixes(status), twists())
    assert drive.gnss is not None
    assert len(drive.gnss) == COUNT - 3
    assert drive.problems["gnss_without_fix"] == 3
    np.testing.assert_allclose(drive.gnss.hdop, 2.0)
    assert drive.frame == UTM
    np.testing.assert_allclose([drive.gnss.east_m[0], drive.gnss.north_m[0]], PLACE, atol=1e-6)


def test_poses_in_the_grid_of_the_fixes_are_in_their_zone(opened: Opened) -> None:
    drive = opened(fixes(), poses(origin=PLACE))
    assert drive.frame == UTM
    assert drive.gnss is not None
    assert drive.reference is not None


def test_poses_of_a_local_frame_leave_fixes_out_until_their_origin_is_told(
    opened: Opened,
) -> None:
    drive = opened(fixes(), poses())
    assert drive.frame == EarthFrame("local", name="map")
    assert drive.gnss is None
    assert [finding.kind for finding in drive.findings] == ["gnss_frame"]
    origin = {"east_m": 458000.0, "north_m": 5.43e6, "yaw_rad": 0.5 * np.pi}
    drive = opened(fixes(), poses(), reference={"topic": "/ground_truth", "origin": origin})
    assert drive.frame == UTM
    assert drive.gnss is not None
    assert drive.reference is not None
    np.testing.assert_allclose(
        drive.reference.poses[2], [458000.0, 5.43e6 + 1.0, 0.5 * np.pi], atol=1e-9
    )


def test_a_reference_of_another_part_of_the_car_is_moved_to_the_rear_axle(
    opened: Opened,
) -> None:
    turned = Mounting(yaw_rad=np.pi / 2).rotation() @ CAMERA_AXES.T
    frames = mountings(("base_link", "ins", np.array([1.0, 0.5, 1.2]), turned))
    drive = opened(
        odometry("/ground_truth/odom", frame="map", child="ins"), frames,
        vehicle={"rear_axle_x_m": -0.2},
    )  # fmt: skip
    assert drive.reference is not None
    # the unit looks to the left: the car heads to its right, 1.2 m ahead is -y of the map
    x, y, yaw = drive.reference.poses[0]
    assert (x, y, yaw) == pytest.approx((-0.5, 1.2, -np.pi / 2), abs=1e-9)


def test_orientations_that_are_none_are_left_out(opened: Opened) -> None:
    said = poses()
    said[3].content.pose.orientation.w = 0.0
    drive = opened(said)
    assert drive.reference is not None
    assert len(drive.reference) == COUNT - 1
    assert drive.problems["reference_without_orientation"] == 1


def test_a_topic_of_two_types_is_read_as_the_first_and_said(tmp_path: Path) -> None:
    said = [*twists("/car"), *imus("/bus")]
    path = write_mcap(tmp_path / "log.mcap", said, ROS, "NONE", enable_crcs=False)
    # a second publisher that gives a topic another type
    name = b"\x04\x00\x00\x00/"
    path.write_bytes(path.read_bytes().replace(name + b"bus", name + b"car"))
    index, made = survey(path)
    assert index.topics["/car"].count == 2 * COUNT
    assert index.topics["/car"].other_types == [IMU]
    lines = describe_topics(index, made)
    assert any("/car was recorded as sensor_msgs/msg/Imu, too" in line for line in lines)
    drive = open_drive(path)
    assert drive.odometry is not None
    assert len(drive.odometry) == COUNT


def test_a_stream_of_which_nothing_can_be_used_is_an_error(opened: Opened) -> None:
    drive = opened(twists(speed=float("nan")), poses())
    assert drive.odometry is None
    (finding,) = drive.findings
    assert (finding.kind, finding.severity) == ("rows_left_out", "error")
    assert "none of its 12 messages" in finding.value
    assert drive.problems["odometry_not_finite"] == COUNT


@pytest.mark.parametrize(
    ("place", "mapping", "remedy"),
    [
        ([89.0, 10.0], {}, "degrees of WGS84"),
        ([48.0, 11.0], {"frame": {"kind": "local", "name": "yard"}}, "a frame of kind utm"),
    ],
)
def test_fixes_that_fit_no_zone_or_frame_are_told(
    place: list[float], mapping: dict[str, Any], remedy: str, opened: Opened
) -> None:
    drive = opened(fixes(place=np.array(place)), twists(), **mapping)
    assert drive.gnss is None
    (finding,) = drive.findings
    assert remedy in finding.remedy


@pytest.mark.parametrize(
    ("kind", "make"),
    [
        ("geometry_msgs/msg/Twist", lambda _: ROS.twist(5.0, 0.1)),
        (
            "geometry_msgs/msg/TwistWithCovarianceStamped",
            lambda stamp: ROS.make(
                "geometry_msgs/msg/TwistWithCovarianceStamped",
                ROS.header(stamp, "base_link"),
                ROS.make(
                    "geometry_msgs/msg/TwistWithCovariance", ROS.twist(5.0, 0.1), np.zeros(36)
                ),
            ),
        ),
    ],
)
def test_every_kind_of_twist_gives_speed_and_yaw_rate(
    kind: str, make: Callable[[int], Any], opened: Opened
) -> None:
    drive = opened(stream("/vehicle/twist", kind, lambda stamp, _: make(stamp)))
    assert drive.odometry is not None
    np.testing.assert_array_equal(drive.odometry.speed_mps, 5.0)
    np.testing.assert_array_equal(drive.odometry.yaw_rate_radps, 0.1)


def test_a_speed_as_one_number_takes_the_yaw_rate_of_an_imu(opened: Opened) -> None:
    kind = "std_msgs/msg/Float64"
    speeds = stream("/speed", kind, lambda _s, _r: ROS.make(kind, 36.0))
    speed = {"topic": "/speed", "unit": "km/h"}
    drive = opened(speeds, imus(), odometry={"speed": speed, "yaw_rate": {"topic": "/imu/data"}})
    assert drive.odometry is not None
    np.testing.assert_allclose(drive.odometry.speed_mps, 10.0)
    assert drive.problems["odometry_without_yaw_rate"] == 1  # after the last of the IMU
    with pytest.raises(InputError, match="have no yaw rate; name its topic"):
        opened(speeds, odometry={"speed": speed})
