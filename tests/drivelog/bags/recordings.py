"""Drives as recordings, written by the reference libraries of each format."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import mcap.writer
import numpy as np
from numpy.typing import NDArray
from rosbags import rosbag1, rosbag2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from polemap.drivelog.drive import Drive
from polemap.drivelog.frames import geographic_from_grid
from polemap.stereo.rig import StereoRig

Floats = NDArray[np.float64]
SECOND_NS = 1_000_000_000


@dataclass(frozen=True, slots=True)
class Said:
    """One message: when it is recorded, on which topic, of which type."""

    log_ns: int
    topic: str
    type_name: str
    content: Any


def ns(seconds: float) -> int:
    return round(seconds * 1e9)


class Ros:
    """Messages of a ROS version, made by rosbags' own types."""

    def __init__(self, store: Stores = Stores.ROS2_HUMBLE) -> None:
        self.store = get_typestore(store)
        self.one = store == Stores.ROS1_NOETIC
        text = "geometry_msgs/TransformStamped[] transforms"
        self.store.register(get_types_from_msg(text, "tf2_msgs/msg/TFMessage"))

    def make(self, name: str, *values: Any) -> Any:
        return self.store.types[name](*values)

    def header(self, stamp_ns: int, frame: str) -> Any:
        stamp = self.make(
            "builtin_interfaces/msg/Time", stamp_ns // SECOND_NS, stamp_ns % SECOND_NS
        )
        return self.make("std_msgs/msg/Header", *((0,) if self.one else ()), stamp, frame)

    def vector(self, x: float, y: float, z: float, kind: str = "Vector3") -> Any:
        return self.make(f"geometry_msgs/msg/{kind}", x, y, z)

    def pose(self, x: float, y: float, yaw: float) -> Any:
        turn = self.make(
            "geometry_msgs/msg/Quaternion", 0.0, 0.0, float(np.sin(yaw / 2)), float(np.cos(yaw / 2))
        )
        return self.make("geometry_msgs/msg/Pose", self.vector(x, y, 0.0, "Point"), turn)

    def twist(self, speed: float, yaw_rate: float) -> Any:
        return self.make(
            "geometry_msgs/msg/Twist", self.vector(speed, 0.0, 0.0), self.vector(0.0, 0.0, yaw_rate)
        )

    def image(self, stamp_ns: int, picture: NDArray[Any], encoding: str | None = None) -> Any:
        encoding = encoding or ("mono8" if picture.dtype == np.uint8 else "mono16")
        height, width = picture.shape[:2]
        step = picture.nbytes // height
        data = np.ascontiguousarray(picture).view(np.uint8).ravel()
        header = self.header(stamp_ns, "camera")
        return self.make("sensor_msgs/msg/Image", header, height, width, encoding, 0, step, data)

    def compressed(self, stamp_ns: int, picture: NDArray[Any], form: str = "png") -> Any:
        data = cv2.imencode(f".{form}", picture)[1].ravel()
        header = self.header(stamp_ns, "camera")
        return self.make("sensor_msgs/msg/CompressedImage", header, form, data)

    def info(self, stamp_ns: int, rig: StereoRig, side: str, **other: Any) -> Any:
        shift = -rig.focal_px * rig.baseline_m if side == "right" else 0.0
        f, cx, cy = rig.focal_px, rig.cx_px, rig.cy_px
        values = {
            "lens": "plumb_bob", "D": np.zeros(5),
            "K": np.array([f, 0, cx, 0, f, cy, 0, 0, 1.0]), "R": np.eye(3).ravel(),
            "P": np.array([f, 0, cx, shift, 0, f, cy, 0, 0, 0, 1.0, 0]), **other,
        }  # fmt: skip
        roi = self.make("sensor_msgs/msg/RegionOfInterest", 0, 0, 0, 0, False)
        return self.make(
            "sensor_msgs/msg/CameraInfo", self.header(stamp_ns, "camera"), rig.height_px,
            rig.width_px, values["lens"], values["D"], values["K"], values["R"], values["P"], 0, 0,
            roi,
        )  # fmt: skip

    def fix(self, stamp_ns: int, place: Floats, sd_m: float, status: int = 0) -> Any:
        state = self.make("sensor_msgs/msg/NavSatStatus", status, 1)
        covariance = np.diag([sd_m**2, sd_m**2, 9.0]).ravel()
        return self.make(
            "sensor_msgs/msg/NavSatFix", self.header(stamp_ns, "gnss"), state, float(place[0]),
            float(place[1]), 0.0, covariance, 2,
        )  # fmt: skip

    def transforms(self, *several: tuple[str, str, Floats, Floats]) -> Any:
        """Each parent, child, translation `(3,)` and rotation matrix `(3, 3)`."""
        made = []
        for parent, child, place, turn in several:
            quaternion = self.make("geometry_msgs/msg/Quaternion", *quaternion_of(turn))
            motion = self.make("geometry_msgs/msg/Transform", self.vector(*place), quaternion)
            made.append(
                self.make(
                    "geometry_msgs/msg/TransformStamped", self.header(0, parent), child, motion
                )
            )
        return self.make("tf2_msgs/msg/TFMessage", made)


def quaternion_of(rotation: Floats) -> tuple[float, float, float, float]:
    """x, y, z, w, by the eigenvector of the largest eigenvalue (Bar-Itzhack 2000)."""
    r = rotation
    k = np.array([
        [r[0, 0] - r[1, 1] - r[2, 2], r[0, 1] + r[1, 0], r[0, 2] + r[2, 0], r[2, 1] - r[1, 2]],
        [r[0, 1] + r[1, 0], r[1, 1] - r[0, 0] - r[2, 2], r[1, 2] + r[2, 1], r[0, 2] - r[2, 0]],
        [r[0, 2] + r[2, 0], r[1, 2] + r[2, 1], r[2, 2] - r[0, 0] - r[1, 1], r[1, 0] - r[0, 1]],
        [r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1], np.trace(r)],
    ])  # fmt: skip
    x, y, z, w = np.linalg.eigh(k)[1][:, -1]
    return float(x), float(y), float(z), float(w)


def ros_messages(drive: Drive, ros: Ros, *, png: bool = False) -> list[Said]:
    """All of a drive, in the order of arrival."""
    said = list(_ros_pictures(drive, ros, png))
    if drive.rig is not None:
        mount = drive.rig.vehicle_from_camera
        place = np.array([mount.x_m, mount.y_m, mount.z_m])
        antenna = np.array([*drive.gnss_antenna_m, 1.6])
        content = ros.transforms(
            ("rear_axle", "camera", place, mount.rotation()),
            ("rear_axle", "gnss", antenna, np.eye(3)),
        )
        said.append(Said(ns(drive.span_s[0]), "/tf_static", "tf2_msgs/msg/TFMessage", content))
    if drive.odometry is not None:
        for row in map(drive.odometry.sample, range(len(drive.odometry))):
            content = ros.make(
                "geometry_msgs/msg/TwistStamped", ros.header(ns(row.stamp_s), "rear_axle"),
                ros.twist(row.speed_mps, row.yaw_rate_radps),
            )  # fmt: skip
            said.append(
                Said(ns(row.arrival_s), "/wheel/twist", "geometry_msgs/msg/TwistStamped", content)
            )
    if drive.reference is not None:
        kind = "geometry_msgs/msg/PoseWithCovarianceStamped"
        reference = drive.reference
        for stamp, pose, sd_m in zip(
            reference.stamp_s, reference.poses, reference.sd_m, strict=True
        ):
            covariance = np.diag([sd_m**2, sd_m**2, *[0.0] * 4]).ravel()
            content = ros.make(
                kind, ros.header(ns(stamp), "map"),
                ros.make("geometry_msgs/msg/PoseWithCovariance", ros.pose(*pose), covariance),
            )  # fmt: skip
            said.append(Said(ns(stamp), "/ground_truth", kind, content))
    said += _ros_fixes(drive, ros)
    return sorted(said, key=lambda one: one.log_ns)


def _ros_pictures(drive: Drive, ros: Ros, png: bool) -> Iterator[Said]:
    for row in range(len(drive.frame_stamps_s)):
        frame = drive.read_frame(row)
        stamp, log = ns(frame.stamp_s), ns(frame.arrival_s)
        for side in ("left", "right"):
            picture = getattr(frame, side)
            name = f"/stereo/{side}/image_rect"
            if png:
                kind = "sensor_msgs/msg/CompressedImage"
                yield Said(log, f"{name}/compressed", kind, ros.compressed(stamp, picture))
            else:
                yield Said(log, name, "sensor_msgs/msg/Image", ros.image(stamp, picture))
            assert drive.rig is not None
            kind = "sensor_msgs/msg/CameraInfo"
            yield Said(log, f"/stereo/{side}/camera_info", kind, ros.info(stamp, drive.rig, side))


def _ros_fixes(drive: Drive, ros: Ros) -> Iterator[Said]:
    """Fixes by latitude and longitude, or as poses where the drive's frame is local."""
    if drive.gnss is None:
        return
    points = np.stack([drive.gnss.east_m, drive.gnss.north_m], axis=1)
    places = geographic_from_grid(drive.frame, points) if drive.frame.is_utm else points
    for row, place in enumerate(places):
        stamp, log = ns(drive.gnss.stamp_s[row]), ns(drive.gnss.arrival_s[row])
        if drive.frame.is_utm:
            content = ros.fix(stamp, place, 2.5 * float(drive.gnss.hdop[row]))
            yield Said(log, "/gnss/fix", "sensor_msgs/msg/NavSatFix", content)
        else:
            content = ros.make(
                "geometry_msgs/msg/PoseStamped",
                ros.header(stamp, "map"),
                ros.pose(float(place[0]), float(place[1]), 0.0),
            )
            yield Said(log, "/gnss/local", "geometry_msgs/msg/PoseStamped", content)


def write_rosbag1(
    path: Path, said: Iterable[Said], ros: Ros, compression: str | None = None
) -> Path:
    with_writer = rosbag1.Writer(path)
    if compression:
        with_writer.set_compression(rosbag1.Writer.CompressionFormat[compression])
    known: dict[str, Any] = {}
    with with_writer as writer:
        for one in said:
            if one.topic not in known:
                known[one.topic] = writer.add_connection(
                    one.topic, one.type_name, typestore=ros.store
                )
            data = ros.store.serialize_ros1(one.content, one.type_name)
            writer.write(known[one.topic], one.log_ns, data)
    return path


def write_rosbag2(
    path: Path, said: Iterable[Said], ros: Ros, storage: str = "MCAP", compression: str = "NONE"
) -> Path:
    with_writer = rosbag2.Writer(path, version=9, storage_plugin=rosbag2.StoragePlugin[storage])
    if compression != "NONE":
        with_writer.set_compression(
            rosbag2.CompressionMode[compression], rosbag2.CompressionFormat.ZSTD
        )
    known: dict[str, Any] = {}
    with with_writer as writer:
        for one in said:
            if one.topic not in known:
                known[one.topic] = writer.add_connection(
                    one.topic, one.type_name, typestore=ros.store
                )
            data = ros.store.serialize_cdr(one.content, one.type_name)
            writer.write(known[one.topic], one.log_ns, data)
    return path


def write_mcap(
    path: Path, said: Iterable[Said], ros: Ros, compression: str = "ZSTD", **options: Any
) -> Path:
    """A bare MCAP file of ROS 2 messages by `mcap`'s own writer."""
    with path.open("wb") as file:
        writer: Any = mcap.writer.Writer(
            file, compression=mcap.writer.CompressionType[compression], **options
        )
        writer.start(profile="ros2", library="test")
        known: dict[str, int] = {}
        for number, one in enumerate(said):
            if one.topic not in known:
                text, _ = ros.store.generate_msgdef(one.type_name, ros_version=2)
                schema = writer.register_schema(one.type_name, "ros2msg", text.encode())
                known[one.topic] = writer.register_channel(one.topic, "cdr", schema)
            data = bytes(ros.store.serialize_cdr(one.content, one.type_name))
            writer.add_message(known[one.topic], one.log_ns, data, one.log_ns, number)
        writer.finish()
    return path


# Foxglove's schemas as far as they are used here. Source: github.com/foxglove/foxglove-sdk
