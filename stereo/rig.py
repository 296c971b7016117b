"""The stereo rig: intrinsics of the rectified pair, baseline and mounting in the vehicle."""

from __future__ import annotations

from dataclasses import dataclass, field
from math import asin, atan2, cos, isfinite, sin

import numpy as np
from numpy.typing import NDArray

from polemap.stereo.errors import StereoError
from polemap.vehicle.pose import pose_rotation

Floats = NDArray[np.float64]

# camera axes (x right, y down, z forward) written in vehicle axes (x forward, y left, z up)
_AXES = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])


def rotation_from_angles(yaw_rad: float, pitch_rad: float, roll_rad: float) -> Floats:
    """Rz(yaw) Ry(pitch) Rx(roll) `(3, 3)`; a positive pitch turns the nose down (ISO 8855)."""
    cp, sp = cos(pitch_rad), sin(pitch_rad)
    cr, sr = cos(roll_rad), sin(roll_rad)
    ry = np.array([[cp, 0, sp], [0, 1.0, 0], [-sp, 0, cp]])
    rx = np.array([[1.0, 0, 0], [0, cr, -sr], [0, sr, cr]])
    return np.asarray(pose_rotation(yaw_rad) @ ry @ rx)


@dataclass(frozen=True, slots=True)
class Mounting:
    """Pose of the left camera in the vehicle frame (ISO 8855, origin below the rear axle).

    All angles zero means a camera that looks straight ahead; rotation Rz(yaw) Ry(pitch) Rx(roll).
    """

    x_m: float = 0.0
    y_m: float = 0.0
    z_m: float = 1.5
    roll_rad: float = 0.0
    pitch_rad: float = 0.0
    yaw_rad: float = 0.0

    def rotation(self) -> Floats:
        """`(3, 3)`, vehicle axes from camera axes."""
        turn = rotation_from_angles(self.yaw_rad, self.pitch_rad, self.roll_rad)
        return np.asarray(turn @ _AXES)

    @classmethod
    def from_rotation(cls, rotation: Floats, position_m: Floats) -> Mounting:
        """From the rotation `(3, 3)`, vehicle axes from camera axes, and the place `(3,)`."""
        r = rotation @ _AXES.T
        return cls(
            x_m=float(position_m[0]),
            y_m=float(position_m[1]),
            z_m=float(position_m[2]),
            roll_rad=atan2(r[2, 1], r[2, 2]),
            pitch_rad=asin(float(np.clip(-r[2, 0], -1.0, 1.0))),
            yaw_rad=atan2(r[1, 0], r[0, 0]),
        )


@dataclass(frozen=True, slots=True)
class StereoRig:
    """A rectified pair: equal focal lengths and rows, right camera `baseline_m` to the right.

    Raises:
        StereoError: a length that is not positive and finite.
    """

    width_px: int
    height_px: int
    focal_px: float
    cx_px: float
    cy_px: float
    baseline_m: float
    vehicle_from_camera: Mounting = field(default_factory=Mounting)

    def __post_init__(self) -> None:
        for name in ("width_px", "height_px", "focal_px", "baseline_m"):
            value = getattr(self, name)
            if not (isfinite(value) and value > 0):
                raise StereoError(f"camera {name} is {value}, it must be positive and finite")

    def depth_m(self, disparity_px: Floats) -> Floats:
        """Depth along the optical axis; infinite for disparity 0."""
        with np.errstate(divide="ignore"):
            return np.asarray(self.focal_px * self.baseline_m / np.asarray(disparity_px))

    def camera_points(self, u_px: Floats, v_px: Floats, disparity_px: Floats) -> Floats:
        """Image points with disparity to camera points `(..., 3)` (x right, y down, z forward)."""
        z = self.depth_m(disparity_px)
        x = (np.asarray(u_px) - self.cx_px) * z / self.focal_px
        y = (np.asarray(v_px) - self.cy_px) * z / self.focal_px
        return np.stack(np.broadcast_arrays(x, y, z), axis=-1)

    def vehicle_points(self, points_camera_m: Floats) -> Floats:
        """Camera points `(..., 3)` to vehicle points `(..., 3)`."""
        mount = self.vehicle_from_camera
        origin = np.array([mount.x_m, mount.y_m, mount.z_m])
        return np.asarray(np.asarray(points_camera_m) @ mount.rotation().T + origin)

    def project(self, points_vehicle_m: Floats) -> Floats:
        """Vehicle points `(..., 3)` to `(u_px, v_px, disparity_px)`, NaN behind the camera."""
        mount = self.vehicle_from_camera
        origin = np.array([mount.x_m, mount.y_m, mount.z_m])
        camera = (np.asarray(points_vehicle_m, dtype=np.float64) - origin) @ mount.rotation()
        z = np.where(camera[..., 2] > 1e-6, camera[..., 2], np.nan)
        u = self.cx_px + self.focal_px * camera[..., 0] / z
        v = self.cy_px + self.focal_px * camera[..., 1] / z
        return np.stack([u, v, self.focal_px * self.baseline_m / z], axis=-1)
