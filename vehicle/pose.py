"""Poses in the plane: wrapping, composition, and the transfer of the reference point."""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, sin
from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


def wrap_angle(angle_rad: Any) -> Any:
    """Wrap an angle, or an array of them, to [-pi, pi).

    >>> wrap_angle(np.pi) == -np.pi
    True
    """
    return (angle_rad + np.pi) % (2.0 * np.pi) - np.pi


@dataclass(frozen=True, slots=True)
class Pose2D:
    """A pose in the plane: metres east and north, radians counter-clockwise from east."""

    x_m: float
    y_m: float
    yaw_rad: float

    def compose(self, other: Pose2D) -> Pose2D:
        """`map_from_a.compose(a_from_b)` is `map_from_b`."""
        c, s = cos(self.yaw_rad), sin(self.yaw_rad)
        return Pose2D(
            self.x_m + c * other.x_m - s * other.y_m,
            self.y_m + s * other.x_m + c * other.y_m,
            float(wrap_angle(self.yaw_rad + other.yaw_rad)),
        )

    def inverse(self) -> Pose2D:
        """`map_from_vehicle.inverse()` is `vehicle_from_map`."""
        c, s = cos(self.yaw_rad), sin(self.yaw_rad)
        return Pose2D(
            -(c * self.x_m + s * self.y_m),
            -(-s * self.x_m + c * self.y_m),
            float(wrap_angle(-self.yaw_rad)),
        )

    def transform(self, points_m: Floats) -> Floats:
        """Points `(..., 2)` of this pose's own frame, in the frame that the pose is given in."""
        return np.asarray(points_m, dtype=np.float64) @ self.rotation().T + (self.x_m, self.y_m)

    def rotation(self) -> Floats:
        """The rotation matrix `(2, 2)` of the yaw."""
        c, s = cos(self.yaw_rad), sin(self.yaw_rad)
        return np.array([[c, -s], [s, c]])

    def as_array(self) -> Floats:
        """`[x_m, y_m, yaw_rad]`."""
        return np.array([self.x_m, self.y_m, self.yaw_rad])


def shift_forward(poses: Floats, distance_m: float) -> Floats:
    """Poses `(..., 3)` moved along their own heading; the wheelbase leads rear to front axle."""
    moved = np.array(poses, dtype=np.float64)
    moved[..., 0] += distance_m * np.cos(moved[..., 2])
    moved[..., 1] += distance_m * np.sin(moved[..., 2])
    return moved
