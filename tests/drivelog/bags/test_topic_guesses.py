"""What topics are guessed to be for."""

from __future__ import annotations

import numpy as np
import pytest
from rosbags.typesys import get_types_from_msg

from polemap.drivelog.readers.bags.stereo_pair import side_order
from tests.drivelog.bags.recordings import Ros
from tests.drivelog.bags.streams import (
    COUNT,
    MOUNTED,
    Log,
    Opened,
    imus,
    infos,
    mountings,
    odometry,
    pair,
    pictures,
    poses,
    sides_of,
    stream,
    twists,
    uses,
)


@pytest.mark.parametrize(
    ("left", "right", "alike"),
    [
        ("/stereo/left/image_rect", "/stereo/right/image_rect", True),
        ("/cam0/image_raw", "/cam1/image_raw", True),
        ("/zed/imageLeft", "/zed/imageRight", True),
        ("/camera/infra1/image", "/camera/infra2/image", True),
        ("/kitti/image_02/data", "/kitti/image_03/data", True),
        ("/left/image", "/left/image_raw", False),
        ("/stereo/right/image", "/stereo/left/image", False),
        ("/front/image", "/rear/image", False),
    ],
)
def test_left_and_right_are_told_by_one_word(left: str, right: str, alike: bool) -> None:
    assert (side_order(left, right) is not None) == alike


def test_rectified_pictures_go_before_raw_ones_and_depth_is_none(log: Log) -> None:
    used = uses(log(pair(name="image_raw"), pictures("/stereo/left/image_rect"),
                    pictures("/stereo/right/image_rect"), pictures("/stereo/left/depth"),
                    pictures("/stereo/right/depth")))  # fmt: skip
    assert used["/stereo/left/image_rect"] == "left pictures"
    assert used["/stereo/right/camera_info"] == "right calibration"
    assert "better" in used["/stereo/left/image_raw"]
    assert "no picture of a camera" in used["/stereo/left/depth"]


def test_cameras_without_sides_in_their_names_are_told_by_calibration(log: Log) -> None:
    used = uses(log(pictures("/a/image"), infos("/a/camera_info", "right"), pictures("/b/image"),
                    infos("/b/camera_info", "left")))  # fmt: skip
    assert used["/a/image"] == "right pictures"
    assert used["/b/camera_info"] == "left calibration"


def test_of_two_pairs_as_likely_neither_is_taken(opened: Opened) -> None:
    drive = opened(pair("/front"), pair("/rear"), twists())
    assert not drive.has_frames
    (finding,) = (f for f in drive.findings if f.kind == "topic_ambiguous")
    assert "/front/left/image_rect and /rear/left/image_rect" in finding.value
    drive = opened(pair("/front"), pair("/rear"), MOUNTED, camera=sides_of("/rear"))
    assert len(drive.frame_stamps_s) == COUNT


def test_commands_plans_and_drifting_poses_are_not_used(log: Log) -> None:
    used = uses(log(twists("/cmd_vel"), poses("/move_base/goal"), odometry("/visual/odom"),
                    odometry("/odom")))  # fmt: skip
    assert used["/odom"] == "speed, yaw rate"
    assert (
        used["/cmd_vel"] == used["/move_base/goal"] == ("not used: by its name a command or a plan")
    )
    assert used["/visual/odom"].startswith("not used")


def test_a_pose_without_a_speed_is_no_odometry(opened: Opened) -> None:
    drive = opened(odometry("/slam/odometry", speed=0.0, rate=0.0, frame="map"))
    assert drive.odometry is None
    assert drive.reference is not None


def test_an_imu_gives_the_yaw_rate_where_odometry_has_none(opened: Opened) -> None:
    tilted = np.diag([1.0, -1.0, -1.0])  # upside down
    drive = opened(odometry(rate=0.0), imus(),
                   mountings(("base_link", "imu", np.zeros(3), tilted)))  # fmt: skip
    assert drive.odometry is not None
    np.testing.assert_allclose(drive.odometry.yaw_rate_radps, -0.3, atol=1e-12)
    np.testing.assert_array_equal(drive.odometry.speed_mps, 5.0)


def test_steering_gives_the_yaw_rate_of_a_single_track(opened: Opened) -> None:
    kind = "ackermann_msgs/msg/AckermannDriveStamped"
    ros = Ros()
    for name, text in (("AckermannDrive", "float32 steering_angle\nfloat32 "
                        "steering_angle_velocity\nfloat32 speed\nfloat32 acceleration\nfloat32 "
                        "jerk"), ("AckermannDriveStamped", "std_msgs/Header header\n"
                                  "ackermann_msgs/AckermannDrive drive")):  # fmt: skip
        ros.store.register(get_types_from_msg(text, f"ackermann_msgs/msg/{name}"))
    said = stream("/vehicle/ackermann", kind, lambda stamp, _: ros.make(
        kind, ros.header(stamp, "base_link"),
        ros.make("ackermann_msgs/msg/AckermannDrive", 0.1, 0.0, 5.0, 0.0, 0.0)))  # fmt: skip
    drive = opened(said, vehicle={"wheelbase_m": 2.5}, ros=ros)
    assert drive.odometry is not None
    np.testing.assert_allclose(drive.odometry.yaw_rate_radps, 5.0 * np.tan(0.1) / 2.5, rtol=1e-6)
