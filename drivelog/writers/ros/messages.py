"""Samples and poses as ROS 2 messages: REP 103 axes, REP 105 frames."""

from __future__ import annotations

from collections.abc import Sequence
from math import isfinite
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.detections import Detections
from polemap.drivelog.errors import InputError
from polemap.drivelog.samples import OdometrySample
from polemap.drivelog.writers.ros.mcap_file import nanoseconds
from polemap.drivelog.writers.ros.types import message_types
from polemap.stereo.rig import StereoRig

Floats = NDArray[np.float64]

VEHICLE, MAP = "base_link", "map"
LEFT_CAMERA, RIGHT_CAMERA = "left_camera", "right_camera"
# builtin_interfaces/Time counts seconds in 32 bits
_LARGEST_S = 2**31 - 1


def time_of(stamp_s: float) -> Any:
    """A stamp.

    Raises:
        InputError: before zero or beyond 2038, where ROS has no number for it.
    """
    if not stamp_s < _LARGEST_S:
        raise InputError(f"a time of {stamp_s:.6g} s is beyond ROS's clock (seconds below 2^31)")
    seconds, rest = divmod(nanoseconds(stamp_s, "a stamp"), 1_000_000_000)
    return message_types().make("builtin_interfaces/msg/Time", sec=seconds, nanosec=rest)


def header(stamp_s: float, frame: str) -> Any:
    """A header."""
    return message_types().make("std_msgs/msg/Header", stamp=time_of(stamp_s), frame_id=frame)


def vector(x: float, y: float, z: float) -> Any:
    """A vector."""
    return message_types().make("geometry_msgs/msg/Vector3", x=float(x), y=float(y), z=float(z))


def point(x: float, y: float, z: float = 0.0) -> Any:
    """A point."""
    return message_types().make("geometry_msgs/msg/Point", x=float(x), y=float(y), z=float(z))


def turned(yaw_rad: float) -> Any:
    """A rotation about the vertical axis."""
    half = 0.5 * float(yaw_rad)
    return message_types().make(
        "geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=float(np.sin(half)), w=float(np.cos(half))
    )


def pose(east_m: float, north_m: float, yaw_rad: float, z_m: float = 0.0) -> Any:
    """A pose on a plane."""
    return message_types().make(
        "geometry_msgs/msg/Pose", position=point(east_m, north_m, z_m), orientation=turned(yaw_rad)
    )


def quaternion(rotation: Floats) -> tuple[float, float, float, float]:
    """x, y, z, w of a rotation `(3, 3)`; w is not negative.

    Source: Bar-Itzhack, "New method for extracting the quaternion from a rotation matrix", 2000:
    the eigenvector of the largest eigenvalue, exact for rotations and stable for all of them.
    """
    r = np.asarray(rotation, dtype=np.float64)
    k = np.array(
        [
            [r[0, 0] - r[1, 1] - r[2, 2], r[0, 1] + r[1, 0], r[0, 2] + r[2, 0], r[2, 1] - r[1, 2]],
            [r[0, 1] + r[1, 0], r[1, 1] - r[0, 0] - r[2, 2], r[1, 2] + r[2, 1], r[0, 2] - r[2, 0]],
            [r[0, 2] + r[2, 0], r[1, 2] + r[2, 1], r[2, 2] - r[0, 0] - r[1, 1], r[1, 0] - r[0, 1]],
            [r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1], r[0, 0] + r[1, 1] + r[2, 2]],
        ]
    )
    best = np.linalg.eigh(k / 3.0)[1][:, -1]
    x, y, z, w = best if best[3] >= 0.0 else -best
    return float(x), float(y), float(z), float(w)


def transform(
    stamp_s: float, parent: str, child: str, position_m: Sequence[float], rotation: Floats
) -> Any:
    """Where a frame stands in another: position `(3,)` and rotation `(3, 3)`."""
    make = message_types().make
    x, y, z, w = quaternion(rotation)
    return make(
        "geometry_msgs/msg/TransformStamped",
        header=header(stamp_s, parent),
        child_frame_id=child,
        transform=make(
            "geometry_msgs/msg/Transform",
            translation=vector(*position_m),
            rotation=make("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w),
        ),
    )


def transforms(some: Sequence[Any]) -> Any:
    """What /tf and /tf_static hold."""
    return message_types().make("tf2_msgs/msg/TFMessage", transforms=list(some))


def camera_transforms(rig: StereoRig, stamp_s: float) -> list[Any]:
    """Where both cameras stand in the vehicle."""
    mount = rig.vehicle_from_camera
    place = (mount.x_m, mount.y_m, mount.z_m)
    return [
        transform(stamp_s, VEHICLE, LEFT_CAMERA, place, mount.rotation()),
        transform(stamp_s, LEFT_CAMERA, RIGHT_CAMERA, (rig.baseline_m, 0.0, 0.0), np.eye(3)),
    ]


def camera_info(rig: StereoRig, stamp_s: float, *, right: bool) -> Any:
    """The calibration of a rectified camera; the right one's `p` holds -focal x baseline."""
    make = message_types().make
    k = np.array([rig.focal_px, 0, rig.cx_px, 0, rig.focal_px, rig.cy_px, 0, 0, 1], dtype=float)
    shift = -rig.focal_px * rig.baseline_m if right else 0.0
    p = np.array([*k[:3], shift, *k[3:6], 0, *k[6:], 0], dtype=float)
    return make(
        "sensor_msgs/msg/CameraInfo",
        header=header(stamp_s, RIGHT_CAMERA if right else LEFT_CAMERA),
        height=rig.height_px, width=rig.width_px, distortion_model="plumb_bob",
        d=np.zeros(5), k=k, r=np.eye(3).ravel(), p=p, binning_x=0, binning_y=0,
        roi=make("sensor_msgs/msg/RegionOfInterest", x_offset=0, y_offset=0, height=0, width=0,
                 do_rectify=False),
    )  # fmt: skip


def compressed_image(stamp_s: float, frame: str, kind: str, data: bytes) -> Any:
    """An image file of `kind` (png, jpeg)."""
    return message_types().make(
        "sensor_msgs/msg/CompressedImage",
        header=header(stamp_s, frame),
        format=kind,
        data=np.frombuffer(data, dtype=np.uint8),
    )


def twist(sample: OdometrySample) -> Any:
    """Rear-axle speed and yaw rate."""
    make = message_types().make
    return make(
        "geometry_msgs/msg/TwistStamped",
        header=header(sample.stamp_s, VEHICLE),
        twist=make(
            "geometry_msgs/msg/Twist",
            linear=vector(sample.speed_mps, 0.0, 0.0),
            angular=vector(0.0, 0.0, sample.yaw_rate_radps),
        ),
    )


def nav_sat_fix(stamp_s: float, latitude_deg: float, longitude_deg: float, sd_m: float) -> Any:
    """A fix whose east and north have a standard deviation of `sd_m`."""
    make = message_types().make
    known = 1 if isfinite(sd_m) else 0  # COVARIANCE_TYPE_APPROXIMATED, _UNKNOWN
    variance = np.diag([sd_m**2, sd_m**2, 0.0]) if known else np.zeros((3, 3))
    return make(
        "sensor_msgs/msg/NavSatFix",
        header=header(stamp_s, "gnss"),
        status=make("sensor_msgs/msg/NavSatStatus", status=0, service=1),
        latitude=float(latitude_deg), longitude=float(longitude_deg), altitude=0.0,
        position_covariance=variance.ravel(), position_covariance_type=known,
    )  # fmt: skip


def pose_with_covariance(place: Floats, covariance: Floats | None) -> Any:
    """A pose `(3,)` with its covariance `(3, 3)`; all zero where nothing is known (REP 103)."""
    full = np.zeros((6, 6))
    if covariance is not None and np.isfinite(covariance).all():
        rows = np.array([0, 1, 5])  # x, y, rotation about z
        full[np.ix_(rows, rows)] = covariance
    return message_types().make(
        "geometry_msgs/msg/PoseWithCovariance", pose=pose(*place), covariance=full.ravel()
    )


def stamped_pose_with_covariance(
    stamp_s: float, frame: str, place: Floats, covariance: Floats | None
) -> Any:
    """A pose `(3,)` in a frame."""
    return message_types().make(
        "geometry_msgs/msg/PoseWithCovarianceStamped",
        header=header(stamp_s, frame),
        pose=pose_with_covariance(place, covariance),
    )


def odometry(
    stamp_s: float,
    frame: str,
    place: Floats,
    covariance: Floats | None,
    speed_mps: float = 0.0,
    yaw_rate_radps: float = 0.0,
) -> Any:
    """Pose `(3,)` in `frame` and motion of the vehicle."""
    make = message_types().make
    moving = make(
        "geometry_msgs/msg/Twist",
        linear=vector(speed_mps, 0.0, 0.0),
        angular=vector(0.0, 0.0, yaw_rate_radps),
    )
    return make(
        "nav_msgs/msg/Odometry",
        header=header(stamp_s, frame),
        child_frame_id=VEHICLE,
        pose=pose_with_covariance(place, covariance),
        twist=make("geometry_msgs/msg/TwistWithCovariance", twist=moving, covariance=np.zeros(36)),
    )


def path(stamp_s: float, frame: str, stamps_s: Floats, poses: Floats) -> Any:
    """Poses `(n, 3)` as a line."""
    make = message_types().make
    return make(
        "nav_msgs/msg/Path",
        header=header(stamp_s, frame),
        poses=[
            make("geometry_msgs/msg/PoseStamped", header=header(float(at), frame), pose=pose(*one))
            for at, one in zip(stamps_s, poses, strict=True)
        ],
    )


def pole_scan(scan: Detections) -> Any:
    """Poles in the vehicle frame."""
    make = message_types().make
    points, covariance = scan.points_vehicle_m, scan.covariance_m2
    return make(
        "polemap_msgs/msg/PoleScan",
        header=header(scan.stamp_s, VEHICLE),
        poles=[
            make(
                "polemap_msgs/msg/Pole",
                x_m=float(points[row, 0]), y_m=float(points[row, 1]),
                var_x_m2=float(covariance[row, 0, 0]), var_y_m2=float(covariance[row, 1, 1]),
                cov_xy_m2=float(covariance[row, 0, 1]), width_m=float(scan.width_m[row]),
                probability=float(scan.probability[row]),
            )
            for row in range(len(scan))
        ],
    )  # fmt: skip
