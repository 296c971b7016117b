"""Messages of made-up recordings, stream by stream, and what a reader says of them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.drive import Drive
from polemap.drivelog.frames import EarthFrame, geographic_from_grid
from polemap.drivelog.readers.bags.reader import survey
from polemap.stereo.rig import Mounting
from tests.drivelog.bags.recordings import Ros, Said
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

Opened = Callable[..., Drive]
Log = Callable[..., Path]

UTM = EarthFrame("utm", 32632)
PLACE = np.array([458000.0, 5.43e6])


def fixes(status: NDArray[Any] | None = None, place: Any = None) -> list[Said]:
    latitude_longitude = geographic_from_grid(UTM, PLACE[None])[0] if place is None else place
    return stream("/fix", FIX, lambda stamp, row: ROS.fix(
        stamp, latitude_longitude, 5.0, 0 if status is None else int(status[row])))  # fmt: skip


def uses(path: Path) -> dict[str, str]:
    return survey(path)[1].uses
