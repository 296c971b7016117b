"""The numbers that are kept of a message: one row of fixed columns for every kind."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from polemap.drivelog.readers.bags.types import Kind

Row = Sequence[float]
Extract = Callable[[Any], Row]

COLUMNS: dict[Kind, tuple[str, ...]] = {
    "gnss": ("latitude_deg", "longitude_deg", "status", "var_east_m2", "var_north_m2"),
    "imu": ("x_radps", "y_radps", "z_radps"),
    "odometry": (
        *("x_m", "y_m", "z_m", "qx", "qy", "qz", "qw", "var_x_m2", "var_y_m2"),
        *("speed_mps", "lateral_mps", "yaw_rate_radps"),
    ),
    "pose": ("x_m", "y_m", "z_m", "qx", "qy", "qz", "qw", "var_x_m2", "var_y_m2"),
    "twist": ("speed_mps", "lateral_mps", "yaw_rate_radps"),
    "ackermann": ("speed_mps", "road_wheel_angle_rad"),
    "number": ("value",),
    "poles": ("x_m", "y_m", "var_x_m2", "var_y_m2", "cov_xy_m2", "width_m", "probability"),
}


def _gnss(message: Any) -> Row:
    covariance = message.position_covariance
    known = int(message.position_covariance_type) > 0 and len(covariance) == 9
    status = getattr(message, "status", None)
    return (
        message.latitude,
        message.longitude,
        # Foxglove's LocationFix has no status: what is recorded is a fix
        float(status.status) if status is not None and hasattr(status, "status") else 0.0,
        covariance[0] if known else np.nan,
        covariance[4] if known else np.nan,
    )


def _imu(message: Any) -> Row:
    turn = message.angular_velocity
    return turn.x, turn.y, turn.z


def _pose_part(pose: Any, covariance: Any) -> Row:
    place, turn = pose.position, pose.orientation
    known = covariance is not None and len(covariance) == 36
    variances = (covariance[0], covariance[7]) if known else (np.nan, np.nan)
    return (place.x, place.y, place.z, turn.x, turn.y, turn.z, turn.w, *variances)


def _pose(message: Any) -> Row:
    pose = message.pose
    if hasattr(pose, "pose"):
        return _pose_part(pose.pose, pose.covariance)
    return _pose_part(pose, None)


def _twist_part(twist: Any) -> Row:
    return twist.linear.x, twist.linear.y, twist.angular.z


def _twist(message: Any) -> Row:
    twist = getattr(message, "twist", message)
    return _twist_part(getattr(twist, "twist", twist))


def _odometry(message: Any) -> Row:
    return (
        *_pose_part(message.pose.pose, message.pose.covariance),
        *_twist_part(message.twist.twist),
    )


def _ackermann(message: Any) -> Row:
    drive = getattr(message, "drive", message)
    return drive.speed, drive.steering_angle


def _number(message: Any) -> Row:
    return (message.data,)


def _poles(message: Any) -> Row:
    """Of all poles of a scan, one after the other."""
    return [getattr(pole, name) for pole in message.poles for name in COLUMNS["poles"]]


_EXTRACTS: dict[Kind, Extract] = {
    "gnss": _gnss,
    "imu": _imu,
    "odometry": _odometry,
    "pose": _pose,
    "twist": _twist,
    "ackermann": _ackermann,
    "number": _number,
    "poles": _poles,
}


class FieldError(ValueError):
    """A mapping names a field that a message does not have, or that holds no number."""


def extract_of(kind: Kind) -> Extract | None:
    """What takes the `COLUMNS` of a kind from a message; None for kinds that have none."""
    return _EXTRACTS.get(kind)


def by_path(paths: Sequence[str]) -> Extract:
    """What takes the numbers at dotted paths, such as `twist.linear.x` or `velocity[2]`.

    Raises (when called):
        FieldError: the message has no such field, or no number in it.
    """
    steps = [path.replace("[", ".").replace("]", "").split(".") for path in paths]

    def extract(message: Any) -> Row:
        return [_at(message, path, name) for path, name in zip(steps, paths, strict=True)]

    return extract


def _at(message: Any, path: Sequence[str], name: str) -> float:
    value = message
    for step in path:
        try:
            value = value[int(step)] if step.isdigit() else getattr(value, step)
        except (AttributeError, LookupError, TypeError):
            there = [field for field in getattr(value, "__slots__", ()) or _fields_of(value)
                     if not field.startswith("_")]  # fmt: skip
            hint = f"; there are: {', '.join(there[:8])}" if there else ""
            raise FieldError(f"it has no field '{name[:60]}'{hint}") from None
    try:
        return float(value)
    except (TypeError, ValueError):
        raise FieldError(f"its field '{name[:60]}' is no number") from None


def _fields_of(value: Any) -> Sequence[str]:
    """Names of the fields of a message."""
    return list(getattr(value, "__dict__", ()))
