"""What topics are guessed to be for, mappings that say otherwise, clocks, pairs and units."""

from __future__ import annotations

import re
import sqlite3
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from rosbags.typesys import get_types_from_msg

from polemap.drivelog.drive import Drive, open_drive
from polemap.drivelog.errors import InputError, Mistakes
from polemap.drivelog.frames import EarthFrame, geographic_from_grid
from polemap.drivelog.readers.bags.clocks import seconds
from polemap.drivelog.readers.bags.describe import describe_topics
from polemap.drivelog.readers.bags.frames import nearest_once
from polemap.drivelog.readers.bags.reader import survey
from polemap.drivelog.readers.bags.stereo_pair import side_order
from polemap.stereo.calibration import camera_info, of_camera_infos
from polemap.stereo.rectify import Rectifier
from polemap.stereo.rig import Mounting
from tests.drivelog.bags.recordings import Ros, Said, write_mcap, write_rosbag2
from tests.drivelog.drives import RIG, picture

ROS = Ros()
START_NS = 1_700_000_000_000_000_000
STEP_NS = 100_000_000
COUNT = 12
TWIST, ODOMETRY = "geometry_msgs/msg/TwistStamped", "nav_msgs/msg/Odometry"
POSE, IMU = "geometry_msgs/msg/PoseStamped", "sensor_msgs/msg/Imu"
INFO = "sensor_msgs/msg/CameraInfo"
IMAGE, FIX, TF = "sensor_msgs/msg/Image", "sensor_msgs/msg/NavSatFix", "tf2_msgs/msg/TFMessage"
CAMERA_AXES = Mounting().rotation()


def stamps(count: int = COUNT, start: int = START_NS) -> list[int]:
    return [start + STEP_NS * row for row in range(count)]


def stream(topic: str, kind: str, make: Callable[[int, int], Any], **when: Any) -> list[Said]:
    """`make(stamp_ns, row)` every 0.1 s, recorded 20 ms after."""
    return [
        Said(stamp + 20_000_000, topic, kind, make(stamp, row))
        for row, stamp in enumerate(stamps(**when))
    ]


def twists(topic: str = "/wheel/twist", speed: float = 5.0, rate: float = 0.1) -> list[Said]:
    return stream(topic, TWIST, lambda stamp, _: ROS.make(
        TWIST, ROS.header(stamp, "base_link"), ROS.twist(speed, rate)))  # fmt: skip


def odometry(
    topic: str = "/odom", speed: float = 5.0, rate: float = 0.1, frame: str = "odom",
    child: str = "base_link",
) -> list[Said]:  # fmt: skip
    def make(stamp: int, row: int) -> Any:
        pose = ROS.make("geometry_msgs/msg/PoseWithCovariance", ROS.pose(row * 0.5, 0.0, 0.0),
                        np.zeros(36))  # fmt: skip
        twist = ROS.make("geometry_msgs/msg/TwistWithCovariance", ROS.twist(speed, rate),
                         np.zeros(36))  # fmt: skip
        return ROS.make(ODOMETRY, ROS.header(stamp, frame), child, pose, twist)

    return stream(topic, ODOMETRY, make)


def poses(topic: str = "/ground_truth", origin: Any = (0.0, 0.0)) -> list[Said]:
    def make(stamp: int, row: int) -> Any:
        pose = ROS.pose(origin[0] + 0.5 * row, origin[1], 0.0)
        return ROS.make(POSE, ROS.header(stamp, "map"), pose)

    return stream(topic, POSE, make)


def imus(topic: str = "/imu/data", rate: float = 0.3, frame: str = "imu") -> list[Said]:
    def make(stamp: int, _: int) -> Any:
        turn = ROS.make("geometry_msgs/msg/Quaternion", 0.0, 0.0, 0.0, 1.0)
        return ROS.make(IMU, ROS.header(stamp, frame), turn, np.zeros(9),
                        ROS.vector(0.01, 0.02, rate), np.zeros(9), ROS.vector(0.0, 0.0, 9.8),
                        np.zeros(9))  # fmt: skip

    return stream(topic, IMU, make)


def pictures(topic: str, shift_ns: int = 0, count: int = COUNT) -> list[Said]:
    return stream(topic, IMAGE, lambda stamp, row: ROS.image(stamp + shift_ns, picture(row)),
                  count=count)  # fmt: skip


def infos(topic: str, side: str, **other: Any) -> list[Said]:
    return stream(topic, INFO, lambda stamp, _: ROS.info(stamp, RIG, side, **other), count=1)


def pair(place: str = "/stereo", name: str = "image_rect", **other: Any) -> list[Said]:
    return [
        said
        for side in ("left", "right")
        for said in (
            *pictures(f"{place}/{side}/{name}"),
            *infos(f"{place}/{side}/camera_info", side, **other),
        )
    ]


def mountings(*several: tuple[str, str, Any, Any]) -> list[Said]:
    return [Said(START_NS, "/tf_static", TF, ROS.transforms(*several))]


def sides_of(place: str = "/stereo", **other: Any) -> dict[str, Any]:
    """The part `camera` of a mapping."""
    sides = {
        side: {"image": f"{place}/{side}/image_rect", "info": f"{place}/{side}/camera_info"}
        for side in ("left", "right")
    }
    return {**sides, **other}


MOUNTED = mountings(("base_link", "camera", np.array([1.9, 0.1, 1.3]), CAMERA_AXES))


@pytest.fixture
def log(tmp_path: Path) -> Callable[..., Path]:
    def write(*parts: list[Said], ros: Ros = ROS) -> Path:
        said = sorted((one for part in parts for one in part), key=lambda one: one.log_ns)
        return write_mcap(tmp_path / "log.mcap", said, ros)

    return write


@pytest.fixture
def opened(log: Callable[..., Path], tmp_path: Path) -> Callable[..., Drive]:
    def read(*parts: list[Said], ros: Ros = ROS, **mapping: Any) -> Drive:
        path = log(*parts, ros=ros)
        if not mapping:
            return open_drive(path)
        told = tmp_path / "topics.yaml"
        told.write_text(yaml.safe_dump({"format_version": 1, **mapping}))
        return open_drive(path, topics=told)

    return read


Opened = Callable[..., Drive]
Log = Callable[..., Path]


def uses(path: Path) -> dict[str, str]:
    return survey(path)[1].uses


# ------------------------------------------------------------------------------------ guesses


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


# ------------------------------------------------------------------------------------ mappings


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


# -------------------------------------------------------------------------------- clocks, pairs


@given(st.lists(st.integers(0, 2**62), min_size=1, max_size=30))
def test_seconds_are_the_doubles_that_their_decimals_are(nanoseconds: list[int]) -> None:
    found = seconds(np.array(nanoseconds, dtype=np.int64))
    wanted = [float(f"{one // 10**9}.{one % 10**9:09d}") for one in nanoseconds]
    np.testing.assert_array_equal(found, wanted)


def late(said: list[Said], by_ns: Callable[[int], int]) -> list[Said]:
    return [
        Said(one.log_ns + by_ns(row), one.topic, one.type_name, one.content)
        for row, one in enumerate(said)
    ]


def test_a_log_on_another_clock_still_tells_what_came_late(opened: Opened) -> None:
    """Written years after the headers, as a replay is; the poses 30 ms after the odometry."""
    years = 10**17
    drive = opened(late(odometry(), lambda _: years), late(poses(), lambda _: years + 30_000_000))
    assert drive.odometry is not None
    np.testing.assert_allclose(drive.odometry.arrival_s - drive.odometry.stamp_s, 0.0, atol=1e-6)
    assert any("apart from that of the headers" in note for note in drive.notes)


def test_a_log_at_another_pace_tells_no_arrivals(opened: Opened) -> None:
    drive = opened(late(odometry(), lambda row: 10**17 + row * 10**9))
    assert drive.odometry is not None
    np.testing.assert_array_equal(drive.odometry.arrival_s, drive.odometry.stamp_s)
    assert any("arrivals are not known" in note for note in drive.notes)


def test_stamps_of_zero_become_times_of_recording(opened: Opened) -> None:
    said = twists()
    for one in said[3:5]:
        one.content.header.stamp.sec = one.content.header.stamp.nanosec = 0
    drive = opened(said)
    assert drive.odometry is not None
    assert len(drive.odometry) == COUNT
    assert np.all(np.diff(drive.odometry.stamp_s) > 0)
    np.testing.assert_allclose(drive.odometry.stamp_s[3], said[3].log_ns / 1e9)
    assert any("2 of 12 messages have no stamp" in note for note in drive.notes)


def test_messages_out_of_order_and_twice_are_sorted_and_counted(opened: Opened) -> None:
    said = twists()
    said[4].content.header.stamp, said[7].content.header.stamp = (
        said[7].content.header.stamp, said[4].content.header.stamp,
    )  # fmt: skip
    said[9].content.header.stamp = said[8].content.header.stamp
    drive = opened(said)
    assert drive.odometry is not None
    assert len(drive.odometry) == COUNT - 1
    assert drive.problems["odometry_duplicate_stamps"] == 1
    assert any("out of order" in note for note in drive.notes)


def test_pictures_without_a_partner_are_counted(opened: Opened) -> None:
    left = pictures("/stereo/left/image_rect")
    right = pictures("/stereo/right/image_rect", 3_000_000)
    sides = [infos(f"/stereo/{side}/camera_info", side) for side in ("left", "right")]
    drive = opened(left, right[:4] + right[6:], *sides, MOUNTED)
    assert len(drive.frame_stamps_s) == COUNT - 2
    assert drive.problems["left_pictures_without_partner"] == 2
    assert list(drive.frame_numbers[3:6]) == [3, 6, 7]
    # the pair is there when the later of both is
    assert any("within 5.0 ms" in note for note in drive.notes)
    drive = opened(left, right, *sides, MOUNTED, camera=sides_of(pair_tolerance_s=0.002))
    assert drive.problems["right_pictures_without_partner"] == COUNT


@given(
    st.lists(st.integers(0, 60), max_size=8, unique=True),
    st.lists(st.integers(0, 60), max_size=8, unique=True),
    st.integers(0, 6),
)
def test_pairs_are_nearest_and_used_once(ours: list[int], theirs: list[int], most: int) -> None:
    a, b = (np.array(sorted(stamps), dtype=np.int64) for stamps in (ours, theirs))
    matched = nearest_once(a, b, most)
    used = matched[matched >= 0]
    assert len(set(used.tolist())) == len(used)
    for row, partner in enumerate(matched):
        near = np.abs(b - a[row]).min() if len(b) else 99
        if partner >= 0:
            assert abs(int(b[partner] - a[row])) == near <= most
        elif near <= most:  # another of ours is at least as near to each of its nearest
            others = np.abs(a[:, None] - b[None, np.abs(b - a[row]) == near])
            assert (others.min(axis=0) <= near).all()


# -------------------------------------------------------------------- calibrations and mountings


def test_the_mounting_comes_over_a_chain_of_frames(opened: Opened) -> None:
    """base_footprint -> base_link (0.4 m up) -> camera (body axes: x ahead), and a moving one."""
    chain = mountings(
        ("base_footprint", "base_link", np.array([0.0, 0.0, 0.4]), np.eye(3)),
        ("base_link", "camera", np.array([1.5, 0.2, 1.0]), np.eye(3)),
    )
    moving = [
        Said(START_NS + row, "/tf", TF, ROS.transforms(
            ("odom", "base_footprint", np.array([float(row), 0.0, 0.0]), np.eye(3))))
        for row in range(3)
    ]  # fmt: skip
    drive = opened(pair(), chain, moving, vehicle={"rear_axle_x_m": -0.5})
    assert drive.rig is not None
    mount = drive.rig.vehicle_from_camera
    assert (mount.x_m, mount.y_m, mount.z_m) == pytest.approx((2.0, 0.2, 1.4))
    assert (mount.roll_rad, mount.pitch_rad, mount.yaw_rad) == pytest.approx((0.0, 0.0, 0.0))


def test_a_camera_without_a_place_is_an_error_and_a_mapping_places_it(opened: Opened) -> None:
    drive = opened(pair())
    (finding,) = (f for f in drive.findings if f.severity == "error")
    assert finding.kind == "camera_mounting"
    assert "'camera'" in finding.value
    place = {"x_m": 1.0, "y_m": 0.0, "z_m": 1.2, "pitch_rad": 0.1}
    drive = opened(pair(), camera=sides_of(vehicle_from_camera=place))
    assert not drive.findings
    assert drive.rig is not None
    assert drive.rig.vehicle_from_camera == Mounting(1.0, 0.0, 1.2, 0.0, 0.1, 0.0)


@pytest.mark.parametrize(
    ("left", "right", "reason"),
    [
        ({}, {"P": None}, "no calibration was recorded for the right pictures"),
        ({"K": np.zeros(9)}, {}, "is not calibrated"),
        ({"D": np.full(5, np.nan)}, {}, "finite"),
        ({"lens": "mystery"}, {}, "lens model 'mystery' is unknown"),
        ({"P": "right"}, {"P": "left"}, "exchange left and right"),
        ({}, {"P": "left"}, "neither P.0,3. nor TF tells the baseline"),
    ],
)
def test_calibrations_that_cannot_be_are_told(
    left: dict[str, Any], right: dict[str, Any], reason: str, opened: Opened
) -> None:
    parts = []
    for side, other in (("left", left), ("right", right)):
        parts.append(pictures(f"/stereo/{side}/image_rect"))
        if "P" in other and other["P"] is None:
            continue
        if isinstance(other.get("P"), str):
            other = {"P": ROS.info(0, RIG, other["P"]).p}
        parts.append(infos(f"/stereo/{side}/camera_info", side, **other))
    drive = opened(*parts, twists(), MOUNTED)
    assert not drive.has_frames
    assert drive.odometry is not None
    (finding,) = (f for f in drive.findings if f.kind == "camera_calibration")
    assert finding.severity == "error"
    assert re.search(reason, finding.value)


def test_tf_between_the_cameras_gives_the_baseline_of_two_single_ones(opened: Opened) -> None:
    """Drivers of single cameras leave P of both without a shift, or at zero."""
    parts = []
    for side in ("left", "right"):
        info = infos(f"/stereo/{side}/camera_info", side, P=np.zeros(12))
        info[0].content.header.frame_id = f"camera_{side}"
        parts += [pictures(f"/stereo/{side}/image_rect"), info]
    frames = mountings(
        ("base_link", "camera_left", np.array([1.0, 0.0, 1.0]), CAMERA_AXES),
        ("camera_left", "camera_right", np.array([0.25, 0.0, 0.0]), np.eye(3)),
    )
    drive = opened(*parts, frames)
    assert drive.rig is not None
    assert drive.rig.baseline_m == pytest.approx(0.25)


def test_raw_pairs_are_rectified_by_their_calibration(opened: Opened) -> None:
    lens = np.array([-0.2, 0.05, 0.001, -0.001, 0.0])
    drive = opened(pair(name="image_raw", D=lens), MOUNTED)
    found = [ROS.info(0, RIG, side, D=lens) for side in ("left", "right")]
    sides = [camera_info((64, 48), "plumb_bob", (one.k, one.d, one.r, one.p)) for one in found]
    wanted = Rectifier(of_camera_infos(*sides)).rectify(picture(2), picture(2))
    frame = drive.read_frame(2)
    np.testing.assert_array_equal(frame.left, wanted[0])
    np.testing.assert_array_equal(frame.right, wanted[1])
    assert not np.array_equal(frame.left, picture(2))
    # the same pictures under a name that says rectified are taken as they are
    named = opened(pair(name="image_rect", D=lens), MOUNTED)
    np.testing.assert_array_equal(named.read_frame(2).left, picture(2))


def test_pictures_of_another_size_than_their_calibration_are_told(opened: Opened) -> None:
    said = pair()
    odd = [ROS.image(START_NS + STEP_NS, np.zeros((40, 64), dtype=np.uint8))]
    said = [
        Said(one.log_ns, one.topic, one.type_name, odd[0])
        if one.topic.endswith("left/image_rect") and one.log_ns == START_NS + STEP_NS + 20_000_000
        else one
        for one in said
    ]
    drive = opened(said, MOUNTED)
    with pytest.raises(InputError, match="/stereo/left/image_rect, picture 1: 64x40 pixels"):
        drive.read_frame(1)
    drive.read_frame(2)


# ------------------------------------------------------------------------- fixes and references

UTM = EarthFrame("utm", 32632)
PLACE = np.array([458000.0, 5.43e6])


def fixes(status: NDArray[Any] | None = None, place: Any = None) -> list[Said]:
    latitude_longitude = geographic_from_grid(UTM, PLACE[None])[0] if place is None else place
    return stream("/fix", FIX, lambda stamp, row: ROS.fix(
        stamp, latitude_longitude, 5.0, 0 if status is None else int(status[row])))  # fmt: skip


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
    path = write_mcap(tmp_path / "log.mcap", said, ROS, "NONE")
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
