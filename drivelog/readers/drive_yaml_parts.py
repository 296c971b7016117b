"""The parts of drive.yaml: car, camera, odometry, antenna, detector.

The description and example of a key are what the error about it, `polemap new` and the page
docs/drives.md say.
"""

from __future__ import annotations

from typing import Any

from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    ValidationInfo,
    field_validator,
    model_validator,
)


def printable(text: str) -> str:
    """The text as it is: names go into reports, file names and onto the terminal.

    Raises:
        ValueError: it holds a control character.
    """
    if not text.isprintable():
        wrong = next(letter for letter in text if not letter.isprintable())
        raise ValueError(f"holds the character {wrong!a}, which cannot be printed")
    return text


def _finite(description: str, example: float) -> Any:
    return Field(allow_inf_nan=False, description=description, examples=[example])


def _angle(description: str) -> Any:
    return Field(0.0, allow_inf_nan=False, description=description, examples=[0.01])


class Part(BaseModel):
    model_config = ConfigDict(frozen=True, extra="allow")

    @field_validator("*", mode="before")
    @classmethod
    def _no_yes_or_no(cls, value: Any, field: ValidationInfo) -> Any:
        """YAML reads yes, on and true as true, which would pass as the number 1."""
        known = cls.model_fields[str(field.field_name)]
        if isinstance(value, bool) and known.annotation is not bool:
            raise ValueError(f"is {str(value).lower()}, which is no number")
        return value


class VehiclePart(Part):
    """The car."""

    wheelbase_m: float | None = Field(
        None,
        gt=0.0,
        allow_inf_nan=False,
        description="the distance from the rear to the front axle, metres",
        examples=[2.71],
    )
    car: str | None = Field(
        None, min_length=1, description="the name or the file of a car", examples=["passat"]
    )

    @model_validator(mode="after")
    def _has_wheelbase(self) -> VehiclePart:
        if self.wheelbase_m is None and self.car is None:
            raise ValueError("needs wheelbase_m or car, the name or file of a car")
        return self


class MountingPart(Part):
    """The left camera in the vehicle frame."""

    x_m: float = _finite("metres ahead of the rear axle", 1.9)
    y_m: float = _finite("metres to the left of the middle", 0.15)
    z_m: float = _finite("metres above the ground", 1.3)
    roll_rad: float = _angle("the roll to the right of the camera, radians")
    pitch_rad: float = _angle("the pitch of the camera, radians, positive looking down")
    yaw_rad: float = _angle("the yaw of the camera, radians, positive looking left")


def _bits() -> Any:
    return Field(
        None,
        ge=8,
        le=16,
        description="how many bits of a pixel the camera fills, where files have sixteen",
        examples=[12],
    )


class CameraPart(Part):
    """The rectified stereo pair."""

    width_px: int = Field(gt=0, description="the width of the pictures, pixels", examples=[768])
    height_px: int = Field(gt=0, description="the height of the pictures, pixels", examples=[480])
    focal_px: float = Field(
        gt=0,
        allow_inf_nan=False,
        description="the focal length of the rectified pictures, pixels",
        examples=[823.4],
    )
    cx_px: float = _finite("the column of the principal point, pixels", 383.5)
    cy_px: float = _finite("the row of the principal point, pixels", 239.5)
    baseline_m: float = Field(
        gt=0,
        allow_inf_nan=False,
        description="the distance from the left to the right camera, metres",
        examples=[0.30],
    )
    bits: int | None = _bits()
    vehicle_from_camera: MountingPart = Field(
        description="where the left camera is: x_m, y_m, z_m, roll_rad, pitch_rad, yaw_rad",
        examples=["{x_m: 1.9, y_m: 0.15, z_m: 1.3}"],
    )


class RawCameraPart(Part):
    """A pair as the cameras took it, with the file that calibrates it."""

    calibration: str | tuple[str, str] = Field(
        min_length=1,
        description="the calibration file of the pair, or one for each camera",
        examples=["camchain.yaml"],
    )
    cameras: tuple[str, str] | None = Field(
        None,
        description="the names of the left and right camera in the calibration",
        examples=["[cam0, cam1]"],
    )
    distortion_model: str | None = Field(
        None, description="the distortion model, where the file names none", examples=["plumb_bob"]
    )
    baseline_m: float | None = Field(
        None,
        gt=0,
        allow_inf_nan=False,
        description="the measured baseline, metres, where the file has another unit",
        examples=[0.30],
    )
    width_px: int | None = Field(
        None,
        gt=0,
        description="the width of the pictures, pixels, where the file holds none",
        examples=[768],
    )
    height_px: int | None = Field(
        None,
        gt=0,
        description="the height of the pictures, pixels, where the file holds none",
        examples=[480],
    )
    bits: int | None = _bits()
    vehicle_from_camera: MountingPart = Field(
        description="where the rectified left camera is, as for a rectified pair",
        examples=["{x_m: 1.9, y_m: 0.15, z_m: 1.3}"],
    )


class OdometryPart(Part):
    """What odometry.csv is corrected by, as `polemap calibrate` finds it."""

    speed_scale: float = Field(
        1.0,
        ge=0.2,
        le=5.0,
        description="what the odometry says for a true metre; speeds are divided by it",
        examples=[1.012],
    )
    delay_s: float = Field(
        0.0,
        ge=-5.0,
        le=5.0,
        description="how much later its stamps are than the motion, seconds; it is taken off",
        examples=[0.08],
    )


class AntennaPart(Part):
    """The GNSS antenna in the vehicle frame."""

    x_m: float = _finite("metres ahead of the rear axle", 0.5)
    y_m: float = _finite("metres to the left of the middle", 0.0)


class DetectorPart(Part):
    """Where the detector behind poles.csv could have seen a pole (our extension, optional)."""

    x_m: float = Field(
        ge=-15.0, le=15.0, description="metres ahead of the rear axle", examples=[3.8]
    )
    y_m: float = Field(
        ge=-3.0, le=3.0, description="metres to the left of the middle", examples=[0.5]
    )
    bearing_min_rad: float = Field(
        ge=-3.1416, le=3.1416, description="the view's right end, radians", examples=[-1.57]
    )
    bearing_max_rad: float = Field(
        ge=-3.1416, le=3.1416, description="the view's left end, radians", examples=[1.57]
    )
    range_min_m: float = Field(
        0.0, ge=0.0, description="the nearest pole that it sees, metres", examples=[1.0]
    )
    range_max_m: float = Field(
        gt=0.0,
        allow_inf_nan=False,
        description="the farthest pole that it sees, metres",
        examples=[40.0],
    )
