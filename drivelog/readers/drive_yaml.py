"""`drive.yaml`: what a plain drive folder says about itself.

The description and example of a key are what the error about it, `polemap new` and the page
docs/drives.md say.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Discriminator,
    Field,
    Tag,
    ValidationError,
    ValidationInfo,
    field_validator,
    model_validator,
)

from polemap.drivelog.errors import InputError
from polemap.drivelog.frames import EarthFrame
from polemap.drivelog.problems import refusal, validation_mistakes
from polemap.parsing.errors import named
from polemap.parsing.yaml_text import read_yaml

LONGEST_NAME = 200
# names of the two kinds of camera; they stand in no file and no message
_RECTIFIED, _RAW = "<rectified>", "<raw>"


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


class _Part(BaseModel):
    model_config = ConfigDict(frozen=True, extra="allow")

    @field_validator("*", mode="before")
    @classmethod
    def _no_yes_or_no(cls, value: Any, field: ValidationInfo) -> Any:
        """YAML reads yes, on and true as true, which would pass as the number 1."""
        known = cls.model_fields[str(field.field_name)]
        if isinstance(value, bool) and known.annotation is not bool:
            raise ValueError(f"is {str(value).lower()}, which is no number")
        return value


class VehiclePart(_Part):
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


class MountingPart(_Part):
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


class CameraPart(_Part):
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


class RawCameraPart(_Part):
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


class OdometryPart(_Part):
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


class AntennaPart(_Part):
    """The GNSS antenna in the vehicle frame."""

    x_m: float = _finite("metres ahead of the rear axle", 0.5)
    y_m: float = _finite("metres to the left of the middle", 0.0)


class DetectorPart(_Part):
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


def _earth_frame(values: dict[str, Any]) -> dict[str, Any]:
    try:
        EarthFrame.from_dict(values)
    except InputError as error:
        raise ValueError(str(error).removeprefix("frame: ")) from error
    return values


def _kind_of_camera(value: Any) -> str:
    """Which of the two kinds of `camera` is meant; a calibration file says raw."""
    raw = "calibration" in value if isinstance(value, dict) else isinstance(value, RawCameraPart)
    return _RAW if raw else _RECTIFIED


class DriveYaml(_Part):
    """All of drive.yaml; keys that are not known are kept aside and noted."""

    format_version: Literal[1] = Field(description="the version of this format", examples=[1])
    name: Annotated[
        str,
        Field(
            min_length=1,
            max_length=LONGEST_NAME,
            description="what the drive is called",
            examples=["campus_lap_1"],
        ),
        AfterValidator(printable),
    ]
    frame: Annotated[dict[str, Any], AfterValidator(_earth_frame)] = Field(
        description="the plane of all coordinates: a UTM zone, or {kind: local, name: ...}",
        examples=["{kind: utm, epsg: 32633}"],
    )
    vehicle: VehiclePart = Field(
        description="the car: wheelbase_m, or car", examples=["{wheelbase_m: 2.71}"]
    )
    camera: (
        Annotated[
            Annotated[CameraPart, Tag(_RECTIFIED)] | Annotated[RawCameraPart, Tag(_RAW)],
            Discriminator(_kind_of_camera),
        ]
        | None
    ) = Field(None, description="the stereo pair: rectified, or raw with its calibration file")
    odometry: OdometryPart | None = Field(
        None,
        description="what odometry.csv is corrected by",
        examples=["{speed_scale: 1.012, delay_s: 0.08}"],
    )
    gnss_antenna: AntennaPart | None = Field(
        None, description="where the GNSS antenna is", examples=["{x_m: 0.5, y_m: 0.0}"]
    )
    pole_detector: DetectorPart | None = Field(
        None, description="where the detector behind poles.csv could have seen a pole"
    )
    notes: tuple[Annotated[str, AfterValidator(printable)], ...] = Field(
        (), description="texts that are shown with every result", examples=["[wet road]"]
    )
    allow_links: bool = Field(
        False,
        description="whether pictures may lie outside of the folder, by links or absolute paths",
        examples=["true"],
    )

    def unknown_keys(self) -> list[str]:
        """Dotted names of the keys that nothing reads."""
        names = list(self.model_extra or {})
        for part in ("vehicle", "camera", "odometry", "gnss_antenna", "pole_detector"):
            value = getattr(self, part)
            if value is not None:
                names += [f"{part}.{key}" for key in value.model_extra or {}]
        return names


def read_drive_yaml(path: Path) -> DriveYaml:
    """Read and check a drive.yaml.

    Raises:
        InputError: unreadable, no YAML, a key missing or a value out of its range; several such
            keys at once as `Mistakes`.
    """
    with named(path, InputError, "drive.yaml"):
        values = read_yaml(path)
    if not isinstance(values, dict):
        raise InputError(f"{path}: holds no keys; see the plain drive folder in docs/drives.md")
    try:
        return DriveYaml.model_validate(values)
    except ValidationError as error:
        raise refusal(path, validation_mistakes(error, DriveYaml)) from error
