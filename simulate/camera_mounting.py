"""The stereo camera of a simulated car: geometry and mounting, and where it stands in the world."""

from __future__ import annotations

from dataclasses import dataclass
from math import pi, tan
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, model_validator

from polemap.stereo.rig import Mounting, StereoRig

Floats = NDArray[np.float64]

# rectified grey cameras; focal length and baseline from calib.txt of the odometry sequences
KITTI_GEOMETRY: dict[str, float] = {
    "width_px": 1241,
    "height_px": 376,
    "focal_px": 718.856,
    "baseline_m": 0.537,
    "mount_x_m": 1.03,
    "mount_y_m": 0.06,
    "mount_z_m": 1.65,
    "frame_rate_hz": 10.0,
}


class CameraConfig(BaseModel):
    """The stereo camera; the default is the source paper's, `preset: kitti` that of KITTI.

    How its pictures look (noise, optics, exposure) is in `simulate/image_sensor.py`.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    preset: Literal["paper", "kitti"] = Field(
        "paper", description="Whose geometry stands for what is not said: kitti is KITTI's."
    )
    width_px: int = Field(768, ge=32, le=4096, description="Width of a picture, px.")
    height_px: int = Field(480, ge=32, le=4096, description="Height of a picture, px.")
    focal_px: float = Field(
        384.0 / tan(25.0 * pi / 180.0), gt=0.0, description="Rectified focal length, px."
    )
    baseline_m: float = Field(0.30, gt=0.0, description="Between the two cameras, m.")
    mount_x_m: float = Field(1.9, description="Left camera ahead of the rear axle, m.")
    mount_y_m: float = Field(0.15, description="Left camera left of the middle, m.")
    mount_z_m: float = Field(1.3, gt=0.0, description="Cameras above the ground, m.")
    mount_roll_rad: float = Field(0.0, description="Left side up positive, rad.")
    mount_pitch_rad: float = Field(0.0, description="Nose down positive, rad.")
    mount_yaw_rad: float = Field(0.0, description="To the left positive, rad.")
    frame_rate_hz: float | None = Field(
        None, gt=0.0, description="Pairs a second, Hz; without it the scenario's."
    )
    bits: Literal[8, 12] = Field(8, description="Bits of a pixel.")
    calibration_error_deg: float = Field(
        0.02,
        ge=0.0,
        le=5.0,
        description="Error of the rectification about each axis, sd, degrees; KITTI's pairs, colour"
        " and grey, are 0.2 to 0.3 px out of true vertically.",
    )

    @model_validator(mode="before")
    @classmethod
    def _fill_in(cls, values: Any) -> Any:
        """A preset gives what is not said."""
        if isinstance(values, dict) and values.get("preset") == "kitti":
            return KITTI_GEOMETRY | values
        return values

    def rig(self) -> StereoRig:
        """The rig that the written drive claims to have."""
        return StereoRig(
            self.width_px,
            self.height_px,
            self.focal_px,
            (self.width_px - 1) / 2,
            (self.height_px - 1) / 2,
            self.baseline_m,
            Mounting(
                self.mount_x_m,
                self.mount_y_m,
                self.mount_z_m,
                self.mount_roll_rad,
                self.mount_pitch_rad,
                self.mount_yaw_rad,
            ),
        )


def kitti_camera(**changes: object) -> CameraConfig:
    """The camera with KITTI's geometry, changed where `changes` say so."""
    return CameraConfig.model_validate({"preset": "kitti"} | changes)


@dataclass(frozen=True, slots=True)
class CameraPose:
    """A camera in the world: rotation `(3, 3)` world from camera axes, position `(3,)` metres."""

    rotation: Floats
    position_m: Floats


def camera_poses(
    rig: StereoRig,
    vehicle_position_m: Floats,
    vehicle_rotation: Floats,
    right_tilt: Floats | None = None,
) -> tuple[CameraPose, CameraPose]:
    """Both cameras of a vehicle; `right_tilt` `(3, 3)` turns the right camera out of true."""
    mount = rig.vehicle_from_camera
    rotation = vehicle_rotation @ mount.rotation()
    origin = vehicle_position_m + vehicle_rotation @ np.array([mount.x_m, mount.y_m, mount.z_m])
    beside = origin + rotation @ np.array([rig.baseline_m, 0.0, 0.0])
    turned = rotation if right_tilt is None else rotation @ right_tilt
    return CameraPose(rotation, origin), CameraPose(turned, beside)
