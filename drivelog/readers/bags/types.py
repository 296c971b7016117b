"""Names of message types, and what a message of each is good for."""

from __future__ import annotations

from typing import Literal

Kind = Literal[
    "picture", "camera", "gnss", "imu", "odometry", "twist", "ackermann", "joints", "number",
    "pose", "transforms", "poles",
]  # fmt: skip

_KINDS: dict[str, Kind] = {
    "sensor_msgs/msg/Image": "picture",
    "sensor_msgs/msg/CompressedImage": "picture",
    "sensor_msgs/msg/CameraInfo": "camera",
    "sensor_msgs/msg/NavSatFix": "gnss",
    "sensor_msgs/msg/Imu": "imu",
    "sensor_msgs/msg/JointState": "joints",
    "nav_msgs/msg/Odometry": "odometry",
    "geometry_msgs/msg/Twist": "twist",
    "geometry_msgs/msg/TwistStamped": "twist",
    "geometry_msgs/msg/TwistWithCovarianceStamped": "twist",
    "geometry_msgs/msg/PoseStamped": "pose",
    "geometry_msgs/msg/PoseWithCovarianceStamped": "pose",
    "ackermann_msgs/msg/AckermannDrive": "ackermann",
    "ackermann_msgs/msg/AckermannDriveStamped": "ackermann",
    "std_msgs/msg/Float32": "number",
    "std_msgs/msg/Float64": "number",
    "tf2_msgs/msg/TFMessage": "transforms",
    "tf/msg/tfMessage": "transforms",
    "polemap_msgs/msg/PoleScan": "poles",
    "foxglove/RawImage": "picture",
    "foxglove/CompressedImage": "picture",
    "foxglove/CameraCalibration": "camera",
    "foxglove/LocationFix": "gnss",
    "foxglove/PoseInFrame": "pose",
    "foxglove/FrameTransform": "transforms",
    "foxglove/FrameTransforms": "transforms",
}


def ros_type(name: str) -> str:
    """`pkg/Type` of ROS 1 and of some MCAP files as `pkg/msg/Type`; other names as they are."""
    parts = name.split("/")
    if len(parts) == 2 and all(parts):
        return f"{parts[0]}/msg/{parts[1]}"
    return name


def canonical(type_name: str) -> str:
    """One name for a Foxglove type, whether of Protobuf, JSON, ROS 1 or ROS 2."""
    for start in ("foxglove.", "foxglove_msgs/msg/", "foxglove_schemas_protobuf."):
        if type_name.startswith(start):
            return f"foxglove/{type_name[len(start) :]}"
    return type_name


def kind_of(type_name: str) -> Kind | None:
    """What a message of a type is good for; None for types that nothing here uses."""
    return _KINDS.get(canonical(type_name))
