"""`drive.yaml`: what a plain drive folder says about itself."""

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
    model_validator,
)

from polemap.drivelog.errors import InputError
from polemap.parsing.errors import named
from polemap.parsing.yaml_text import read_yaml

LONGEST_NAME = 200
_Finite = Field(allow_inf_nan=False)
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


class _Part(BaseModel):
    model_config = ConfigDict(frozen=True, extra="allow")

    @model_validator(mode="before")
    @classmethod
    def _no_yes_or_no(cls, values: Any) -> Any:
        """YAML reads yes, on and true as true, which would pass as the number 1."""
        for name in cls.model_fields:
            if isinstance(values, dict) and isinstance(values.get(name), bool):
                raise ValueError(f"{name} is {str(values[name]).lower()}, which is no number")
        return values


class VehiclePart(_Part):
    """The car."""

    wheelbase_m: float | None = Field(None, gt=0.0, allow_inf_nan=False)
    car: str | None = Field(None, min_length=1)

    @model_validator(mode="after")
    def _has_wheelbase(self) -> VehiclePart:
        if self.wheelbase_m is None and self.car is None:
            raise ValueError("needs wheelbase_m or car, the name or file of a car")
        return self


class MountingPart(_Part):
    """The left camera in the vehicle frame."""

    x_m: float = _Finite
    y_m: float = _Finite
    z_m: float = _Finite
    roll_rad: float = Field(0.0, allow_inf_nan=False)
    pitch_rad: float = Field(0.0, allow_inf_nan=False)
    yaw_rad: float = Field(0.0, allow_inf_nan=False)


class CameraPart(_Part):
    """The rectified stereo pair."""

    width_px: int = Field(gt=0)
    height_px: int = Field(gt=0)
    focal_px: float = Field(gt=0, allow_inf_nan=False)
    cx_px: float = _Finite
    cy_px: float = _Finite
    baseline_m: float = Field(gt=0, allow_inf_nan=False)
    vehicle_from_camera: MountingPart


class RawCameraPart(_Part):
    """A pair as the cameras took it, with the file that calibrates it."""

    calibration: str | tuple[str, str] = Field(min_length=1)
    cameras: tuple[str, str] | None = None
    distortion_model: str | None = None
    baseline_m: float | None = Field(None, gt=0, allow_inf_nan=False)
    vehicle_from_camera: MountingPart


class AntennaPart(_Part):
    """The GNSS antenna in the vehicle frame."""

    x_m: float = _Finite
    y_m: float = _Finite


class DetectorPart(_Part):
    """Where the detector behind poles.csv could have seen a pole (our extension, optional)."""

    x_m: float = Field(ge=-15.0, le=15.0)
    y_m: float = Field(ge=-3.0, le=3.0)
    bearing_min_rad: float = Field(ge=-3.1416, le=3.1416)
    bearing_max_rad: float = Field(ge=-3.1416, le=3.1416)
    range_min_m: float = Field(0.0, ge=0.0)
    range_max_m: float = Field(gt=0.0, allow_inf_nan=False)


def _kind_of_camera(value: Any) -> str:
    """Which of the two kinds of `camera` is meant; a calibration file says raw."""
    raw = "calibration" in value if isinstance(value, dict) else isinstance(value, RawCameraPart)
    return _RAW if raw else _RECTIFIED


class DriveYaml(_Part):
    """All of drive.yaml; keys that are not known are kept aside and noted."""

    format_version: Literal[1]
    name: Annotated[str, Field(min_length=1, max_length=LONGEST_NAME), AfterValidator(printable)]
    frame: dict[str, Any]
    vehicle: VehiclePart
    camera: (
        Annotated[
            Annotated[CameraPart, Tag(_RECTIFIED)] | Annotated[RawCameraPart, Tag(_RAW)],
            Discriminator(_kind_of_camera),
        ]
        | None
    ) = None
    gnss_antenna: AntennaPart | None = None
    pole_detector: DetectorPart | None = None
    notes: tuple[Annotated[str, AfterValidator(printable)], ...] = ()

    def unknown_keys(self) -> list[str]:
        """Dotted names of the keys that nothing reads."""
        names = list(self.model_extra or {})
        for part in ("vehicle", "camera", "gnss_antenna", "pole_detector"):
            value = getattr(self, part)
            if value is not None:
                names += [f"{part}.{key}" for key in value.model_extra or {}]
        return names


def read_drive_yaml(path: Path) -> DriveYaml:
    """Read and check a drive.yaml.

    Raises:
        InputError: unreadable, no YAML, a key missing or a value out of its range.
    """
    with named(path, InputError, "drive.yaml"):
        values = read_yaml(path)
    if not isinstance(values, dict):
        raise InputError(f"{path}: holds no keys; see the plain drive folder in docs/drives.md")
    try:
        return DriveYaml.model_validate(values)
    except ValidationError as error:
        first = error.errors()[0]
        parts = [str(part) for part in first["loc"] if part not in (_RECTIFIED, _RAW)]
        place = ".".join(parts) or "top level"
        given = first["input"] if not isinstance(first["input"], dict) else "absent"
        raise InputError(f"{path}: {place}: {first['msg']} (found {str(given)[:60]})") from error
